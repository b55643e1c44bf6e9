"""What every contract is made of: checks with names, and the data that they are tried on."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hident.config.spec import Component, plain
from hident.engine.trial import Data, generate
from hident.records import Record

CUBIC = {"kind": "polynomial", "coefficients": [0, 1, 0.5, 0.25]}
DATA: Mapping[str, Any] = {
    "samples": 300,
    "system": {"kind": "hammerstein", "nonlinearity": CUBIC, "linear": {"kind": "ar", "a": [0.5]}},
    "excitation": {"kind": "iid", "distribution": "uniform", "low": -1, "high": 1},
    "noise": {"kind": "white", "std": 0.01},
}
"""What components are tried on unless a test says otherwise."""


@dataclass(frozen=True)
class Check:
    """One thing that a component owes: called, it raises AssertionError if that does not hold.

    Examples
    --------
    >>> check = Check("abs gives arrays", lambda: must(False, "abs gives a list"))
    >>> str(check)
    'abs gives arrays'
    >>> check()
    Traceback (most recent call last):
        ...
    AssertionError: abs gives a list
    """

    name: str
    run: Callable[[], None]

    def __call__(self) -> None:
        try:
            self.run()
        except AssertionError:
            raise
        except Exception as error:
            raise AssertionError(f"it ends with {type(error).__name__}: {error}") from error

    def __str__(self) -> str:
        return self.name


class Contract:
    """Base of the contracts: each public method is a check, and its name says what is owed."""

    component: type[Component] | Component

    def checks(self) -> Iterator[Check]:
        """The checks, in the order in which they are written."""
        for cls in reversed(type(self).__mro__):
            for name, method in vars(cls).items():
                if inspect.isfunction(method) and not name.startswith("_") and name != "checks":
                    words = name.replace("_", " ")
                    yield Check(f"{self.component.kind} {words}", getattr(self, name))


def must(condition: object, message: str) -> None:
    """Raise AssertionError with the message unless the condition holds.

    A plain ``assert`` would say nothing here: pytest rewrites those of test files alone.
    """
    if not condition:
        raise AssertionError(message)


def made_data(changes: Mapping[str, Any] | None = None) -> Data:
    """The data of a case: keys as a configuration has them, those of :data:`DATA` where they are not given.

    ConfigError if they are wrong.
    """
    return Data(**{**DATA, **plain(changes or {})})


def record_of(data: Data, trial: int = 0) -> Record:
    """The record of a trial with seed 1."""
    return generate(data, 1, trial)
