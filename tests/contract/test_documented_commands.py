"""Every block of code in README.md and docs/ belongs to a test, and all commands have their options."""

from __future__ import annotations

import re
import shlex

import pytest
import typer.main

from hident.cli import app
from tests.documented import ROOT, commands

PAGES = ["README.md", *sorted(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md"))]
# What runs the blocks of a language, or why nothing does: what is made is what CI and `make torture` do.
MAKE = "the targets of make are there"
WAYS, CODE = "test_documented_ways.py", "test_documented_code.py"
CONFIGURATIONS, CLUSTERS = "test_documented_configurations.py", "takes a cluster, a container or another host"
RUN_BY = {
    "README.md": {**dict.fromkeys(("yaml", "python"), CODE), "": MAKE},
    "docs/concepts.md": {"python": WAYS},
    "docs/configuration.md": {"yaml": CONFIGURATIONS, "bash": CODE},
    "docs/extending.md": dict.fromkeys(("python", "yaml", "console"), "test_extending.py"),
    "docs/measurements.md": dict.fromkeys(("python", "yaml", "sh"), "test_documented_measurements.py"),
    "docs/publication.md": dict.fromkeys(("yaml", "console", "python", "tex"), CONFIGURATIONS),
    "docs/python.md": {"python": CODE},
    "docs/questions.md": dict.fromkeys(("yaml", "text"), "test_questions.py"),
    "docs/reproducing.md": dict.fromkeys(("yaml", "csv", "console", "text"), WAYS),
    "docs/robustness.md": {"": MAKE},
    "docs/scale.md": dict.fromkeys(("bash", "console", "python", "dockerfile"), CLUSTERS),
    "docs/site.md": {"sh": "test_report_serve.py"},
    "docs/tutorial.md": dict.fromkeys(("yaml", "console", "text"), WAYS),
}


def _text(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def test_every_block_of_code_is_run_by_a_test() -> None:
    found = {page: {language for language, _ in _blocks(page)} for page in PAGES}
    assert {page: languages for page, languages in found.items() if languages} == {
        page: {*by} for page, by in RUN_BY.items()
    }
    for page, by in RUN_BY.items():
        for test in {*by.values()} - {CLUSTERS, MAKE}:
            assert page in (ROOT / "tests" / "contract" / test).read_text(encoding="utf-8"), page


def _blocks(page: str) -> list[tuple[str, str]]:
    """The language and the lines of each block."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", _text(page), re.M | re.S)


def _in_blocks(page: str) -> list[str]:
    lines = "".join(block for _, block in _blocks(page)).replace("\\\n", " ")
    return re.findall(r"^(hident [a-z].*)$", lines, re.M)


def test_the_targets_of_make_are_there() -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    for page, by in RUN_BY.items():
        if MAKE in by.values():
            named = re.findall(r"^make ([\w-]+)", "".join(block for _, block in _blocks(page)), re.M)
            assert named
            assert {*named} <= targets, page


def test_the_scripts_for_clusters_are_python() -> None:
    scripts = [block for language, block in _blocks("docs/scale.md") if language == "python"]
    assert len(scripts) == 3
    for script in scripts:
        compile(script, "docs/scale.md", "exec")


@pytest.mark.parametrize("page", PAGES)
def test_the_verbs_and_options_of_every_command_are_there(page: str) -> None:
    verbs = typer.main.get_group(app).commands
    for command in dict.fromkeys((*commands(page), *_in_blocks(page))):
        _, *words = shlex.split(command.partition(" | ")[0], comments=True)
        options = {word.partition("=")[0] for word in words if word.startswith("-")} - {"--help", "--version"}
        if words[0].startswith("-"):
            assert not options, command
            continue
        assert words[0] in verbs, command
        known = {option for param in verbs[words[0]].params for option in param.opts}
        assert options <= known, command
