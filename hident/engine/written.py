"""The data-generating part of a case as a file holds it: a simulation, or a measured record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from hident.config.load import Problem, problems_of
from hident.config.spec import Spec
from hident.config.suggest import one_of
from hident.engine.measurement import Measurement, RecordSection
from hident.engine.trial import Data, Excitation, Noises, Samples, Step, Streams, System
from hident.signals.streams import NumpyStreams

_SIMULATION = tuple(Data.model_fields)
NEEDED = tuple(name for name, field in Data.model_fields.items() if field.is_required())
"""What no simulation can do without."""


class Written(Spec):
    """Either ``record``, or what a simulation needs; what is left out for a record is None."""

    samples: Samples | None = None
    """Length N of the record."""
    dt: Step | None = None
    """Sampling interval; leave out in discrete time, where times count samples."""
    system: System | None = None
    """The true system."""
    excitation: Excitation | None = None
    """The input signal."""
    noise: Noises = ()
    """What happens to the output on its way to the record, in this order."""
    streams: Streams = NumpyStreams()
    """Where the random numbers come from."""
    record: RecordSection | None = None
    """A measured record, in the place of all that simulates one."""

    @model_validator(mode="wrap")
    @classmethod
    def _one_of_both(cls, written: Any, handler: Callable[[Any], Self]) -> Self:
        problems = _unclear(written) if isinstance(written, Mapping) else []
        try:
            made = handler(written)
        except ValidationError as error:
            known = {(problem.location, problem.message) for problem in problems}
            problems += [one for one in problems_of(error) if (one.location, one.message) not in known]
        else:
            if not problems:
                return made
        details = [
            InitErrorDetails(
                type=PydanticCustomError("config", one.message), loc=one.location, input=one.value
            )
            for one in problems
        ]
        raise ValidationError.from_exception_data(cls.__name__, details) from None

    def data(self, folder: Path) -> Data:
        """The data that are meant; the names of files are meant from the folder.

        RecordAbsent if an optional record is not here; ConfigError if a record cannot be read.
        """
        if self.record is not None:
            return Measurement.of(self.record, folder)
        return Data.model_validate({name: getattr(self, name) for name in _SIMULATION})


def _unclear(written: Mapping[str, Any]) -> list[Problem]:
    """What stands beside a record; without one, what is wrong with the simulation."""
    simulation = {name: written[name] for name in _SIMULATION if name in written}
    if written.get("record") is not None:
        message = f"cannot stand beside 'record', which takes the place of {one_of(_SIMULATION)}"
        return [Problem((name,), message, value) for name, value in simulation.items()]
    try:
        Data.model_validate(simulation)
    except ValidationError as error:
        return problems_of(error)
    return []
