"""The printed numbers of Chen, Hwang and Chang 2009, judged from the accepted trials."""

import math

import pytest

from tests.accepted import accepted_verdicts


def judged(name):
    """The verdicts of a configuration of the paper, by row and quantity."""
    return {(v.printed.row, v.printed.quantity): v for v in accepted_verdicts(f"chen_{name}")}


def differing(found):
    return {key for key, v in found.items() if v.word == "differs"}


def is_factor(quantity):
    return quantity.endswith("VIF")


@pytest.mark.parametrize(
    ("table", "parameters", "outside"),
    [("table1", 64, set()), ("table2", 44, {("case G, stage 1", "a3")})],
)
def test_the_parameters_of_the_tables_come_out(table, parameters, outside):
    found = {key: v for key, v in judged(table).items() if not is_factor(key[1])}
    assert len(found) == parameters
    # One of so many lies beyond the central 95 % by chance.
    assert differing(found) == outside


@pytest.mark.parametrize("name", ["table1", "vif"])
def test_the_factors_of_type_1_are_rarely_as_small_as_printed(name):
    found = {key: v for key, v in judged(name).items() if is_factor(key[1])}
    assert len(found) == {"table1": 24, "vif": 12}[name]
    rare = {(f"type I, case {c}, stage 2", f"{which} VIF") for c in "ABC" for which in ("mean", "max")}
    assert differing(found) == rare
    assert all(found[key].reason for key in rare)
    assert "cannot lie below their mean" in found["type I, case C, stage 2", "max VIF"].reason


def test_the_factors_of_case_d_are_rarely_as_large_as_printed():
    found = {key: v for key, v in judged("table2").items() if is_factor(key[1])}
    assert len(found) == 16
    assert differing(found) == {("case D, stage 1", "max VIF")}
    by_interval = {
        (v.series.unit.labels["interval"], v.printed.row, v.printed.quantity): v
        for v in accepted_verdicts("chen_vif_wiener")
    }
    assert len(by_interval) == 8
    stage_1 = {("0.1", "case D, stage 1", f"{which} VIF") for which in ("mean", "max")}
    assert differing(by_interval) == stage_1
    for quantity, centre in (("mean VIF", 46), ("max VIF", 110)):
        verdict = found["case D, stage 1", quantity]
        assert verdict.ours == pytest.approx(centre, rel=0.1)
        assert verdict.printed.value > 2.5 * verdict.ours


def test_table_3_gives_the_printed_steady_states():
    found = judged("table3")
    assert len(found) == 5
    assert {v.word for v in found.values()} == {"exact"}


def test_the_horizons_and_settling_times_of_examples_1_and_2_come_out():
    found = {(v.printed.table, v.printed.row, v.printed.quantity): v for v in accepted_verdicts("chen_text")}
    assert len(found) == 14
    # One printed digit, "about 10", excludes nothing.
    assert {v.word for (*_, quantity), v in found.items() if quantity == "settling time"} == {"untestable"}
    assert {v.word for (*_, quantity), v in found.items() if quantity != "settling time"} == {"exact"}
    horizons = {v.printed.printed for (*_, quantity), v in found.items() if quantity == "N"}
    assert horizons == {"55", "43", "185", "68", "175", "27", "107"}
    for example, row, settling in (("Example 1", "linear element", 10.8), ("Example 2", "process", 10.1)):
        assert found[example, row, "settling time"].ours == pytest.approx(settling, abs=0.05)


def test_example_3_finds_the_time_constant():
    found = judged("example3")
    assert len(found) == 5
    assert differing(found) == {("theory", "time constant")}
    theory = found["theory", "time constant"]
    assert "14.0 cm" in theory.reason
    flow, valve, area = 16.6 + 0.55 + 15.6, 8.75, 207.0
    assert theory.ours == pytest.approx(area * (flow / valve) ** 2 / flow, rel=1e-12)
    # The printed one, with the level in whole tenths.
    assert theory.printed.value == pytest.approx(area * 14.0 / flow, abs=0.005)
    assert found["steady state", "pH at q_3=15.6"].word == "exact"


def test_example_4_finds_one_time_constant_around_three_steady_states():
    found = judged("example4")
    assert len(found) == 14
    assert differing(found) == {("q_b=14.2", "b0")}
    for flow in ("13.5", "14.2", "15"):
        assert found["steady states", f"pH at q_b={flow}"].word == "exact"
        # It rounds to the printed digit, and to the same under every alternative.
        assert found[f"q_b={flow}", "eta of stage 2"].word == "untestable"
        a_1 = found[f"q_b={flow}", "a1"]
        assert a_1.ours == pytest.approx(1.0 / (14.2 + float(flow)), rel=0.05)
    for flow in ("13.5", "15"):
        assert found["process", f"V/(q_a + q_b) at q_b={flow}"].word == "exact"
    gains = [found[f"q_b={flow}", "b0"].ours for flow in ("13.5", "14.2", "15")]
    assert max(gains) > 10 * min(gains)


def test_example_5_comes_out():
    found = judged("example5")
    assert len(found) == 11
    assert differing(found) == set()
    assert found["steady state", "C_B at F=34.3"].word == "exact"
    assert found["process", "F where the gain changes sign"].word == "exact"
    assert found["Wiener", "settling time, h"].ours == pytest.approx(0.037, abs=0.003)


def test_example_6_finds_the_hammerstein_model_but_not_the_fast_mode_of_the_wiener_model():
    found = judged("example6")
    assert len(found) == 11
    assert differing(found) == {("Wiener", "b1")}
    # Half of the trials are well below the printed number.
    assert found["Wiener", "b1"].ours < 0.8 * 204.3
    for quantity in ("c1", "c2"):
        verdict = found["Hammerstein", quantity]
        assert math.isclose(verdict.ours, verdict.printed.value, rel_tol=0.02)
