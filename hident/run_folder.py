"""What ``run.json`` says of the folder that it stands in."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path, PurePath
from typing import Any

from hident.engine.fingerprint import libraries
from hident.engine.run_files import RUN
from hident.engine.trial import digest


def read_run(folder: Path) -> dict[str, Any] | None:
    """The content of run.json; None if there is none, or it is broken."""
    try:
        run = json.loads((folder / RUN).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return run if isinstance(run, dict) else None


def written(run: dict[str, Any]) -> str:
    """The text of run.json."""
    return json.dumps(run, indent=2, ensure_ascii=False) + "\n"


def altered(folder: Path) -> list[str]:
    """The files that are not as they were written, by the hashes in run.json; one that is gone counts."""
    run = read_run(folder)
    provenance = run.get("provenance") if run else None
    if not isinstance(provenance, dict) or not {"key", "sha256"} & provenance.keys():
        return []  # Not written by a run.
    digests = provenance.pop("sha256", None)
    if not isinstance(digests, dict):
        return [RUN]
    found = [] if digests.pop(RUN, None) == digest(run) else [RUN]
    return sorted(found + [name for name, known in digests.items() if _digest(folder, name) != known])


def file_digest(file: Path) -> str:
    """SHA-256 of a file's bytes."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _digest(folder: Path, name: str) -> str | None:
    path = PurePath(name)
    try:
        return None if path.is_absolute() or ".." in path.parts else file_digest(folder / path)
    except (OSError, ValueError):
        return None


def arithmetic(run: dict[str, Any]) -> Any:
    """What decided the last bits of a run: the arithmetic in use and the versions of its libraries.

    Two runs with equal ones have made the same roundings.
    """
    provenance = run.get("provenance")
    provenance = provenance if isinstance(provenance, dict) else {}
    used, versions = provenance.get("arithmetic"), provenance.get("libraries")
    identity = used.get("identity") if isinstance(used, dict) else None
    versions = versions if isinstance(versions, dict) else {}
    return identity, {name: versions.get(name) for name in libraries()}
