"""Work counted in function calls: the same number on a slow or busy machine as on an idle one."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any


def counted_calls(action: Callable[[], object], limit: float = float("inf")) -> int:
    """How many functions ``action`` calls; it is given up at more than ``limit``."""
    calls = 0

    def count(frame: FrameType, event: str, arg: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")
        assert calls <= limit, f"more than {limit} calls"

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        action()
    finally:
        sys.setprofile(before)
    return calls
