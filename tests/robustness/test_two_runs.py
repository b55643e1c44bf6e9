"""Two runs at once on one store."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.conftest import Lab


@pytest.fixture
def busy(lab: Lab) -> Lab:
    """A laboratory in which a run waits for as long as the file `hold` is there."""
    lab.probe("""
        Path("reached").touch()
        while Path("hold").exists():
            time.sleep(0.005)
    """)
    (lab.folder / "hold").touch()
    lab.start("run", "tiny.yaml", "--jobs", "1")
    lab.await_((lab.folder / "reached").exists)
    return lab


def test_second_run_ends_at_once_or_waits_and_finds_everything_done(busy: Lab) -> None:
    assert busy.run(code=75) == (
        "error: another run holds the trials store .hident/trials.sqlite; try again when it has ended, or "
        "wait for it with --wait SECONDS\n"
    )
    # Reading goes on meanwhile.
    assert "24" in busy.hident("status", "tiny.yaml").stdout
    first = busy.started[0]
    waiting = busy.start("run", "tiny.yaml", "--jobs", "1", "--wait", "86400", log="second.txt")
    assert first.poll() is None
    (busy.folder / "hold").unlink()
    assert first.wait() == 0
    assert waiting.wait() == 0
    assert "24/24 trials done" in busy.log
    assert (busy.folder / "second.txt").read_text().startswith("tiny: out/tiny is up to date\n")


def test_lock_of_a_killed_run_does_not_block(busy: Lab) -> None:
    busy.started[0].kill()
    busy.started[0].wait()
    assert (busy.folder / ".hident/lock").exists()
    (busy.folder / "hold").unlink()
    busy.run()
