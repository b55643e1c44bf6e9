"""The pages of the documentation, as tests read them."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def blocks(page: str, *languages: str) -> list[str]:
    """The blocks of code of a page, README.md or one under docs/, that are in one of the languages."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"```(?:{'|'.join(languages)})\n(.*?)```", text, re.DOTALL)


def commands(page: str) -> list[str]:
    """What stands between backticks and begins with ``hident``, in their order, each once."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return list(dict.fromkeys(re.findall(r"`(hident [^`]*)`", text)))
