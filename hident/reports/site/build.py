"""The whole site: made of folders of results, and written below an output folder."""

from __future__ import annotations

import hashlib
import json
import lzma
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath

import hident
from hident.engine.run_files import OWN, POWER, unpacked
from hident.engine.trial import digest
from hident.errors import ConfigError, NothingToCompare, StoreError
from hident.new_files import made_folder, replacing
from hident.reports.site import components, differences, front, handbook, papers, runs, search
from hident.reports.site.pages import FRONT, Part, Run, Sources, Written
from hident.reports.site.rendering import STATIC, TEMPLATES, rendered
from hident.run_folder import RunFolder

_LIST = ".files"
"""The file of the site that names all others: what is not among them is not ours to remove."""


@dataclass(frozen=True)
class Built:
    """What was built."""

    front: Path
    """The page to open."""
    pages: int
    made: int
    """How many of the pages were made anew."""
    runs: int
    faults: tuple[str, ...]
    """What is wrong with runs that are shown all the same."""
    left_out: tuple[str, ...]
    """Runs that are not shown, and why."""


def build(
    folders: Sequence[Path],
    out: Path,
    *,
    experiments: Path = Path("experiments"),
    configs: Path = Path("configs"),
    docs: Path | None = None,
    results: Path = Path("results"),
) -> Built:
    """Build the site of all runs in ``folders``, each a folder of runs or that of one run, below ``out``.

    The handbook is hident's own, unless ``docs`` names another folder.
    Pages that are made of the same files, components and code as in an earlier build are kept, in a folder
    beside ``out``. What is known of alternatives is what ``results`` holds, or the folder of the run. Where
    two runs have one name, that of the first folder is shown. Files of an earlier build that are no longer
    part of the site are removed.

    Raises
    ------
    NothingToCompare
        If no folder holds a run.
    ConfigError
        If ``out`` holds files that are not those of a site.
    StoreError
        If it cannot be written, or a file of a run cannot be read.
    """
    found, left_out = _runs(folders, results)
    sources = Sources(found, experiments, configs, docs or handbook.docs_folder(), results)
    old = _written_before(out)
    place = out.resolve()
    kept = _Kept(place.with_name(f".{place.name}-cache"))
    parts = [
        part
        for module in (front, differences, runs, papers, components, handbook, search)
        for part in module.parts(sources)
    ]
    pages = [page for part in parts for page in kept.pages(part)]
    files = {page.path: page.html.encode() for page in pages} | search.files(pages)
    files[front.PICTURE] = front.picture(sources).encode()
    files |= {f"static/{path.name}": path.read_bytes() for path in sorted(STATIC.iterdir())}
    copied = {to: source for part in parts for to, source in part.files.items()}
    names = sorted({*files, *copied, _LIST})
    # First, so that what an interrupted build leaves is known as that of a site.
    _write(out, _LIST, _lines({*names} | old))
    for name, content in files.items():
        _write(out, name, content)
    for name, source in copied.items():
        _write(out, name, _content(source))
    _remove(out, old - {*names})
    _write(out, _LIST, _lines(names))
    kept.forget()
    faults = tuple(f"{run.folder.path}: {fault}" for run in found for fault in run.facts.faults)
    return Built(out / FRONT, len(pages), kept.made, len(found), faults, tuple(left_out))


def _runs(folders: Sequence[Path], results: Path) -> tuple[tuple[Run, ...], list[str]]:
    """The runs in some folders by name, and what is said of those that are not shown."""
    found: dict[str, Run] = {}
    left_out = []
    for folder in folders:
        here = [folder] if _is_run(folder) else list(filter(_is_run, sorted(folder.glob("[!.]*"))))
        if not here:
            raise NothingToCompare(f"{folder} holds no run: hident run writes one")
        for path in here:
            name = path.resolve().name
            if name in found:
                left_out.append(f"{path}: {found[name].folder.path} is shown")
            else:
                accepted = results if (results / POWER / name).is_dir() else path.parent
                found[name] = Run(name, RunFolder(path), accepted)
    return tuple(found[name] for name in sorted(found)), left_out


def _is_run(folder: Path) -> bool:
    return folder.is_dir() and any((folder / name).is_file() for name in OWN)


def _written_before(out: Path) -> set[str]:
    """The files of the site that stands there; none if the folder is empty or not there."""
    try:
        names = (out / _LIST).read_text(encoding="utf-8").splitlines()
        return {name for name in names if ".." not in PurePosixPath(name).parts and not name.startswith("/")}
    except (OSError, UnicodeDecodeError):
        pass
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ConfigError(f"{out} holds what is no site: name another folder with --out, or remove it")
    return set()


def _lines(names: Iterable[str]) -> bytes:
    return "".join(f"{name}\n" for name in sorted(names)).encode()


def _content(source: Path) -> bytes:
    try:
        content = source.read_bytes()
        return content if unpacked(source.name) == source.name else lzma.decompress(content)
    except OSError as error:
        raise StoreError(f"{source} cannot be read: {(error.strerror or str(error)).lower()}") from None
    except lzma.LZMAError:
        # The page says that the file is not as it was written.
        return b""


def _write(out: Path, name: str, content: bytes) -> None:
    """Write a file, unless it stands there as it is."""
    path = out / name
    try:
        if path.read_bytes() == content:
            return
    except OSError:
        made_folder(path.parent)
    with replacing(path) as new:
        new.write_bytes(content)


def _remove(out: Path, names: Iterable[str]) -> None:
    """Remove files of an earlier build, and the folders that are empty then."""
    for path in (out / name for name in names):
        path.unlink(missing_ok=True)
        for folder in path.parents:
            if folder == out or not folder.is_dir() or any(folder.iterdir()):
                break
            folder.rmdir()


class _Kept:
    """The pages of earlier builds by the keys of their parts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.made = 0
        self._code = _code()
        self._used: set[str] = set()

    def pages(self, part: Part) -> list[Written]:
        """The pages of a part, made if none of its key are kept."""
        name = f"{digest([part.key, self._code])}.json"
        self._used.add(name)
        try:
            return [Written(**page) for page in json.loads((self.folder / name).read_bytes())]
        except (OSError, ValueError, TypeError):
            pass
        pages = [rendered(page) for page in part.make()]
        self.made += len(pages)
        made_folder(self.folder)
        with replacing(self.folder / name) as new:
            new.write_text(json.dumps([asdict(page) for page in pages]), encoding="utf-8")
        return pages

    def forget(self) -> None:
        """Remove what this build did not use."""
        if self.folder.is_dir():
            for path in self.folder.glob("*.json"):
                if path.name not in self._used:
                    path.unlink(missing_ok=True)


def _code() -> str:
    """A hash of all code and of the templates."""
    content = hashlib.sha256()
    for path in sorted((*Path(hident.__file__).parent.rglob("*.py"), *TEMPLATES.iterdir())):
        content.update(path.read_bytes())
    return content.hexdigest()
