"""What a run shows while it goes, by a clock that the test turns."""

import pytest

from hident.progress import Bar, Lines, duration, rate_of, reminder


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
        *[f"tiny: {20 * i}/200 trials, 2 trials/s, {100 - 10 * i} s left" for i in range(1, 10)],
        "tiny: 198/200 trials done, 99.0 s",
    ]


def test_the_bar_has_the_rate_of_the_trials_that_were_computed(clock, capsys):
    bar = Bar("tiny", clock)
    bar.start(100, 20)
    # Until the first one ends, workers start.
    clock.now = 50.0
    bar.advance(1)
    clock.now = 58.0
    bar.advance(40)
    bar.finish()
    said = capsys.readouterr().err
    assert said.startswith("tiny: 100 trials, 20 of them stored\n")
    assert "61/100" in said
    assert "5 trials/s" in said


def test_a_slow_start_is_not_taken_for_the_rate(clock, capsys):
    lines = Lines("tiny", clock)
    lines.start(7200, 0)
    clock.now = 14.0
    lines.advance(4)
    lines.look()
    clock.now = 24.0
    lines.advance(2000)
    lines.look()
    lines.finish()
    assert capsys.readouterr().err.splitlines() == [
        "tiny: 7200 trials",
        "tiny: 4/7200 trials",
        "tiny: 2004/7200 trials, 200 trials/s, 26 s left",
        "tiny: 2004/7200 trials done, 24.0 s",
    ]


@pytest.fixture(params=[Lines, Bar])
def shown(request, clock, monkeypatch):
    """Progress whose looks at the clock are the test's alone."""
    monkeypatch.setattr("hident.progress._LOOK_SECONDS", 900.0)
    return request.param("tiny", clock, estimates=4)


def _said(capsys):
    """What was said besides progress, in one line."""
    return " ".join(capsys.readouterr().err.split())


def test_a_run_that_takes_long_says_once_what_it_costs_and_what_changes_that(shown, clock, capsys):
    shown.start(4000, 0)
    for second in (1, 9, 10, 11, 60):
        clock.now = second
        shown.advance(1)
        shown.look()
    shown.finish()
    notice = (
        "tiny: about 5.0 h to go for 3997 trials of 4 estimates; fewer --trials, more --jobs or a "
        "--trial-timeout shorten it, and Ctrl-C keeps what is stored"
    )
    assert _said(capsys).count(notice) == 1


def test_a_run_that_does_not_take_long_says_nothing_of_it(shown, clock, capsys):
    shown.start(4000, 0)
    clock.now = 10
    shown.advance(70)
    shown.look()
    shown.finish()
    assert "about" not in _said(capsys)


def test_where_nothing_ends_it_says_what_is_at_work_and_how_to_stop_it_less_and_less_often(
    shown, clock, capsys
):
    shown.start(4000, 0)
    shown.begins("trial 0 of 'voros' at samples 50")
    shown.begins("trial 0 of 'voros' at samples 80")
    for second in range(75):
        clock.now = second
        shown.look()
    said = _said(capsys)
    of = "at work on trial 0 of 'voros' at samples 50. Ctrl-C stops, and --trial-timeout SECONDS ends trials"
    assert [said.count(f"tiny: nothing has ended for {seconds} s; {of}") for seconds in (10, 20, 40)] == [
        1
    ] * 3
    assert said.count("nothing has ended") == 3
    shown.advance(1)
    shown.ends("trial 0 of 'voros' at samples 50")
    clock.now = 200.0
    shown.look()
    assert "for 2 min; at work on trial 0 of 'voros' at samples 80" in _said(capsys)
    shown.ends("trial 0 of 'voros' at samples 80")
    clock.now = 900.0
    shown.look()
    assert "nothing has ended" not in _said(capsys)
    shown.finish()


@pytest.mark.parametrize("quiet", [False, True])
def test_what_goes_on_for_long_is_said_unless_quiet(quiet, monkeypatch, capsys):
    monkeypatch.setattr("hident.progress._EVERY_SECONDS", 0.0)
    said = ""
    with reminder("still at it", quiet=quiet):
        while not quiet and not said:
            said = capsys.readouterr().err
    assert said + capsys.readouterr().err == ("" if quiet else "still at it\n")


def test_what_ends_soon_is_not_said(capsys):
    with reminder("still at it", quiet=False):
        pass
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.4, "0 s"), (119, "119 s"), (126, "2 min"), (7000, "117 min"), (13000, "3.6 h"), (1e6, "12 days")],
)
def test_durations(seconds, said):
    assert duration(seconds) == said


@pytest.mark.parametrize(
    ("trials", "seconds", "said"),
    [(10, 5, "2 trials/s"), (10, 20, "30 trials/min"), (1, 1200, "3 trials/h"), (0, 5, "0 trials/h")],
)
def test_rates(trials, seconds, said):
    assert rate_of(trials, seconds) == said
