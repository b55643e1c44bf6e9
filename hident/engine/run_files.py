"""The names of the files in the folder of a run, and which names are left for tables and figures."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, get_args

Format = Literal["png", "pdf", "svg", "tex"]
FORMATS: tuple[Format, ...] = get_args(Format)
"""The formats of figures, and that of tables for LaTeX."""
TEX: Format = "tex"
DEFAULT_FORMAT: Format = "png"
RUN = "run.json"
"""What the run was: the configuration, the seed, where the files come from."""
TABLE = "table.csv"
"""All statistics."""
PAGE = "table.md"
"""The tables as the paper prints them."""
PAGE_TEX = "table.tex"
"""The tables for LaTeX, where they are asked for."""
VERDICTS = "verdicts.csv"
"""The verdicts on the printed numbers."""
TRIALS = "trials.csv.xz"
"""The values of every trial."""
CRASHES = "crashes.txt"
"""What a crashed run leaves."""
TIMING = "timing.csv"
"""How long the fits took: of this run on this machine, so that nothing compares or hashes it."""
OWN = (RUN, TABLE, PAGE, VERDICTS, TRIALS, CRASHES, TIMING)
SENSITIVITY = "sensitivity.csv"
"""How many trials a last bit moves; accept writes it beside the files of the run."""
POWER = "power"
"""The folder, beside those of the runs, of what `hident power` writes: a folder for each configuration."""
NUMBERS, MUTATIONS = "numbers.csv", "mutations.csv"
"""Which alternatives each printed number excludes, and which of them each table rejects."""
BENCHMARKS = "bench.md"
"""What `make bench` writes to the folder of the accepted results: of no run."""
SHOWN = "trial-"
"""How the folders begin, in that of a run, of what `hident show` writes of one trial."""
_DRAWN = ".data.csv.xz"
_VECTOR = ".svg.xz"
_LONGEST = 100
# The numbers of Windows' devices may be superscripts.
_DEVICES = re.compile(r"con|prn|aux|nul|(?:com|lpt)[0-9¹²³]")


def table_file(name: str) -> str:
    """The file of a table whose numbers table.csv does not hold."""
    return f"{name}.csv"


def tex_file(name: str) -> str:
    """The file of a table for LaTeX, where that is asked for."""
    return f"{name}.{TEX}"


def figure_file(name: str, kind: Format = DEFAULT_FORMAT) -> str:
    """The file of a figure in a format."""
    return f"{name}.{kind}"


def drawn_file(name: str) -> str:
    """The file of the numbers that a figure draws."""
    return f"{name}{_DRAWN}"


def is_drawn(file: str) -> bool:
    """Whether a file holds the numbers that a figure draws."""
    return file.endswith(_DRAWN)


def vector_file(name: str) -> str:
    """The file of a figure as a drawing, which is sharp at any size: every run packs one for its page."""
    return f"{name}{_VECTOR}"


def is_vector(file: str) -> bool:
    """Whether a file holds the packed drawing of a figure."""
    return file.endswith(_VECTOR)


def unpacked(file: str) -> str:
    """The name of a file of a run as its page has it: what stands beside a picture is not packed there."""
    return file.removesuffix(".xz") if is_drawn(file) or is_vector(file) else file


def figure_formats(formats: Sequence[Format]) -> tuple[Format, ...]:
    """The formats of figures among those of an experiment; the default where only tables have one."""
    return tuple(kind for kind in formats if kind != TEX) or (DEFAULT_FORMAT,)


def in_format(file: str) -> Format | None:
    """The format of a file that a run writes in the formats that it is asked for; None of another."""
    suffix = file.rpartition(".")[2]
    return next((kind for kind in FORMATS if kind == suffix), None)


def misnamed(tables: Iterable[str], figures: Iterable[str]) -> Iterator[tuple[str, str, str]]:
    """The names of tables and figures that cannot be those of files: section, name, and why.

    What differs in capitals only is one file on many systems.
    """
    writers = {**dict.fromkeys(reversed(OWN), "a run"), SENSITIVITY: "accept"}
    kept = {file.partition(".")[0]: f"{file}, which {writer}" for file, writer in writers.items()}
    taken = dict.fromkeys(OWN, "a file of every run")
    sections = (
        ("tables", tables, [table_file]),
        ("figures", figures, [figure_file, drawn_file, vector_file]),
    )
    for section, names, files_of in sections:
        for name in names:
            folded = name.casefold()
            files = [file_of(folded) for file_of in files_of]
            if len(name) > _LONGEST:
                yield section, name, f"a name has at most {_LONGEST} characters, not {len(name)}"
            elif _DEVICES.fullmatch(folded):
                yield section, name, f"the name '{name}' is that of a device under Windows: take another"
            elif section == "tables" and folded in kept:
                yield section, name, f"the name '{name}' is kept for {kept[folded]} writes itself"
            elif file := next((file for file in files if file in taken), None):
                yield section, name, f"would be written to the file of {taken[file]}: take another name"
            taken |= dict.fromkeys(files, f"{section}.{name}")
