"""A LaTeX, where there is one: what a text that hident wrote comes to on paper."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.forked import GUARD_SECONDS

HOW = (
    "no pdflatex is here, or it lacks siunitx; on Debian and Ubuntu: "
    "apt-get install --no-install-recommends texlive-latex-recommended texlive-science"
)
# No faults of the text: how full lines are, references of a first pass, and more rows than a page has.
_NONE = "Reference|There were|Label|Float too large"
_FAULTS = re.compile(rf"^(?:!|LaTeX Warning: (?!{_NONE}).*|Package \w+ Warning: .*|Missing character.*)")


def typeset(preamble: str, body: str, folder: Path) -> list[str]:
    """The errors and warnings of an article; skips the test where there is no LaTeX that knows siunitx."""
    latex = shutil.which("pdflatex")
    if latex is None or not _has("siunitx.sty"):
        pytest.skip(HOW)
    text = f"\\documentclass{{article}}\n{preamble}\n\\begin{{document}}\n{body}\n\\end{{document}}\n"
    (folder / "paper.tex").write_text(text, encoding="utf-8")
    ended = subprocess.run(
        [latex, "-interaction=nonstopmode", "-halt-on-error", "paper.tex"],
        cwd=folder,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=GUARD_SECONDS,
        check=False,
    )
    faults = [line for line in ended.stdout.splitlines() if _FAULTS.match(line)]
    return faults or ([] if ended.returncode == 0 else ended.stdout.splitlines()[-20:])


def _has(name: str) -> bool:
    found = subprocess.run(["kpsewhich", name], capture_output=True, check=False)
    return found.returncode == 0
