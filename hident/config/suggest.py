"""The nearest valid name, for error messages; lists and counts in words."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Literal

_LONGEST = 200
_SINGULAR = {"": "", "are": "is", "were": "was"}


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the nearest allowed name, or an empty string."""
    lowered = {candidate.lower(): candidate for candidate in allowed}
    # The search takes quadratic time, and nobody meant a name this long.
    near = get_close_matches(name.lower(), lowered, n=1, cutoff=0.6) if len(name) <= _LONGEST else []
    return f"; did you mean '{lowered[near[0]]}'?" if near else ""


def one_of(names: Iterable[str]) -> str:
    """Return the names as a comma-separated list in their given order."""
    return ", ".join(str(name) for name in names)


def counted(count: int, what: str, verb: Literal["", "are", "were"] = "") -> str:
    """How many there are of what has a plural in s, and what they are.

    Examples
    --------
    >>> counted(1, "trial"), counted(0, "trial"), counted(20, "trial", "are")
    ('1 trial', '0 trials', '20 trials are')
    >>> counted(1, "trial", "were")
    '1 trial was'
    """
    if count == 1:
        return " ".join(filter(None, (f"1 {what}", _SINGULAR[verb])))
    return " ".join(filter(None, (f"{count} {what}s", verb)))


def none_of(value: str, allowed: Iterable[str]) -> str:
    """The message about an option's value that is none of the allowed ones."""
    allowed = list(allowed)
    return f"must be {one_of(allowed)}, not '{value}'{did_you_mean(value, allowed)}"


def there_is_no(what: str, name: str, known: Iterable[str]) -> str:
    """The message about a name that is none of the known ones."""
    known = list(known)
    there = f"there are: {one_of(known)}" if known else "there is none"
    return f"there is no {what} '{name}'{did_you_mean(name, known)} ({there})"
