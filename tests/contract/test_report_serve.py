"""hident report --serve: what is served, to whom, and when it is made again."""

from __future__ import annotations

import http.client
import os
import re
import shutil
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hident.commands.serving import HOST, state
from hident.engine.run_files import PAGE
from tests.accepted import RESULTS
from tests.documented import blocks
from tests.forked import Forked, run_forked

_LONGEST = 120.0
"""Seconds after which what is waited for does not come any more."""
TITLE = "Mzyk 2009, Table I: the closest reading"


class Served:
    """A folder with one run, whose site is served."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.run = Path(shutil.copytree(RESULTS / "mzyk_table1", folder / "results/mzyk_table1"))
        with (folder / "log.txt").open("wb") as file:
            self.process = Forked(("report", "results", "--serve", "--port", "0"), folder, file, file)
        self.port = int(self.await_(lambda: re.search(rf"http://{re.escape(HOST)}:(\d+)/ ", self.log))[1])

    @property
    def log(self) -> str:
        return (self.folder / "log.txt").read_text()

    def await_(self, found: Callable[[], Any]) -> Any:
        """What is found, as soon as it is."""
        end = time.monotonic() + _LONGEST
        while not (there := found()):
            assert time.monotonic() < end and self.process.poll() is None, self.log
            time.sleep(0.02)
        return there

    def get(self, path: str, host: str | None = None) -> tuple[int, str]:
        connection = http.client.HTTPConnection(HOST, self.port, timeout=_LONGEST)
        connection.request("GET", path, headers={"Host": host or f"{HOST}:{self.port}"})
        answer = connection.getresponse()
        text = answer.read().decode(errors="replace")
        connection.close()
        return answer.status, text


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = Served(tmp_path_factory.mktemp("served"))
    yield served
    served.process.kill()
    served.process.wait()


def test_the_commands_of_the_page(tmp_path: Path) -> None:
    shell = "".join(blocks("docs/site.md", "sh"))
    report, serve = re.findall(r"^hident (.*?) +#", shell, re.M)
    assert serve == f"{report} --serve"
    # What the page says of a folder without out/.
    shutil.copytree(RESULTS / "mzyk_table1", tmp_path / "results/mzyk_table1")
    done = run_forked(report.split(), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert TITLE in (tmp_path / "site/runs/mzyk_table1.html").read_text()


def test_the_site_is_served(served: Served) -> None:
    assert served.get("/") == (200, (served.folder / "site/index.html").read_text())
    status, text = served.get("/runs/mzyk_table1.html?x#y")
    assert status == 200 and TITLE in text


@pytest.mark.parametrize(
    "path",
    [
        "/../log.txt",
        "/%2e%2e/log.txt",
        "/runs/..%2f..%2flog.txt",
        "//log.txt",
        "/.files",
        "/runs/.hidden",
        "/out",
        "/linked/log.txt",
        "/linked.txt",
        "/static/",
        "/no%00thing",
    ],
)
def test_nothing_else_is_served(served: Served, path: str) -> None:
    site = served.folder / "site"
    for link, target in (("linked", served.folder), ("linked.txt", served.folder / "log.txt")):
        if not (site / link).is_symlink():
            (site / link).symlink_to(target)
    status, text = served.get(path)
    assert status == 404 and "http://127" not in text


def test_it_is_served_to_this_machine_alone(served: Served) -> None:
    assert served.get("/", "elsewhere.example")[0] == 403
    assert served.get("/", f"localhost:{served.port}")[0] == 200
    other = socket.socket()
    try:
        # Another address of this machine.
        assert other.connect_ex(("127.0.0.2", served.port)) != 0
    finally:
        other.close()


def test_a_port_that_is_taken_is_an_error(served: Served, tmp_path: Path) -> None:
    shutil.copytree(served.run, tmp_path / "results/mzyk_table1")
    ended = run_forked(("report", "results", "--serve", "--port", str(served.port)), tmp_path)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == (
        f"error: --port {served.port}: cannot be used (address already in use): name another one, or 0 for "
        "any that is free\n"
    )
    assert not (tmp_path / "site").exists()


def test_a_port_without_a_server_is_an_error(tmp_path: Path) -> None:
    ended = run_forked(("report", "--port", "8000"), tmp_path)
    assert (ended.returncode, ended.stderr) == (
        2,
        "error: --port is for --serve: without it, files are written and nothing is served\n",
    )


def test_it_is_made_again_when_results_change_and_ends_cleanly(served: Served) -> None:
    wang = served.folder / "results/wang_table1"
    shutil.copytree(RESULTS / "wang_table1", wang)
    served.await_(lambda: served.get("/runs/wang_table1.html")[0] == 200)
    page = served.run / PAGE
    page.write_text(page.read_text().replace("Step 1: bias", "Step 1: the bias"))
    served.await_(lambda: "unsound: results/mzyk_table1: table.md is not as" in served.log)
    shutil.rmtree(served.folder / "results")
    # What is wrong is said, and the site stays.
    served.await_(lambda: "error: results holds no run" in served.log)
    assert served.get("/runs/wang_table1.html")[0] == 200
    os.kill(served.process.pid, signal.SIGINT)
    assert served.process.wait() == 0
    assert served.log.endswith("ended\n") and "Traceback" not in served.log


def test_what_is_hidden_and_the_site_itself_are_not_looked_at(tmp_path: Path) -> None:
    for name in ("a.csv", "runs/b.csv", ".c", ".new/d", "site/e.html"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = state([tmp_path, tmp_path / "gone"], tmp_path / "site")
    assert {*found} == {tmp_path / "a.csv", tmp_path / "runs/b.csv"}
    (tmp_path / "a.csv").write_text("1")
    assert state([tmp_path], tmp_path / "site") != found
