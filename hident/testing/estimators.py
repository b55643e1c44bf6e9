"""What every estimator owes, tried on records of a case."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from hident.arrays import Array
from hident.config.spec import canonical
from hident.config.suggest import one_of
from hident.engine.comparable import unsaid
from hident.engine.trial import Data, Job, estimate, run_trials
from hident.errors import EstimationError
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec
from hident.records import Estimate, ModelPart, Record
from hident.signals.experiments import Experiments
from hident.signals.streams import NumpyStreams
from hident.testing.base import Contract, must, record_of

Dull = Literal["constant input", "constant output", "period of two"]
"""What excites nothing."""
Invariance = Literal["scale", "order"]
_POINTS = np.linspace(-0.9, 0.9, 31)
_TRIALS = 5
_CHUNKS: tuple[tuple[int, ...], ...] = ((0, 1, 2, 3, 4), (0, 3), (2,), (1, 4))
_LENGTHS = (1, 2, 3, 5, 9, 40)
_REASON = 20
"""Characters that a reason has at least."""


class Fit(NamedTuple):
    """An estimate, and its nonlinearity at points."""

    estimate: Estimate
    curve: Array | None


@dataclass(frozen=True)
class EstimatorContract(Contract):
    """What an estimator owes.

    ``several`` are data with several experiments, ``learns_from`` is what excites nothing and is nevertheless
    enough for the method.
    """

    component: EstimatorSpec
    data: Data
    several: Data
    invariances: Collection[Invariance] = ()
    learns_from: Collection[Dull] = ()

    def leaves_the_record_as_it_is(self) -> None:
        made = record_of(self.data)
        record = replace(made, u=made.u.copy(), y=made.y.copy())
        self._outcome(record, "a record of the case")
        for name in ("u", "y"):
            must(
                np.array_equal(getattr(record, name), getattr(made, name)),
                f"fit writes to record.{name}, which all estimators of a trial share: let it work on a copy",
            )

    def does_not_modify_the_points_at_which_it_is_evaluated(self) -> None:
        found = self._fit(record_of(self.data)).estimate
        if found.nonlinearity is not None:
            points = _POINTS[::-1].copy()
            given = found.nonlinearity(points)
            must(
                np.array_equal(points, _POINTS[::-1]),
                "the nonlinearity writes to the points that it is given",
            )
            must(
                np.shape(given) == points.shape,
                f"at points of shape {points.shape} the nonlinearity has the shape {np.shape(given)}",
            )

    def gives_the_same_bytes_for_the_same_stream(self) -> None:
        once, again = (
            _fingerprint(
                estimate(self.data, Job(self.component, ()), record_of(self.data), 1, 0), self.data.dt
            )
            for _ in range(2)
        )
        must(once == again, "the same record and stream give another estimate the second time")

    def gives_the_same_bytes_whatever_runs_with_it(self) -> None:
        jobs = [Job(self.component, (_Everything(),))] * 2
        for fixed in ([], ["input"]):
            data = self.data.model_copy(update={"streams": NumpyStreams(fixed=fixed)})
            whole = self._bytes(data, jobs, [range(_TRIALS)])
            for chunks in ([[trial] for trial in range(_TRIALS)], _CHUNKS[1:]):
                apart = self._bytes(data, jobs, chunks)
                wrong = sorted({trial for trial, job in whole if apart[trial, job] != whole[trial, job]})
                must(
                    not wrong,
                    f"the estimates of trials {wrong} depend on the trials beside them (chunks {[*chunks]}, "
                    f"fixed streams {fixed}): fit_many must give what fit gives, to the last bit",
                )
            must(
                self.component.draws() or all(whole[i, 0] == whole[i, 1] for i in range(_TRIALS)),
                "two fits of one record differ: does it keep something from one fit to the next?",
            )

    def provides_what_it_says(self) -> None:
        found = self._fit(record_of(self.data)).estimate
        given = {name for name in get_args(ModelPart) if getattr(found, name) is not None}
        given |= {f"value {name}" for name in found.values}
        says = self.component.provides()
        must(given <= says, f"the estimate holds {sorted(given - says)}: name it in holds or names")
        must(says <= given, f"holds and names say {sorted(says - given)}, which the estimate lacks")
        wrong = [name for name, value in found.values.items() if not isinstance(value, float)]
        must(not wrong, f"the values {wrong} are no floats: self.named(...) makes them so")

    def says_what_its_coefficients_are(self) -> None:
        names = unsaid(self.component.names(), self.component)
        must(
            not names,
            f"letters() does not say what {one_of(names)} are: they are compared by name alone with what may "
            "be other quantities",
        )

    def promises_dynamics_that_it_always_gives(self) -> None:
        must(
            not type(self.component).identifies_dynamics or "linear" in self.component.provides(),
            "identifies_dynamics promises a linear block, and provides() has none",
        )

    def estimates_from_short_records_or_says_why_not(self) -> None:
        fewest = self.component.fewest_samples()
        for n in (fewest, fewest + 1, fewest + 2, fewest + 5):
            record = record_of(self.data.model_copy(update={"samples": n}))
            if found := self._outcome(record, f"a record of {n} samples"):
                names = {f"value {name}" for name in found.estimate.values}
                says = self.component.provides()
                must(
                    names == {part for part in says if part.startswith("value ")},
                    f"of {n} samples the estimate has the values {sorted(names)}",
                )
                must(
                    (found.curve is None) == ("nonlinearity" not in says),
                    f"of {n} samples the estimate's nonlinearity is not as provides() says",
                )

    def makes_no_curve_of_an_output_that_is_not_finite(self) -> None:
        sound = record_of(self.data)
        for wrong in (np.nan, np.inf):
            y = sound.y.copy()
            y[len(y) // 3] = wrong
            if found := self._outcome(replace(sound, y=y), f"an output that holds {wrong}"):
                # Only what does not look at the output can be estimated from it.
                must(
                    found.curve is None and _finite(found.estimate),
                    f"an output that holds {wrong} gives an estimate: begin with require_finite(record.y)",
                )

    def estimates_from_a_constant_record_or_says_why_not(self) -> None:
        sound = record_of(self.data)
        n = len(sound)
        for u, y in [(0.5, 0.0), (0.5, 1.0), (0.0, 0.0)]:
            record = replace(sound, u=np.full(n, u), y=np.full(n, y))
            self._outcome(record, f"a record whose input is {u} and whose output is {y} throughout")

    def says_why_data_that_excite_nothing_do_not_do(self) -> None:
        for dull, record in self._dull():
            if found := self._outcome(record, f"data with a {dull}", _REASON):
                must(
                    dull in self.learns_from,
                    f"a {dull} gives an estimate: raise an EstimationError (for a constant, require_usable "
                    f"does), or test with learns_from=[{dull!r}] if that is enough for the method",
                )
                must(_finite(found.estimate), f"a {dull} gives values that are not finite")

    def keeps_experiments_apart_or_refuses_them(self) -> None:
        record = record_of(self.several)
        must(len(record.parts) > 1, "'several' must be an excitation with more than one experiment")
        if self.component.takes_experiments() == "one":
            self._refused(record, f"{self.component.kind} takes a record of one experiment")
            return
        _same(self._fit(record), self._fit(_reversed(record)), 1e-8, "another order of the experiments")

    def works_at_one_sampling_interval_if_it_says_so(self) -> None:
        if self.component.takes_experiments() != "at_one_interval":
            return
        record = record_of(self.several)
        first = next(iter(record.parts))
        parts = {**record.parts, first: replace(record.parts[first], dt=0.7 * record.parts[first].dt)}
        self._refused(
            replace(record, parts=parts),
            f"{self.component.kind} works at one sampling interval, and the experiment '{first}' has",
        )

    def estimates_from_short_experiments_or_says_why_not(self) -> None:
        parts = getattr(self.several.excitation, "parts", ())
        # The lengths of periodic experiments are not for us to choose.
        if parts and all(part.samples is not None for part in parts):
            for length in _LENGTHS:
                self._outcome(record_of(self._of_length(length)), f"experiments of {length} samples each")

    def scales_with_the_output(self) -> None:
        if "scale" not in self.invariances:
            return
        record = record_of(self.data)
        found, scaled = self._fit(record), self._fit(replace(record, y=8.0 * record.y))
        if found.curve is not None and scaled.curve is not None:
            np.testing.assert_allclose(scaled.curve, 8.0 * found.curve, rtol=1e-9)
        a, b = found.estimate.linear, scaled.estimate.linear
        if a is not None and b is not None:
            np.testing.assert_allclose(b.a, a.a, rtol=1e-9, atol=1e-12)

    def does_not_depend_on_the_order_of_the_samples(self) -> None:
        if "order" not in self.invariances:
            return
        record = record_of(self.data)
        shuffled = np.random.default_rng(2).permutation(len(record))
        other = Record(record.u[shuffled], record.y[shuffled], record.dt, record.truth)
        _same(self._fit(record), self._fit(other), 1e-10, "another order of the samples")

    def _fit(self, record: Record) -> Fit:
        with np.errstate(all="ignore"):
            found = self.component.fit(record, np.random.default_rng(0))
            return Fit(found, None if found.nonlinearity is None else found.nonlinearity(_POINTS.copy()))

    def _outcome(self, record: Record, what: str, fewest: int = 1) -> Fit | None:
        """The fit, or None where it fails for a reason of so many characters."""
        try:
            return self._fit(record)
        except EstimationError as error:
            must(len(str(error)) >= fewest, f"fails on {what} without a reason: {str(error)!r}")
            return None
        except Exception as error:
            raise AssertionError(
                f"{self.component.kind} crashes on {what} with {type(error).__name__}: {error}; "
                "let it raise an EstimationError that says why"
            ) from error

    def _refused(self, record: Record, begins: str) -> None:
        try:
            self.component.fit(record, np.random.default_rng(5))
        except EstimationError as error:
            must(str(error).startswith(begins), f"says {str(error)!r}, not {begins!r}")
        else:
            raise AssertionError(
                "fit takes experiments that takes_experiments() does not name: begin it with "
                "self.require_experiments(record)"
            )

    def _bytes(
        self, data: Data, jobs: Sequence[Job], chunks: Sequence[Sequence[int]]
    ) -> dict[tuple[int, int], tuple[bytes, str]]:
        """What each trial of each job gave, to the last bit, by the number of trial and job."""
        found = {}
        for chunk in chunks:
            for job, outcome in enumerate(run_trials(data, jobs, [sorted(chunk)] * len(jobs), 1)):
                for trial, crash in outcome.crashes.items():
                    raise AssertionError(f"trial {trial} crashes: {crash.error}\n{crash.traceback}")
                [scores] = outcome.scores
                for trial, values in zip(scores.trials.tolist(), scores.values, strict=True):
                    found[trial, job] = (values.tobytes(), scores.failures.get(trial, ""))
        return found

    def _of_length(self, length: int) -> Data:
        written = canonical(self.several.excitation)
        parts = [{**part, "samples": length} for part in written["parts"]]
        changed: Mapping[str, Any] = {
            "samples": length * len(parts),
            "excitation": Experiments(parts=parts),
        }
        return self.several.model_copy(update=changed)

    def _dull(self) -> Iterator[tuple[Dull, Record]]:
        """Records that excite nothing, by what is dull in them."""
        sound = record_of(self.data)
        n = len(sound)
        alternating = np.where(np.arange(n) % 2, -1.0, 1.0)
        yield "constant input", replace(sound, u=np.zeros(n), y=np.zeros(n))
        yield "constant input", replace(sound, u=np.full(n, 0.5), y=np.ones(n))
        yield "constant input", replace(sound, u=np.full(n, 0.5), y=np.zeros(n))
        yield "constant output", replace(sound, y=np.zeros(n))
        yield "constant output", replace(sound, y=np.ones(n))
        # The response of any linear block after a static function is of period 2 as well.
        yield "period of two", replace(sound, u=alternating, y=0.3 + 0.7 * np.roll(alternating, 1))


class _Everything(MetricSpec):
    """One number that stands for every bit of an estimate."""

    def evaluate(self, estimate: Estimate, record: Record) -> Sequence[float]:
        return (float(int.from_bytes(_fingerprint(estimate, record.dt)[:6])),)


def _fingerprint(found: Estimate, dt: float | None) -> bytes:
    """A hash of every number that an estimate holds."""
    numbers: list[Any] = [list(found.values.values())]
    if found.nonlinearity is not None:
        numbers.append(found.nonlinearity(_POINTS.copy()))
    for block in (found.linear, found.continuous):
        if block is not None:
            numbers += [block.b, block.a]
    if found.continuous is not None:
        numbers.append(found.continuous.delay)
    if found.response is not None:
        numbers.append(found.response(np.tile(_POINTS, 3), 1.0 if dt is None else dt))
    if found.frequencies is not None:
        numbers.append(found.frequencies)
    names = ",".join(found.values).encode()
    return hashlib.sha256(
        names + b"".join(np.asarray(one, dtype=float).tobytes() for one in numbers)
    ).digest()


def _finite(found: Estimate) -> bool:
    return bool(np.isfinite(list(found.values.values())).all())


def _same(one: Fit, other: Fit, tolerance: float, what: str) -> None:
    """Raise AssertionError unless two fits agree: the curves, the linear blocks and the values."""
    (a, curve_a), (b, curve_b) = one, other
    must(list(a.values) == list(b.values), f"{what} gives other values: {[*a.values]} and {[*b.values]}")
    must((a.linear is None) == (b.linear is None), f"{what} gives a linear block, or takes it away")

    def close(x: Any, y: Any, part: str) -> None:
        np.testing.assert_allclose(
            x, y, rtol=tolerance, atol=tolerance, err_msg=f"{what} gives another estimate ({part})"
        )

    close([] if curve_a is None else curve_a, [] if curve_b is None else curve_b, "nonlinearity")
    close(list(a.values.values()), list(b.values.values()), "values")
    if a.linear is not None and b.linear is not None:
        close(a.linear.a, b.linear.a, "linear.a")
        close(a.linear.b, b.linear.b, "linear.b")


def _reversed(record: Record) -> Record:
    """The same experiments in the other order."""
    parts, start = {}, 0
    backwards = [*record.parts.items()][::-1]
    for name, part in backwards:
        parts[name] = replace(part, start=start, stop=start + len(part))
        start += len(part)
    u, y = (
        np.concatenate([signal[part.samples] for _, part in backwards]) for signal in (record.u, record.y)
    )
    return Record(u, y, record.dt, record.truth, parts)
