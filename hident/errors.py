"""The errors a user can meet, each with the exit code that the command line gives it."""

from __future__ import annotations

from enum import IntEnum


class Exit(IntEnum):
    """Exit codes of the command line."""

    FINE = 0
    DIFFERS = 1
    """Results differ, something is unsound, or a figure cannot be drawn and all else is written."""
    BAD_INPUT = 2
    CRASHED = 3
    NOTHING = 4
    UNFORESEEN = 70
    BUSY = 75
    INTERRUPTED = 130


class HidentError(Exception):
    """An error with a message for the user and an exit code; never shown with a traceback."""

    exit_code: Exit = Exit.BAD_INPUT


class ConfigError(HidentError):
    """A configuration or an argument cannot be used."""


class RecordAbsent(ConfigError):
    """A configuration is sound, and the measured record that it may go without is not here."""


class StoreError(HidentError):
    """The trials store or an output folder cannot be read or written."""


class StoreBusy(HidentError):
    """Another run holds the trials store."""

    exit_code = Exit.BUSY


class TrialsCrashed(HidentError):
    """At least one trial ended in an error that is not a result."""

    exit_code = Exit.CRASHED


class NothingToCompare(HidentError):
    """There is nothing to compare or to verify."""

    exit_code = Exit.NOTHING


class TrialFailed(Exception):
    """What went wrong in a trial is a result: counted as failed, not a crash, with what happened."""


class SimulationError(TrialFailed):
    """The simulation of the true system does not converge."""


class EstimationError(TrialFailed):
    """The estimate is singular or diverged."""
