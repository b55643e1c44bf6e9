"""docs/tutorial.md, reproducing.md and concepts.md: what one does, in the order in which it stands there."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.documented import ROOT, blocks
from tests.forked import GUARD_SECONDS, run_forked

WAYS = ("docs/tutorial.md", "docs/reproducing.md")
BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)
# The last name of a file before a block that is one, and whether it goes on there.
FILE = re.compile(r"`([\w/]+\.(?:yaml|csv))`(, at its end)?:$")


def done(command: str, folder: Path) -> str:
    """Run a command with one worker; what it prints, errors included. Its exit code may stand behind it."""
    words, _, code = command.partition("# exit code ")
    program, *arguments = shlex.split(words)
    if program == "hident":
        computes = arguments[0] in ("run", "power", "accept") and "--power" not in arguments
        ended = run_forked([*arguments, *(("--jobs", "1") if computes else ())], folder)
    else:
        assert program == "python"
        ended = subprocess.run(
            [sys.executable, *arguments, "-p", "no:cacheprovider"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=GUARD_SECONDS,
            check=False,
        )
    assert ended.returncode == int(code or 0), (command, ended.stdout, ended.stderr)
    return ended.stdout + ended.stderr


@pytest.mark.parametrize("page", WAYS)
def test_every_line_does_what_the_page_says(page: str, tmp_path: Path) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    said, shown = "", 0
    for block in BLOCK.finditer(text):
        language, content = block.groups()
        match language:
            case "console":
                said = "".join(done(command, tmp_path) for command in content.splitlines())
            case "text":
                shown += 1
                missing = [line for line in content.splitlines() if line not in said]
                assert not missing, said
            case _:
                named = FILE.search(text[: block.start()].rstrip())
                assert named, content
                path = tmp_path / named[1]
                before = path.read_text(encoding="utf-8") if named[2] else ""
                path.write_text(before + content, encoding="utf-8")
    assert shown > 3


def test_the_commands_between_the_lines_are_there(tmp_path: Path) -> None:
    for page in WAYS:
        text = BLOCK.sub("", (ROOT / page).read_text(encoding="utf-8"))
        for command in re.findall(r"`(hident list[^`]*)`", text):
            done(command, tmp_path)


@pytest.mark.filterwarnings("ignore:the arithmetic in use")
def test_the_code_of_the_concepts_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pieces = blocks("docs/concepts.md", "python")
    assert len(pieces) == 5
    space: dict[str, object] = {}
    for code in pieces:
        exec(code, space)
