"""What nonlinearities, systems, excitations and noises owe: what happens to a signal is theirs alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hident.arrays import Array
from hident.config.expression import Formula
from hident.records import Truth, Waveform
from hident.signals.base import ExcitationSpec, NoiseSpec
from hident.systems.base import MemorySpec, NonlinearitySpec, SystemSpec
from hident.testing.base import Contract, must

_POINTS = np.linspace(-1.5, 1.5, 61)
_LATER = 40
# Up, down and up again.
_SIGNAL = 1.5 * np.sin(np.linspace(0.0, 12.0, 121))


@dataclass(frozen=True)
class NonlinearityContract(Contract):
    """What a static nonlinearity owes."""

    component: NonlinearitySpec

    def gives_an_array_of_the_shape_of_its_points(self) -> None:
        for points in (_POINTS, _POINTS[:1], _POINTS[:0], _POINTS[:60].reshape(3, 20)):
            given = np.asarray(self.component(points.copy()))
            must(
                given.shape == points.shape and given.dtype == float,
                f"at points of shape {points.shape} it gives shape {given.shape}, dtype {given.dtype}",
            )

    def leaves_its_points_as_they_are(self) -> None:
        points = _POINTS.copy()
        self.component(points)
        must(np.array_equal(points, _POINTS), "it writes to the points that it is given")

    def takes_each_point_by_itself(self) -> None:
        backwards = self.component(_POINTS[::-1].copy())[::-1]
        np.testing.assert_allclose(
            backwards,
            self.component(_POINTS.copy()),
            rtol=1e-12,
            err_msg="a value depends on the points beside it",
        )

    def names_its_break_points_in_increasing_order(self) -> None:
        found = self.component.break_points()
        must(all(a < b for a, b in pairwise(found)), f"the break points {found} do not increase")

    def is_what_its_formula_says(self) -> None:
        if (text := self.component.formula()) is not None:
            said = np.full(_POINTS.shape, Formula(text, ("u",))(u=_POINTS), dtype=float)
            np.testing.assert_allclose(
                said,
                self.component(_POINTS.copy()),
                rtol=1e-12,
                atol=1e-12,
                err_msg="its formula is another function",
            )

    def has_the_slope_of_its_values(self) -> None:
        step = 1e-6
        corners = np.array([0.0, *self.component.break_points()])
        points = _POINTS[np.min(np.abs(_POINTS[:, None] - corners), axis=1) > 2.0 * step]
        quotients = (self.component(points + step) - self.component(points - step)) / (2.0 * step)
        size = max(1.0, float(np.max(np.abs(quotients), initial=0.0)))
        np.testing.assert_allclose(
            self.component.slope(points),
            quotients,
            rtol=0.0,
            atol=1e-6 * size,
            err_msg="its slope is another",
        )


@dataclass(frozen=True)
class MemoryContract(Contract):
    """What a nonlinearity with memory owes."""

    component: MemorySpec

    def gives_an_array_of_its_own_of_the_length_of_its_signal(self) -> None:
        for u in (_SIGNAL.copy(), _SIGNAL[:1].copy()):
            before = u.copy()
            y = np.asarray(self.component.simulate(u))
            must(
                y.shape == u.shape and y.dtype == float,
                f"to a signal of shape {u.shape} it gives shape {y.shape}, dtype {y.dtype}",
            )
            must(np.array_equal(u, before), "it writes to its signal")
            must(not np.shares_memory(u, y), "its output is the array of its signal: give one of its own")

    def does_not_look_ahead(self) -> None:
        late = _SIGNAL.copy()
        late[_LATER:] += 0.1
        must(
            np.array_equal(
                self.component.simulate(late.copy())[:_LATER],
                self.component.simulate(_SIGNAL.copy())[:_LATER],
            ),
            "an output depends on later samples",
        )

    def begins_every_experiment_anew(self) -> None:
        first, again = (self.component.simulate(_SIGNAL.copy()) for _ in range(2))
        must(np.array_equal(first, again), "the same signal gives another output: a state is left behind")

    def is_no_function(self) -> None:
        must(self.component.characteristic() is None, "it says that it is a function of its input")


@dataclass(frozen=True)
class SystemContract(Contract):
    """What a system owes that knows the input by its samples."""

    component: SystemSpec
    u: Array
    dt: float

    def gives_an_output_of_the_length_of_its_input(self) -> None:
        y = self._output(self.u)
        must(y.shape == self.u.shape, f"to an input of shape {self.u.shape} its output has {y.shape}")
        must(np.isfinite(y).all(), "its output is not finite")

    def leaves_its_input_as_it_is(self) -> None:
        u = self.u.copy()
        y = self._output(u)
        must(np.array_equal(u, self.u), "it writes to its input")
        must(not np.shares_memory(u, y), "its output is the array of its input: give one of its own")

    def does_not_look_ahead(self) -> None:
        other = self.u.copy()
        other[_LATER:] += 0.1
        np.testing.assert_allclose(
            self._output(other)[:_LATER],
            self._output(self.u)[:_LATER],
            rtol=1e-9,
            atol=1e-12,
            err_msg="an output depends on later inputs",
        )

    def gives_the_same_output_again(self) -> None:
        must(
            np.array_equal(self._output(self.u), self._output(self.u)), "the same input gives another output"
        )

    def tells_a_truth_of_numbers(self) -> None:
        _check_truth(self.component)

    def responds_as_its_truth_says(self) -> None:
        response = self.component.truth().response
        if response is not None:
            np.testing.assert_allclose(
                response(self.u, self.dt)[-_LATER:],
                self._output(self.u)[-_LATER:],
                rtol=1e-6,
                atol=1e-9,
                err_msg="the response of the truth is another than that of the system",
            )

    def _output(self, u: Array) -> Array:
        return self.component.simulate(u, self.dt)


@dataclass(frozen=True)
class WaveformContract(Contract):
    """What a system owes that follows the signal between its samples."""

    component: SystemSpec
    waveform: Waveform
    n: int
    dt: float

    def gives_as_many_samples_as_are_wanted(self) -> None:
        y = self._output()
        must(y.shape == (self.n,), f"of {self.n} samples its output has the shape {y.shape}")
        must(np.isfinite(y).all(), "its output is not finite")

    def gives_the_same_output_again(self) -> None:
        must(np.array_equal(self._output(), self._output()), "the same signal gives another output")

    def does_not_depend_on_how_long_it_is_asked_for(self) -> None:
        np.testing.assert_allclose(
            self.component.respond(self.waveform, self.n // 2, self.dt),
            self._output()[: self.n // 2],
            rtol=1e-9,
            atol=1e-12,
            err_msg="a shorter record is not the beginning of a longer one",
        )

    def tells_a_truth_of_numbers(self) -> None:
        _check_truth(self.component)

    def _output(self) -> Array:
        return self.component.respond(self.waveform, self.n, self.dt)


@dataclass(frozen=True)
class ExcitationContract(Contract):
    """What an excitation owes, in a record of ``n`` samples every ``dt``."""

    component: ExcitationSpec
    n: int
    dt: float

    def gives_as_many_samples_as_are_wanted(self) -> None:
        self.component.check(self.n, self.dt)
        for burn_in in (0, 7):
            u = self._sampled(burn_in)
            must(
                u.shape == (burn_in + self.n,),
                f"of {self.n} samples after {burn_in} of burn-in it gives an array of shape {u.shape}",
            )
            must(np.isfinite(u).all(), "its samples are not finite")

    def draws_from_its_generator_alone(self) -> None:
        must(np.array_equal(self._sampled(0), self._sampled(0)), "equal generators give other samples")

    def gives_a_record_that_does_not_depend_on_the_burn_in(self) -> None:
        np.testing.assert_allclose(
            self._sampled(7)[7:],
            self._sampled(0),
            rtol=1e-9,
            atol=1e-9,
            err_msg="the record depends on burn_in: draw what comes before it last",
        )

    def _sampled(self, burn_in: int) -> Array:
        return self.component.sample(self.n, self.dt, np.random.default_rng(3), burn_in)


@dataclass(frozen=True)
class NoiseContract(Contract):
    """What a noise owes."""

    component: NoiseSpec
    output: Array

    def gives_a_new_array_of_the_shape_of_the_output(self) -> None:
        measured = self._measured()
        must(
            measured.shape == self.output.shape,
            f"of an output of shape {self.output.shape} it makes shape {measured.shape}",
        )
        must(np.isfinite(measured).all(), "what it makes is not finite")

    def draws_from_its_generator_alone(self) -> None:
        must(np.array_equal(self._measured(), self._measured()), "equal generators give other noise")

    def _measured(self) -> Array:
        return self.component.measure(self.output.copy(), np.random.default_rng(3))


def _check_truth(system: SystemSpec) -> None:
    truth = system.truth()
    must(isinstance(truth, Truth), f"truth() gives a {type(truth).__name__}, not a Truth")
    wrong = [name for name, value in truth.values.items() if not isinstance(value, float)]
    must(not wrong, f"the true values {wrong} are no floats")
