"""Streams from MATLAB's generator states, for papers that fixed them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Annotated, Any, Literal, Self, cast

import numpy as np
from pydantic import BeforeValidator, model_validator

from hident.config.expression import Formula
from hident.config.spec import Spec, component
from hident.signals.matlab5 import Beginnings, MatlabStream, state_number
from hident.signals.streams import NumpyStreams, Role, StreamsSpec


def _as_state(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise ValueError("must be a whole number, or a formula in the trial's number such as '100 + trial'")
    _state_in(value, trial=1)
    return value


def _state_in(state: int | str, trial: int) -> int:
    """The state as a number in one trial, counted from 1."""
    if isinstance(state, int):
        return state_number(state)
    formula = _formula(state)
    try:
        return state_number(float(formula(trial=float(trial))))
    except ValueError as error:
        raise ValueError(f"{error} (the formula {state!r} in trial {trial})") from None


@cache
def _formula(state: str) -> Formula:
    return Formula(state, ("trial",))


class MatlabState(Spec):
    """Where MATLAB's generators of one role start."""

    state: Annotated[int | str, BeforeValidator(_as_state)]
    """State from 0 to 2^32 - 1: fixed, or a formula in the number of the trial from 1, as '100 + trial'."""
    generator: Literal["state", "twister"] = "state"
    """Source of uniform numbers: rand('state', s) or rand('twister', s); normal ones: randn('state', s)."""

    def is_fixed(self) -> bool:
        """Whether the state is the same in all trials."""
        return isinstance(self.state, int) or not re.search(r"\btrial\b", self.state)

    def streams(self, trials: Iterable[int]) -> list[MatlabStream]:
        """The streams of some trials, counted from 1."""
        states = [_state_in(self.state, trial) for trial in trials]
        beginnings = Beginnings(states)
        return [MatlabStream(state, self.generator, beginnings) for state in states]


@component("streams", "matlab5", source="Marsaglia and Zaman 1991; Marsaglia and Tsang 1984")
class Matlab5Streams(StreamsSpec):
    """The generators of MATLAB 5 to 7 from given states; NumPy's for roles without a state.

    Examples
    --------
    >>> streams = Matlab5Streams(input={"state": 0})
    >>> streams.generator("input", seed=1, key=0, trial=0).random(3).round(4)
    array([0.9501, 0.2311, 0.6068])
    """

    input: MatlabState | None = None
    """State of the random numbers of the input."""
    noise: MatlabState | None = None
    """State of the random numbers of the noise."""

    @model_validator(mode="after")
    def _fixed_states_do_not_change(self) -> Self:
        for role in self.fixed:
            given = self._given(role)
            if given is not None and not given.is_fixed():
                raise ValueError(f"{role} is fixed, but its state '{given.state}' changes with the trial")
        for role in self.share:
            if self._given(role) is not None:
                raise ValueError(
                    f"{role} starts from a given state, which all cases share: leave 'share' out"
                )
        return self

    def is_fixed(self, role: Role) -> bool:
        given = self._given(role)
        return super().is_fixed(role) if given is None else given.is_fixed()

    def generator(self, role: Role, seed: int, key: int, trial: int) -> np.random.Generator:
        return self.generators(role, seed, key, [trial])[0]

    def generators(self, role: Role, seed: int, key: int, trials: Sequence[int]) -> list[np.random.Generator]:
        given = self._given(role)
        if given is None:
            return NumpyStreams(fixed=self.fixed).generators(role, seed, key, trials)
        # They have the methods that excitations and noises call, and no others.
        return cast(list[np.random.Generator], given.streams(trial + 1 for trial in trials))

    def _given(self, role: Role) -> MatlabState | None:
        return None if role == "estimator" else getattr(self, role)
