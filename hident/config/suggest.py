"""The nearest valid name, for error messages."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

_LONGEST = 200


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the nearest allowed name, or an empty string."""
    lowered = {candidate.lower(): candidate for candidate in allowed}
    # The search takes quadratic time, and nobody meant a name this long.
    near = get_close_matches(name.lower(), lowered, n=1, cutoff=0.6) if len(name) <= _LONGEST else []
    return f"; did you mean '{lowered[near[0]]}'?" if near else ""


def one_of(names: Iterable[str]) -> str:
    """Return the names as a comma-separated list in their given order."""
    return ", ".join(str(name) for name in names)


def none_of(value: str, allowed: Iterable[str]) -> str:
    """The message about an option's value that is none of the allowed ones."""
    allowed = list(allowed)
    return f"must be {one_of(allowed)}, not '{value}'{did_you_mean(value, allowed)}"


def there_is_no(what: str, name: str, known: Iterable[str]) -> str:
    """The message about a name that is none of the known ones."""
    known = list(known)
    there = f"there are: {one_of(known)}" if known else "there is none"
    return f"there is no {what} '{name}'{did_you_mean(name, known)} ({there})"
