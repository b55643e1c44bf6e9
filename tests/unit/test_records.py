"""Records: what measurements must be like."""

import numpy as np
import pytest

from hident.records import Record

U, Y = np.arange(5.0), np.arange(5.0) ** 2


def test_a_record_of_evenly_spaced_times_knows_its_interval():
    record = Record.at(np.array([1.0, 1.1, 1.2, 1.3, 1.4]), U, Y)
    assert record.dt == pytest.approx(0.1, rel=1e-12)
    assert len(record) == 5


def test_times_rounded_in_the_file_are_even():
    assert Record.at(np.round(np.arange(5) / 3, 4), U, Y).dt == pytest.approx(1 / 3, rel=1e-4)


@pytest.mark.parametrize(
    ("t", "message"),
    [
        (
            [0, 1, 2, 3.5, 4],
            "the sampling is not uniform: from t = 2 to 3.5 the interval is 1.5, and 1 on average "
            r"\(allowed: 0.001 of it off\); interpolate the record to even times first",
        ),
        ([0, 1, 2, 2, 4], "the sampling is not uniform: from t = 2 to 2 the interval is 0, and 1 on average"),
        ([0, 1, 2, np.nan, 4], "the sampling is not uniform"),
        ([4, 3, 2, 1, 0], "the sampling is not uniform"),
    ],
)
def test_uneven_times_are_refused(t, message):
    with pytest.raises(ValueError, match=message):
        Record.at(np.array(t, dtype=float), U, Y)


def test_one_sample_has_no_interval():
    with pytest.raises(ValueError, match="needs at least 2 samples, not 1"):
        Record.at(np.zeros(1), U[:1], Y[:1])


def test_input_and_output_go_together():
    with pytest.raises(ValueError, match=r"not of shapes \(5,\) and \(4,\)"):
        Record.at(np.arange(5.0), U, Y[:4])
