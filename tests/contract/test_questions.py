"""docs/questions.md: each message is brought about, and printed as it stands there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from hident.engine.store import Store
from tests.documented import ROOT, blocks
from tests.forked import run_forked

PAGE = "docs/questions.md"
TEXT = (ROOT / PAGE).read_text(encoding="utf-8")
[BASE] = blocks(PAGE, "yaml")
SHOWN = dict(re.findall(r"^### (.*?)\n\n```text\n(.*?)```", TEXT, re.DOTALL | re.MULTILINE))
PLUGIN = '''
from hident.config.spec import component
from hident.estimators.base import EstimatorSpec


@component("estimator", "KIND")
class Mine(EstimatorSpec):
    """Something of one's own."""

    def names(self):
        return ["a_1"]

    def fit(self, record, rng=None):
        return record.u / None
'''
FILES = {
    "mine.py": PLUGIN.replace("KIND", "mine"),
    "twice.py": PLUGIN.replace("KIND", "kernel"),
    "broken.py": "import nothing_of_that_name\n",
    "tank.csv": "pump,level\n" + "".join(f"{i % 3},{i % 5}\n" for i in range(40)),
    "experiments/smith/published.csv": "table,row,quantity,printed,note\nTable 1,N=200,MISE,0.9,\n",
}
SIMULATED = BASE[BASE.index("system:") : BASE.index("cases:")]
CASES = "cases:\n  samples: [200, 400]\n"
MEASURED = "record: {file: tank.csv, input: pump, output: level}\n"
PRINTED = 'published: {paper_trials: 1, cells: [{table: Table 1, row: "N={samples}", quantity: MISE, \
estimator: kernel, metric: mise}]}\n'
POLE_ALONE = (
    ("  kernel: {kind: kernel, kernel: gaussian, bandwidth: {h0: 0.5, alpha: 1/5}}\n", ""),
    ("  mise: {kind: mise, interval: [-3, 3], estimators: [kernel]}\n", ""),
    ("kind: error, of", "kind: value, of"),
    (BASE[BASE.index("tables:") :], ""),
)
# By title: what is changed in the file, what stands at its end besides, and the command.
VALIDATE = "hident validate my.yaml"
BROUGHT_ABOUT: dict[str, tuple[tuple[tuple[str, str], ...], str, str, int]] = {
    "Which file?": ((), "", "hident validate your.yaml", 2),
    "A key that is not known": ((("std: 0.1", "sd: 0.1"),), "", VALIDATE, 2),
    "A key that is missing": ((("trials: 5\n", ""),), "", VALIDATE, 2),
    "A kind that is not known": ((("kind: least_squares", "kind: least_square"),), "", VALIDATE, 2),
    "No number": ((("std: 0.1", "std: small"),), "", VALIDATE, 2),
    "A formula that cannot be read": ((("alpha: 1/5", "alpha: a/5"),), "", VALIDATE, 2),
    "A variable without an axis": ((("std: 0.1", "std: $sigma"),), "", VALIDATE, 2),
    "An axis without a list": ((("[200, 400]", "200"),), "", VALIDATE, 2),
    "A key twice": ((("trials: 5", "trials: 5\ntrials: 6"),), "", VALIDATE, 2),
    "No valid YAML": ((("Two methods", "Two: methods"),), "", VALIDATE, 2),
    "A table of something that is not there": ((("metric: mise}", "metric: error}"),), "", VALIDATE, 2),
    "Setting what the cases set": ((), "", f"{VALIDATE} --set samples=100", 2),
    "A metric that an estimator does not serve": (((", estimators: [pole]", ""),), "", VALIDATE, 2),
    "A record that is too short": ((("[200, 400]", "[1, 400]"),), "", VALIDATE, 2),
    "An unstable block": ((("a: [0.5]", "a: [1.5]"),), "", VALIDATE, 2),
    "Simulated and measured at once": ((), MEASURED, VALIDATE, 2),
    "Trials of a measured record": (((SIMULATED + CASES, MEASURED), *POLE_ALONE), "", VALIDATE, 2),
    "A column that is not there": (
        ((SIMULATED + CASES, MEASURED.replace("level", "lvl")), *POLE_ALONE),
        "",
        VALIDATE,
        2,
    ),
    "No such plugin": ((), "plugins: [mien.py]\n", VALIDATE, 2),
    "A plugin that cannot be loaded": ((), "plugins: [broken.py]\n", VALIDATE, 2),
    "A name that is taken": ((), "plugins: [twice.py]\n", VALIDATE, 2),
    "Trials that crash": (
        (("kind: least_squares, order: 1", "kind: mine"),),
        "plugins: [mine.py]\n",
        "hident run my.yaml --jobs 1 --quiet",
        3,
    ),
    "No paper": ((), f"paper: smyth\n{PRINTED}", VALIDATE, 2),
    "A number that is not printed": ((), f"paper: smith\n{PRINTED}", VALIDATE, 2),
    "Nothing to verify": ((), "", "hident verify out", 4),
    "Nothing to accept": ((), "", "hident accept my", 4),
    "Another run": ((), "", "hident run my.yaml --jobs 1 --quiet", 75),
    "A folder that is none": ((), "", "hident run my.yaml --jobs 1 --quiet --store my.yaml", 2),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("questions")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def test_every_message_is_brought_about() -> None:
    assert list(SHOWN) == list(BROUGHT_ABOUT)
    assert len(SHOWN) == TEXT.count("```text")


@pytest.mark.parametrize("title", BROUGHT_ABOUT)
def test_a_message_is_printed_as_it_stands_there(title: str, folder: Path) -> None:
    changes, more, command, code = BROUGHT_ABOUT[title]
    text = BASE
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "my.yaml").write_text(text + more, encoding="utf-8")
    if title == "Another run":
        with Store(folder / ".hident").writing():
            ended = run_forked(shlex.split(command)[1:], folder)
    else:
        ended = run_forked(shlex.split(command)[1:], folder)
    assert ended.returncode == code
    pattern = ".*".join(map(re.escape, SHOWN[title].rstrip("\n").split("...")))
    assert re.fullmatch(f"{pattern}\n?", ended.stderr, re.DOTALL), ended.stderr
