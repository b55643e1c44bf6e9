"""What the folder of a paper says of its printed numbers today: notes and reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hident.errors import ConfigError
from hident.ledger.published import Key, Reason, read_published, read_reasons


@dataclass(frozen=True)
class Remarks:
    """What is known of the printed numbers of a paper."""

    notes: Mapping[Key, str]
    """The notes of published.csv."""
    reasons: tuple[Reason, ...]

    @classmethod
    def of(cls, paper: Path) -> Remarks:
        """Those of a folder under experiments/; none where its files cannot be read."""
        notes: Mapping[Key, str] = {}
        reasons: tuple[Reason, ...] = ()
        try:
            notes = {key: printed.note for key, printed in read_published(paper).items()}
            reasons = read_reasons(paper)
        except ConfigError:
            pass
        return cls(notes, reasons)

    def reason(self, config: str, key: Key) -> Reason | None:
        """The reason that covers a number of a configuration."""
        return next((one for one in self.reasons if one.covers(config, key)), None)
