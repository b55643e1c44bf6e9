"""The units of work of an experiment: every estimator on every case that concerns it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hident.config.load import Document, Problem, problems_of
from hident.config.spec import Of, canonical
from hident.config.suggest import counted, one_of
from hident.config.variables import filled
from hident.config.yaml12 import Complaint, Location
from hident.engine.cases import CHANGEABLE, DATA, Axis, Label, Skip
from hident.engine.comparable import completed, form_of, incomparable, truth_for
from hident.engine.fingerprint import fingerprint, libraries
from hident.engine.scores import SECONDS
from hident.engine.trial import Data, digest
from hident.engine.written import Written
from hident.errors import ConfigError, RecordAbsent
from hident.estimators.base import EstimatorSpec
from hident.metrics.base import MetricSpec, Scored
from hident.records import Estimate, Truth

_MOST_UNITS = 100_000


@dataclass(frozen=True)
class Unit:
    """One estimator on one case: ``labels`` by axis, in the order of the axes."""

    labels: dict[str, Label]
    name: str
    data: Data
    estimator: EstimatorSpec
    metrics: dict[str, MetricSpec]

    @cached_property
    def metric_labels(self) -> tuple[str, ...]:
        return tuple(label for name, metric in self.metrics.items() for label in metric.labels(name))

    @cached_property
    def _identities(self) -> dict[str, str]:
        """For each metric, a hash of what its numbers depend on besides the seed and the trial."""
        estimator = canonical(self.estimator)
        return {
            name: digest(
                {
                    "data": str(self.data.key),
                    "estimator": estimator,
                    # The names of the estimators that it is for change no number.
                    "metric": {key: v for key, v in canonical(metric).items() if key != "estimators"},
                    "code": fingerprint((self.data, self.estimator, metric)),
                    "libraries": libraries(),
                }
            )
            for name, metric in self.metrics.items()
        }

    def truth(self, estimate: Estimate | None = None) -> Truth:
        """The truth of its system, in the form that the estimator fixes where no data determine it.

        A form that depends on what an estimate found is that of the ``estimate``.
        """
        return form_of(self.estimator, self.data.system.truth(), self.data.dt, estimate)

    def keys(self, seed: int, perturbation: int = 0) -> dict[str, str]:
        """For each metric, the key of its stored trials: data, estimator, metric, code, seed, perturbation.

        The metric's name is no part of it, nor are the unit's other metrics.
        """
        perturbed = {"perturbation": perturbation} if perturbation else {}
        return {
            name: digest({"of": identity, "seed": seed, **perturbed})
            for name, identity in self._identities.items()
        }

    @cached_property
    def _fit_identity(self) -> str:
        """A hash of what its estimates depend on besides the seed and the trial."""
        return digest(
            {
                "data": str(self.data.key),
                "estimator": canonical(self.estimator),
                "code": fingerprint((self.data, self.estimator)),
                "libraries": libraries(),
            }
        )

    def timing_key(self, seed: int, perturbation: int = 0) -> str:
        """The key of the seconds that its fits took, which depend on no metric."""
        return f"{SECONDS}{digest([self._fit_identity, seed, perturbation])}"

    def is_at(self, labels: Mapping[str, Any]) -> bool:
        """Whether it stands at these labels; an axis that does not touch it does not count."""
        return all(str(self.labels.get(axis, label)) == str(label) for axis, label in labels.items())

    def described(self) -> str:
        """The unit in words, for messages."""
        case = ", ".join(f"{axis} {label}" for axis, label in self.labels.items())
        return f"estimator '{self.name}'" + (f" at {case}" if case else "")


class Expansion:
    """The units of an experiment; each part is validated once for each choice of the axes that touch it."""

    def __init__(self, document: Document, axes: tuple[Axis, ...], skip: tuple[Skip, ...] = ()) -> None:
        self._document, self._axes, self._skip = document, axes, skip
        self._skipped: set[int] = set()
        self._parts: dict[tuple[Any, ...], Any] = {}
        self._complaints: list[Complaint] = []
        self._compared: list[_Compared] = []
        self.absent = ""
        """What is said of a measured record that is not here and may be absent."""

    def document(self, choice: Mapping[int, int]) -> Document:
        """The document with the chosen axes applied, each at its chosen label."""
        document = self._document
        values: dict[str, Any] = {}
        for axis, index in sorted(choice.items()):
            point = self._axes[axis].points[index]
            document = point.apply(document)
            values |= point.variables
        sections = {name: filled(document.data[name], values) for name in CHANGEABLE if name in document.data}
        return replace(document, data={**document.data, **sections})

    def complaints(self) -> list[Complaint]:
        """What is wrong with any part at any choice, whether or not the whole can be expanded."""
        roots: list[tuple[str, ...]] = [("data",)]
        for section in ("estimators", "metrics"):
            if isinstance(named := self._document.data.get(section), Mapping):
                roots += [(section, name) for name in named]
        for root in roots:
            choices = self._choices({root}, _MOST_UNITS)
            for choice in choices if len(choices) > 1 else ():
                if not self._is_left_out(root[1] if root[1:] else None, choice):
                    self._part(root, choice)
        return self._complaints

    def units(
        self, estimators: Iterable[str], metrics: Mapping[str, MetricSpec], complaints: list[Complaint]
    ) -> list[Unit]:
        """All units, those of one case together; what is wrong with any goes to the complaints."""
        found: list[tuple[tuple[tuple[int, int], ...], Unit]] = []
        estimators = list(estimators)
        # A metric that is for an unknown name may be meant for any of them; that has its own message.
        misnamed = any(set(spec.estimators or ()) - set(estimators) for spec in metrics.values())
        for name in estimators:
            scored = [
                metric
                for metric, spec in metrics.items()
                if spec.estimators is None or name in spec.estimators
            ]
            if not scored and not misnamed:
                self._complain(("estimators", name), "no metric scores this estimator")
            roots = {("data",), ("estimators", name), *(("metrics", metric) for metric in scored)}
            choices = self._choices(roots, _MOST_UNITS - len(found))
            if not choices:
                self._complain(("cases",), f"expands to more than {_MOST_UNITS} estimates")
                break
            wanted = [choice for choice in choices if not self._is_left_out(name, choice)]
            if not wanted:
                self._complain(("estimators", name), "is left out of every case")
            for choice in wanted:
                unit = self._unit(name, scored, choice)
                if unit is not None:
                    found.append((self._relevant(("data",), choice), unit))
        for i in range(len(self._skip)):
            if i not in self._skipped:
                self._complain(("skip", i), "leaves nothing out: no estimate has all these labels")
        self._complain_of_factors()
        complaints += self._complaints
        return [unit for _, unit in sorted(found, key=lambda pair: pair[0])]

    def _is_left_out(self, name: str | None, choice: Mapping[int, int]) -> bool:
        """Whether the estimator, or every one (None), has no unit there."""
        labels = self._labels(choice)
        covering = {i for i, skip in enumerate(self._skip) if skip.covers(name, labels)}
        self._skipped |= covering
        # Whatever the other labels set.
        return bool(covering) or any(name in self._axes[i].points[j].left_out for i, j in choice.items())

    def _labels(self, choice: Mapping[int, int]) -> dict[str, Label]:
        return {self._axes[i].name: self._axes[i].labels[j] for i, j in choice.items()}

    def _unit(self, name: str, scored: list[str], choice: dict[int, int]) -> Unit | None:
        data = self._part(("data",), choice)
        estimator = self._part(("estimators", name), choice)
        metrics = {metric: self._part(("metrics", metric), choice) for metric in scored}
        if data is None or estimator is None or None in metrics.values():
            return None
        unit = Unit(self._labels(choice), name, data, estimator, metrics)
        problems = list(_mismatches(unit))
        self._complaints += self.document(choice).complaints_of(problems)
        wrong = {problem.location for problem in problems}
        if all(location[0] == "metrics" for location in wrong):
            sound = (metric for metric in scored if ("metrics", metric) not in wrong)
            self._compared += [_Compared(unit, metric, choice) for metric in sound]
        return unit

    def _complain_of_factors(self) -> None:
        """Complain of values that are compared where nothing brings the system to an estimator's rule.

        The case is named where not all cases of the estimator are alike.
        """
        said: dict[tuple[str, str], dict[str, list[_Compared]]] = {}
        for one in self._compared:
            unit, data = one.unit, one.unit.data
            found = said.setdefault((unit.name, one.metric), {})
            messages = incomparable(unit.metrics[one.metric], unit.name, unit.estimator, data.system, data.dt)
            for message in list(messages) or [""]:
                found.setdefault(message, []).append(one)
        for (_, metric), found in said.items():
            for message, where in found.items():
                first = where[0]
                labels = ", ".join(f"{axis} {label}" for axis, label in first.unit.labels.items())
                others = len(where) - 1
                more = f" and {others} {'case' if others == 1 else 'cases'} more" if others else ""
                case = f" at {labels}{more}" if len(found) > 1 else ""
                problem = Problem(
                    ("metrics", metric), f"the metric '{first.unit.metrics[metric].kind}'{case} {message}"
                )
                if message:
                    self._complaints += self.document(first.choice).complaints_of([problem])

    def _choices(self, roots: set[tuple[str, ...]], most: int) -> list[dict[int, int]]:
        """The choices of labels of the axes that touch any of the parts; none if there are too many."""
        places = {i: range(len(axis.points)) for i, axis in enumerate(self._axes) if axis.roots & roots}
        if math.prod(map(len, places.values())) > most:
            return []
        return [dict(zip(places, chosen, strict=True)) for chosen in itertools.product(*places.values())]

    def _relevant(self, root: tuple[str, ...], choice: Mapping[int, int]) -> tuple[tuple[int, int], ...]:
        return tuple((i, j) for i, j in sorted(choice.items()) if root in self._axes[i].roots)

    def _part(self, root: tuple[str, ...], choice: Mapping[int, int]) -> Any:
        relevant = self._relevant(root, choice)
        if (root, relevant) not in self._parts:
            document = self.document(dict(relevant))
            location: Location = () if root == ("data",) else root
            try:
                self._parts[root, relevant] = _validated(root, document)
            except ValidationError as error:
                self._parts[root, relevant] = None
                self._complaints += document.complaints_of(problems_of(error, location))
            except RecordAbsent as error:
                self._parts[root, relevant] = None
                self.absent = str(error)
            except ConfigError as error:
                self._parts[root, relevant] = None
                problems = [Problem(("record",), line) for line in str(error).splitlines()]
                self._complaints += document.complaints_of(problems)
        return self._parts[root, relevant]

    def _complain(self, location: Location, message: str) -> None:
        self._complaints += self._document.complaints_of([Problem(location, message)])


@dataclass(frozen=True)
class _Compared:
    """A metric of a unit with which nothing is wrong so far, and the labels that make its case."""

    unit: Unit
    metric: str
    choice: Mapping[int, int]


def _validated(root: tuple[str, ...], document: Document) -> Any:
    """The component or the data; RecordAbsent or ConfigError if a measured record cannot be read."""
    data = document.data
    match root:
        case ("estimators", name):
            return Of("estimator").validate(data["estimators"][name])
        case ("metrics", name):
            return Of("metric").validate(data["metrics"][name])
        case _:
            written = Written.model_validate({name: data[name] for name in DATA if name in data})
            return written.data(Path(document.name).parent)


def not_given(needs: frozenset[str], given: frozenset[str]) -> list[str]:
    """The needs that are not given; "linear or continuous" is met by either."""
    return sorted(need for need in needs if given.isdisjoint(need.split(" or ")))


def unfit(data: Data) -> Iterator[Problem]:
    """What does not fit together in the data of a case, though each part is sound."""
    fits = True
    try:
        data.excitation.check(data.samples, data.dt or 1.0)
    except (ValueError, ArithmeticError) as error:
        yield Problem(("excitation",), str(error))
        fits = False
    try:
        data.system.check(data.dt)
    except ValueError as error:
        yield Problem(("system",), str(error))
        fits = False
    if not fits:
        return
    for stretch in data.excitation.stretches(data.samples, data.dt or 1.0):
        if (level := stretch.excitation.before()) is not None:
            try:
                data.system.check_before(level)
            except ValueError as error:
                yield Problem(("excitation",), str(error))


def _mismatches(unit: Unit) -> Iterator[Problem]:
    """What does not fit together in a unit, though each part is sound."""
    data = unit.data
    problems = list(unfit(data))
    yield from problems
    try:
        unit.estimator.check(data.samples, data.dt)
    except ValueError as error:
        yield Problem(("estimators", unit.name), str(error))
    fewest = unit.estimator.fewest_samples()
    if data.samples < fewest:
        yield Problem(
            ("estimators", unit.name),
            f"needs at least {counted(fewest, 'sample')}, but samples is {data.samples}",
        )
        return
    true, estimated = data.system.provides(), unit.estimator.provides()
    for need in not_given(unit.estimator.needs_of_truth(), true):
        yield Problem(
            ("estimators", unit.name),
            f"the estimator '{unit.estimator.kind}' {data.lacks(need)}",
        )
    for name, metric in unit.metrics.items():
        messages = list(_unmet(unit, metric, true, estimated))
        if not problems and not messages:
            messages = list(_unsound(unit, metric))
        yield from (Problem(("metrics", name), message) for message in messages)


def _unmet(unit: Unit, metric: MetricSpec, true: frozenset[str], estimated: frozenset[str]) -> Iterator[str]:
    """What a metric needs and does not get."""
    unknown = not_given(metric.needs_of_truth(), true)
    for need in unknown:
        yield f"the metric '{metric.kind}' {unit.data.lacks(need)}"
    for need in sorted({*not_given(metric.needs_of_estimate(), estimated)} - {*unknown}):
        yield (
            f"the metric '{metric.kind}' needs the {need} of the estimate, which estimator "
            f"'{unit.name}' ({unit.estimator.kind}) does not give (it gives: "
            f"{one_of(sorted(estimated))}); 'estimators:' under the metric limits it to some"
        )


def _seen(metric: MetricSpec, unit: Unit) -> Truth:
    """The truth in the form in which the metric is given it; where none is, as it is written."""
    truth = unit.data.system.truth()
    try:
        return truth_for(metric, unit.estimator, truth, unit.data.dt)
    except ValueError:
        return truth


def _unsound(unit: Unit, metric: MetricSpec) -> Iterator[str]:
    """Why a metric that gets all it needs would say nothing."""
    data, estimator = unit.data, unit.estimator
    try:
        completed(metric, estimator, data.dt).check(
            Scored(
                data.samples,
                data.dt,
                data.system,
                _seen(metric, unit),
                data.excitation,
                estimator.provides(),
                estimator.discrete_step(data.dt),
                data.validated,
            )
        )
    except (ValueError, ArithmeticError) as error:
        yield f"the metric '{metric.kind}' {error}"
