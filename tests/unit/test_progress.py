"""What a run shows while it goes, by a clock that the test turns."""

import pytest

from hident.progress import Bar, Lines


class Clock:
    """A clock that stands until it is turned."""

    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_a_line_comes_every_ten_seconds_of_the_clock_however_many_trials_end(clock, capsys):
    lines = Lines("tiny", clock)
    lines.start(200, 0)
    for second in range(1, 100):
        clock.now = second
        lines.advance(2)
    lines.finish()
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "tiny: 200 trials",
        *[f"tiny: {20 * i}/200 trials, 2 a second, {100 - 10 * i} s left" for i in range(1, 10)],
        "tiny: 198/200 trials done, 99.0 s",
    ]


def test_the_bar_has_the_rate_of_the_trials_that_were_computed(clock, capsys):
    bar = Bar("tiny", clock)
    bar.start(100, 20)
    clock.now = 8.0
    bar.advance(40)
    bar.finish()
    said = capsys.readouterr().err
    assert said.startswith("tiny: 100 trials, 20 of them stored\n")
    assert "60/100" in said
    assert "5 trials/s" in said
