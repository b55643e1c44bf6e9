"""Configurations that a test writes: their plans, or why they are refused."""

from __future__ import annotations

from pathlib import Path

from hident import plugins
from hident.engine.experiment import Plan, load
from hident.errors import ConfigError


def planned(folder: Path, text: str, *assignments: str, **options: int | str) -> Plan:
    """The plan of a configuration, written to ``a.yaml``."""
    plugins.load()
    path = folder / "a.yaml"
    path.write_text(text, encoding="utf-8")
    return load(path, assignments, options)


def refusals(folder: Path, text: str, *assignments: str, **options: int | str) -> list[str]:
    """The lines of the message, with the folder left out; none if the configuration is sound."""
    try:
        planned(folder, text, *assignments, **options)
    except ConfigError as error:
        return str(error).replace(f"{folder}/", "").splitlines()
    return []


def replaced(text: str, words: dict[str, str]) -> str:
    """The text with other words in place of some, one after the other."""
    for old, new in words.items():
        text = text.replace(old, new)
    return text
