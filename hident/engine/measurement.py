"""A measured record in the place of simulated data: trial 0 is the record, the others are bootstraps."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Count, Family, Flag, Spec, canonical
from hident.config.suggest import one_of
from hident.engine.trial import Data, Excitation, Job, System, digest, estimate
from hident.errors import ConfigError, EstimationError, RecordAbsent
from hident.estimators.base import EstimatorSpec, require_finite
from hident.measurements.measured_record import MeasuredRecord
from hident.numerics.bootstrap import resampled
from hident.numerics.parts import in_each
from hident.records import Record, Truth
from hident.signals.base import ExcitationSpec, Stretch
from hident.systems.base import SystemSpec

_FILE = "file"
# What is said of a file and not of what is in it.
_OF_THE_FILE = ("optional", "source")
# Digits of a hash that a reader compares.
_SHORT = 12
_MOST_HELD = 4
_HELD: dict[int, Record] = {}
"""The records that this process has read, by the keys of their data."""


class BlockBootstrap(Spec):
    """The model of trial 0 simulates, and blocks of its residuals are added in an order of chance."""

    kind: Literal["block"]
    """``block``: residual bootstrap with circular blocks, each experiment by itself."""
    length: Annotated[Count, Field(ge=1)]
    """Samples of a block: more than the residuals remember."""


class RecordSection(MeasuredRecord):
    """A measured record, which stands where a system, its input and its noise stand for a simulated one."""

    bootstrap: BlockBootstrap | None = None
    """How the trials after trial 0, which is the record itself, are resampled."""
    optional: Flag = False
    """Whether the configuration is left out, with a line that says so, where a file is not there."""
    source: str = ""
    """Where the files come from, for who does not have them."""

    def require_present(self, folder: Path) -> None:
        """Raise RecordAbsent if it is optional and a file is not there."""
        absent = [folder / name for name in self.files() if not (folder / name).exists()]
        if self.optional and absent:
            where = one_of(os.path.normpath(path) for path in absent)
            raise RecordAbsent(
                f"its record is not here: there is no {where}" + (f" ({self.source})" if self.source else "")
            )


class Unknown(SystemSpec):
    """The system behind a measured record."""

    family: ClassVar[Family] = "system"
    kind: ClassVar[str] = "measured record"

    def truth(self) -> Truth:
        return Truth()


class Recorded(ExcitationSpec):
    """The input of a measured record: ``experiments`` are its names, samples and intervals."""

    family: ClassVar[Family] = "excitation"
    kind: ClassVar[str] = "measured record"

    experiments: tuple[tuple[str, int, float], ...] = ()

    def stretches(self, n: int, dt: float) -> tuple[Stretch, ...]:
        if not self.experiments:
            return super().stretches(n, dt)
        return tuple(Stretch(name, self, samples, step) for name, samples, step in self.experiments)


class Measurement(Data):
    """A record from a file, of whose system nothing is known.

    The same samples, read in the same way, are the same data wherever their file stands: names of files and
    folders are no part of the key. Records do not travel. Each process that computes reads the file once, and
    refuses one that holds something else than ``sha256`` says.
    """

    system: System = Unknown()
    excitation: Excitation = Recorded()
    record: RecordSection
    """What to read."""
    folder: Path
    """Where its file's name is meant from."""
    sha256: str
    """Hash of the file when the plan was made."""
    with_validation: Flag = False
    """Whether the record has a validation part."""

    @classmethod
    def of(cls, section: RecordSection, folder: Path) -> Measurement:
        """The data that a section of a configuration in a folder means.

        RecordAbsent if a file of an optional record is not there; ConfigError if one cannot be read, or the
        record is too short for the blocks of its bootstrap.
        """
        folder = folder.resolve()
        section.require_present(folder)
        sha256 = section.digest(folder)
        record = section.read(folder)
        experiments = tuple((name, len(part), part.dt) for name, part in record.parts.items())
        shortest = min((part.stop - part.start for part in record.experiments), default=0)
        if section.bootstrap is not None and section.bootstrap.length > shortest:
            raise ConfigError(
                f"the blocks of its bootstrap have {section.bootstrap.length} samples, and "
                f"{'its shortest experiment' if len(experiments) > 1 else 'it'} has {shortest}"
            )
        made = cls(
            samples=len(record),
            dt=record.dt,
            excitation=Recorded(experiments=experiments),
            record=section,
            folder=folder,
            sha256=sha256,
            with_validation=record.validation is not None,
        )
        if section.digest(folder) != sha256:
            raise ConfigError("its file changed while it was read: try again")
        made._hold(record)
        return made

    @cached_property
    def key(self) -> int:
        """Hash of what the file holds, of how it is read, and of the names of its experiments."""
        section = {name: value for name, value in canonical(self.record).items() if name not in _OF_THE_FILE}
        of = {"record": _numbered(section, self.record.files()), "sha256": self.sha256}
        return int(digest({**of, "experiments": canonical(self.excitation)}), 16)

    @property
    def resampled(self) -> bool:
        return self.record.bootstrap is not None

    @property
    def validated(self) -> bool:
        return self.with_validation

    @property
    def optional_files(self) -> tuple[str, ...]:
        return self.record.files() if self.record.optional else ()

    def require(self) -> None:
        self._read()

    def before_noise(self, seed: int, trial: int) -> Record:
        return self._read()

    def record_for(self, job: Job, record: Record, seed: int, trial: int) -> Record:
        """The record itself in trial 0, else a bootstrap of it by the job's own model.

        Raises
        ------
        EstimationError
            If the estimator fails on the record, or its model simulates what is not finite; and what its
            ``fit`` raises.
        """
        bootstrap = self.record.bootstrap
        if trial == 0 or bootstrap is None:
            return record
        simulated = record.once(("simulated", job.key, seed), lambda: self._simulated(job, record, seed))
        rng = self.streams.generator("noise", seed, self.key, trial)
        noise = in_each(
            record.experiments, lambda e: resampled(e, bootstrap.length, rng), record.y - simulated
        )
        y = simulated + noise
        y.flags.writeable = False
        return replace(record, y=y)

    def lacks(self, need: str) -> str:
        return f"needs the {need} of the truth: a measured record has none"

    def unrepeatable(self, estimator: EstimatorSpec) -> str:
        if self.record.bootstrap is None:
            return (
                "a measured record is trial 0, with no other: let 'trials' be 1, or give the record a "
                "'bootstrap', as {kind: block, length: 50}"
            )
        if "model" not in estimator.provides():
            return (
                "a bootstrap adds residuals to what a model simulates, and this estimator "
                f"({estimator.kind}) gives none"
            )
        return ""

    def says(self) -> str:
        named = " and ".join(self.record.files())
        step = "" if self.dt is None else f", dt {self.dt:.10g}"
        return f"Measured record {named}: {self.samples} samples{step}, SHA-256 {self.sha256[:_SHORT]}."

    def _simulated(self, job: Job, record: Record, seed: int) -> Array:
        model = estimate(self, job, record, seed, 0).model
        if model is None:
            raise EstimationError(f"the estimate of {job.estimator.kind} holds no model to resample from")
        simulated = model.simulate(record)
        require_finite(simulated)
        return simulated

    def _read(self) -> Record:
        """The record, read once in each process.

        ConfigError if the file is not here, or not the one that the plan was made for.
        """
        record = _HELD.get(self.key)
        if record is None:
            self._require_same()
            record = self.record.read(self.folder)
            self._require_same()
            self._hold(record)
        return record

    def _require_same(self) -> None:
        here = self.record.digest(self.folder)
        if here != self.sha256:
            raise ConfigError(
                f"the measured record in {self.folder} is not the one that the run began with: SHA-256 "
                f"{here[:_SHORT]} here, {self.sha256[:_SHORT]} there"
            )

    def _hold(self, record: Record) -> None:
        for shared in filter(None, (record, record.validation)):
            shared.u.flags.writeable = shared.y.flags.writeable = False
        while len(_HELD) >= _MOST_HELD:
            _HELD.pop(next(iter(_HELD)), None)
        _HELD[self.key] = record


def _numbered(value: Any, names: Sequence[str]) -> Any:
    """A section as plain data, with a number in the place of each name of a file."""
    if isinstance(value, Mapping):
        return {
            key: _numbered(item, names) if key != _FILE else [names.index(one) for one in item]
            for key, item in value.items()
        }
    return [_numbered(item, names) for item in value] if isinstance(value, list) else value
