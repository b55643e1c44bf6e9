"""Files to begin with, copied from hident/starters under another name: the verb new."""

from __future__ import annotations

import ast
import keyword
import re
import sys
from collections.abc import Iterable, Iterator
from importlib.resources import files
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from hident import plugins
from hident.config.spec import components
from hident.config.suggest import did_you_mean, one_of
from hident.engine.run_files import POWER
from hident.errors import ConfigError
from hident.new_files import made_folder, replacing

if TYPE_CHECKING:
    from hident.config.spec import Family

STARTERS: dict[str, tuple[str, ...]] = {
    "study": ("hident run {folder}/{name}.yaml",),
    "paper": ("hident run {name}_table1", "experiments/{name}/README.md says what comes after it"),
    "plugin": ("hident run {folder}/{name}.yaml", "python -m pytest {folder}"),
}
"""What can be begun, and what to do with it then."""
_WORD = "starter"
"""The name that the files have among themselves, in their names and in their texts."""
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_LONGEST = 60
_YAML = ("null", "true", "false")
_KINDS: dict[str, Family] = {"": "estimator", "_error": "metric"}
"""The components of a plugin, by what follows its name."""


def start(what: str, name: str, into: Path) -> Iterator[str]:
    """Write a starter under a name into a folder; yields lines that say what was written and what is next.

    ConfigError, and nothing is written, if there is no such starter, the name cannot be used, or one of the
    files is there. StoreError if they cannot be written.
    """
    if what not in STARTERS:
        raise ConfigError(
            f"'{what}' cannot be begun{did_you_mean(what, STARTERS)} (there are: {one_of(STARTERS)})"
        )
    templates = dict(_templates(files("hident") / "starters" / what))
    _check_name(what, name, templates.values())
    texts = {into / _named(path, name): _named(text, name) for path, text in templates.items()}
    if there := [str(path) for path in texts if path.exists() or path.is_symlink()]:
        raise ConfigError(
            f"{one_of(there)}: there already, and nothing is overwritten: take another name, or another "
            "folder with --into"
        )
    for path, text in texts.items():
        made_folder(path.parent)
        with replacing(path) as new:
            new.write_text(text, encoding="utf-8")
        yield f"wrote {path}"
    for line in STARTERS[what]:
        yield f"next: {line.format(name=name, folder=(into / name).as_posix())}"


def _check_name(what: str, name: str, templates: Iterable[str]) -> None:
    """Raise ConfigError if files, modules or components cannot have the name."""
    if not _NAME.fullmatch(name):
        meant = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_").lstrip("0123456789_")
        near = f"; did you mean '{meant}'?" if 0 < len(meant) <= _LONGEST else ""
        raise ConfigError(
            f"'{name}' cannot be a name: take small letters, digits and _, a letter first{near}"
        )
    if len(name) > _LONGEST:
        raise ConfigError(f"'{name}' cannot be a name: take at most {_LONGEST} letters, not {len(name)}")
    if name == POWER:
        raise ConfigError(f"'{name}' cannot be a name: it is the folder of what hident power writes")
    if name in _YAML:
        raise ConfigError(f"'{name}' cannot be a name: it means something to YAML; take my_{name}")
    if what != "plugin":
        return
    known = {*sys.stdlib_module_names, *keyword.kwlist, *keyword.softkwlist, "hident"}
    if name in known or not {name, _capitals(name)}.isdisjoint(_identifiers(templates)):
        raise ConfigError(
            f"'{name}' cannot be a plugin's name: it means something to Python, or in its files; "
            f"take my_{name}"
        )
    if name == "conftest" or name.startswith("test_") or name.endswith("_test"):
        other = name.removeprefix("test_").removesuffix("_test") or "method"
        raise ConfigError(
            f"'{name}' cannot be a plugin's name: pytest would take its files for tests; take my_{other}"
        )
    # A folder without code is none: it may be what was begun under this name before.
    if (module := find_spec(name)) is not None and module.origin is not None:
        raise ConfigError(
            f"'{name}' cannot be a plugin's name: a module that can be imported has it; take my_{name}"
        )
    plugins.load_built_in()
    for ending, family in _KINDS.items():
        if f"{name}{ending}" in components(family):
            raise ConfigError(
                f"'{name}' cannot be a plugin's name: there is the {family} '{name}{ending}' already; "
                f"take my_{name}"
            )


def _identifiers(templates: Iterable[str]) -> set[str]:
    """What the Python files among the templates call something, but for the name itself."""
    found = set()
    for text in templates:
        try:
            tree = ast.parse(text)
        except SyntaxError:
            # YAML, CSV, Markdown.
            continue
        for node in ast.walk(tree):
            match node:
                case ast.Name(id=one) | ast.arg(arg=one) | ast.alias(asname=str(one)) | ast.alias(name=one):
                    found.add(one)
    return found - {_WORD, _capitals(_WORD)}


def _templates(folder: Traversable, inside: str = "") -> Iterator[tuple[str, str]]:
    """The path and the text of each file of a starter."""
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        path = f"{inside}{entry.name}"
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _templates(entry, f"{path}/")
        elif entry.is_file():
            yield path, entry.read_text(encoding="utf-8")


def _capitals(name: str) -> str:
    """The name as that of a class."""
    return "".join(word.capitalize() for word in name.split("_"))


def _named(text: str, name: str) -> str:
    """A text of a starter under the name."""
    return text.replace(_WORD, name).replace(_capitals(_WORD), _capitals(name))
