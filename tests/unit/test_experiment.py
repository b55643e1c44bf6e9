import copy
import json
from functools import partial
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hident import plugins
from hident.engine.experiment import load
from hident.errors import ConfigError
from tests.unit.counted_calls import counted_calls
from tests.unit.plans import refusals

BASE = """\
version: 1
title: Base
trials: 2
system:
  kind: hammerstein
  nonlinearity: identity
  linear: {kind: ar, a: [0.8]}
excitation: {kind: iid, distribution: uniform, low: -2*pi, high: 2*pi}
noise: {kind: white, std: 0.1}
samples: 50
estimators:
  k: {kind: kernel, kernel: window_unit, bandwidth: {h0: 0.2, alpha: 1/5}}
  iv: {kind: instrumental_variables, order: 1, instrument: identity}
metrics:
  mise: {kind: mise, interval: [-1, 1], estimators: [k]}
  a: {kind: error, of: [a_1], estimators: [iv]}
"""


@pytest.fixture(scope="module", autouse=True)
def _components():
    plugins.load()


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "a.yaml"
        path.write_text(text)
        return path

    return write


@pytest.fixture
def refused(tmp_path):
    return partial(refusals, tmp_path)


def with_(*replacements, more=""):
    text = BASE
    for old, new in replacements:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text + more


def setting(part, *names):
    """The value of a nested field."""
    for name in names:
        part = getattr(part, name)
    return part


def units(plan):
    return [(unit.name, *unit.labels.values()) for unit in plan.units]


class TestExpansion:
    def test_without_cases_there_is_one_unit_for_each_estimator(self, write):
        plan = load(write(BASE))
        assert plan.name == "a"
        assert units(plan) == [("k",), ("iv",)]
        k, iv = plan.units
        assert k.data == iv.data
        assert (k.metric_labels, iv.metric_labels) == (("mise",), ("a a_1",))
        assert (k.described(), plan.axes) == ("estimator 'k'", ())

    def test_axes_expand_to_their_product_case_by_case(self, write):
        plan = load(write(with_(("samples: 50\n", ""), more="cases: {samples: [50, 60], noise.std: [0, 1]}")))
        cases = [(50, 0), (50, 1), (60, 0), (60, 1)]
        assert units(plan) == [(name, *case) for case in cases for name in ("k", "iv")]
        assert [unit.data.samples for unit in plan.units] == [50] * 4 + [60] * 4
        assert [setting(unit.data.noise[0], "std") for unit in plan.units] == [0.0, 0.0, 1.0, 1.0] * 2
        assert plan.units[-1].described() == "estimator 'iv' at samples 60, noise.std 1"

    def test_an_axis_multiplies_only_what_it_touches(self, write):
        plan = load(
            write(
                with_(
                    more="cases:\n"
                    "  samples: [50, 60]\n"
                    "  estimators.k.bandwidth.h0: [1, 2, 3]\n"
                    "  metrics.a.of: [[a_1], [c]]\n"
                )
                .replace("of: [a_1]", "kind: value, of: [a_1]")
                .replace("kind: error, ", "")
            )
        )
        assert units(plan) == [
            *(("k", 50, h) for h in (1, 2, 3)),
            ("iv", 50, "['a_1']"),
            ("iv", 50, "['c']"),
            *(("k", 60, h) for h in (1, 2, 3)),
            ("iv", 60, "['a_1']"),
            ("iv", 60, "['c']"),
        ]
        assert [unit.metric_labels for unit in plan.units[3:5]] == [("a a_1",), ("a c",)]

    def test_labels_name_several_patches_and_the_first_completes_the_file(self, write):
        plan = load(
            write(
                with_(
                    ("excitation: {kind: iid, distribution: uniform, low: -2*pi, high: 2*pi}\n", ""),
                    more="cases:\n"
                    "  input:\n"
                    "    wide: {excitation: {kind: iid, distribution: gaussian, std: 3}, noise.std: 1}\n"
                    "    sine: {excitation: {kind: sine, period: 10}, estimators.k.bandwidth.h0: 9}\n",
                )
            )
        )
        assert units(plan) == [("k", "wide"), ("iv", "wide"), ("k", "sine"), ("iv", "sine")]
        wide, _, sine, _ = plan.units
        assert (wide.data.excitation.kind, sine.data.excitation.kind) == ("iid", "sine")
        # What one label sets does not stay for the next.
        assert (setting(wide.data.noise[0], "std"), setting(sine.data.noise[0], "std")) == (1.0, 0.1)
        assert (setting(wide.estimator, "bandwidth", "h0"), setting(sine.estimator, "bandwidth", "h0")) == (
            0.2,
            9.0,
        )
        assert plan.experiment.excitation is not None
        assert plan.experiment.excitation.kind == "iid"

    def test_a_label_may_leave_the_file_as_it_is(self, write):
        plan = load(write(with_(more="cases: {noise level: {small: {}, large: {noise.std: 5}}}")))
        assert [setting(unit.data.noise[0], "std") for unit in plan.units] == [0.1, 0.1, 5.0, 5.0]

    def test_a_later_axis_may_change_what_an_earlier_one_sets(self, write):
        plan = load(
            write(
                with_(
                    more="cases:\n"
                    "  estimators.iv:\n"
                    "    one: {estimators.iv: {kind: least_squares, order: 1}}\n"
                    "    two: {estimators.iv: {kind: least_squares, order: 2}}\n"
                    "  estimators.k.bandwidth: {a: {estimators.k.bandwidth: {h0: 1, alpha: 0.5}}}\n"
                    "  h: {x: {estimators.k.bandwidth.h0: 7}, y: {estimators.iv.order: 4}}\n"
                )
            )
        )
        found = {(unit.name, *unit.labels.values()): unit.estimator for unit in plan.units}
        assert setting(found["k", "a", "x"], "bandwidth", "h0") == 7.0
        assert setting(found["k", "a", "y"], "bandwidth", "h0") == 1.0
        assert [setting(found["iv", one, h], "order") for one in ("one", "two") for h in "xy"] == [1, 4, 2, 4]

    def test_labels_of_values_that_are_no_texts_or_numbers_are_written_as_yaml(self, write):
        text = with_(more="cases: {estimators.k.known_point: [null], metrics.a.of: [[a_1], [a_1, a_1]]}")
        assert units(load(write(text))) == [("k", "null"), ("iv", "['a_1']"), ("iv", "['a_1', 'a_1']")]

    def test_a_thousand_units_cost_no_more_each_than_two_hundred(self, write):
        def load_units(labels):
            listed = ", ".join(f"s{i}: {{samples: {i + 50}, noise.std: {i}}}" for i in range(labels))
            path = write(with_(more=f"cases: {{n: {{{listed}}}}}"))
            plans = []
            calls = counted_calls(lambda: plans.append(load(path)))
            assert len(plans[0].units) == 2 * labels
            return calls

        load_units(1)  # what is done once
        assert load_units(500) < 5 * load_units(100)

    def test_a_product_without_bounds_is_refused_at_once(self, refused):
        axes = "".join(
            f"  c{i}: {{{', '.join(f'a{j}: {{estimators.k.bandwidth.h0: {j + 1}}}' for j in range(9))}}}\n"
            for i in range(30)
        )
        assert refused(with_(more=f"cases:\n{axes}")) == [
            "a.yaml:17: cases: expands to more than 100000 estimates"
        ]
        assert refused(with_(("trials: 2", "trials: 0"), more=f"cases:\n{axes}")) == [
            "a.yaml:3: trials: must be greater than or equal to 1 (got 0)"
        ]


class TestDataKey:
    def key(self, write, *replacements):
        return load(write(with_(*replacements))).units[0].data.key

    def test_does_not_depend_on_estimators_metrics_seed_or_trials(self, write):
        key = self.key(write)
        for old, new in [
            ("h0: 0.2", "h0: 3"),
            ("order: 1", "order: 2"),
            ("[-1, 1]", "[-2, 2]"),
            ("trials: 2", "trials: 7\nseed: 5"),
            ("title: Base", "title: Other"),
        ]:
            assert self.key(write, (old, new)) == key

    def test_does_not_depend_on_how_the_data_are_written(self, write):
        key = self.key(write)
        for old, new in [
            ("-2*pi, high: 2*pi", "-2*pi, high: pi + pi"),
            (
                "{kind: iid, distribution: uniform, low: -2*pi,",
                "{low: -2*pi, kind: iid, distribution: uniform,",
            ),
            ("noise: {kind: white, std: 0.1}", "noise: [{kind: white, std: 1e-1, distribution: gaussian}]"),
            ("nonlinearity: identity", "nonlinearity: {kind: identity}"),
            ("samples: 50", "samples: 50\nstreams: numpy"),
            ("samples: 50", "cases: {samples: [50, 51]}"),
        ]:
            assert self.key(write, (old, new)) == key

    def test_depends_on_everything_that_the_data_depend_on(self, write):
        keys = [self.key(write)]
        keys += [
            self.key(write, replacement)
            for replacement in [
                ("samples: 50", "samples: 51"),
                ("samples: 50", "samples: 50\ndt: 1"),
                ("samples: 50", "samples: 50\nstreams: {kind: numpy, fixed: [input]}"),
                ("std: 0.1", "std: 0.2"),
                ("noise: {kind: white, std: 0.1}\n", ""),
                ("[0.8]", "[0.8, 0]"),
                ("high: 2*pi", "high: 3*pi"),
                ("nonlinearity: identity", "nonlinearity: abs"),
            ]
        ]
        assert len(set(keys)) == len(keys)


class TestOptions:
    def test_override_the_file(self, write):
        plan = load(
            write(BASE), ["samples=70", "estimators.k.bandwidth.h0=2*pi"], {"trials": 9, "seed": None}
        )
        assert (plan.experiment.trials, plan.experiment.seed) == (9, 1)
        assert plan.units[0].data.samples == 70
        assert setting(plan.units[0].estimator, "bandwidth", "h0") == pytest.approx(6.283185307179586)

    def test_messages_name_the_option(self, refused):
        assert refused(BASE, "samples=x", "estimators.k.kernel=gausian", trials=0, seed=-1) == [
            "--set samples=x: samples: must be a whole number >= 1, <= 100000000 (got 'x')",
            "--seed -1: seed: must be greater than or equal to 0 (got -1)",
            "--trials 0: trials: must be greater than or equal to 1 (got 0)",
            "--set estimators.k.kernel=gausian: estimators.k.kernel: must be 'window_half', 'window_unit', "
            "'triangular', 'epanechnikov' or 'gaussian'; did you mean 'gaussian'? (got 'gausian')",
        ]

    def test_a_record_that_no_memory_holds_is_refused(self, refused):
        assert refused(BASE, "samples=1e18") == [
            "--set samples=1e18: samples: must be a whole number >= 1, <= 100000000 (got 1e+18)"
        ]

    @pytest.mark.parametrize(
        ("cases", "assignment", "said"),
        [
            ("{samples: [50, 60]}", "samples=70", "samples sets this key; use --set cases.samples=[70]"),
            (
                "{n: {a: {samples: 50}, b: {samples: 60, noise.std: 1}}}",
                "samples = 70",
                "n sets this key under every label",
            ),
            (
                "{n: {a: {estimators.k.bandwidth: {h0: 1, alpha: 0.1}}}}",
                "estimators.k.bandwidth.h0=3",
                "n sets this key under every label",
            ),
        ],
    )
    def test_a_key_that_every_case_sets_cannot_be_set(self, refused, cases, assignment, said):
        assert refused(with_(more=f"cases: {cases}"), assignment) == [f"--set {assignment}: cases.{said}"]

    @pytest.mark.parametrize(
        "assignment", ["samples=70", "noise.std=2", "estimators.k.bandwidth={h0: 2, alpha: 0.1}"]
    )
    def test_a_key_that_not_every_case_sets_can_be_set(self, write, assignment):
        text = with_(
            more="cases: {n: {a: {}, b: {samples: 60, noise.std: 1}}, estimators.k.bandwidth.h0: [1]}"
        )
        assert load(write(text)).units != load(write(text), [assignment]).units

    @pytest.mark.parametrize("more", ["", "cases: {noise.nsr: [0.5], samples: [50]}\n"])
    def test_the_name_of_an_axis_may_hold_dots(self, write, more):
        text = with_(("noise: {kind: white, std: 0.1}", "noise: white"), more=more)
        plan = load(write(text), ["cases.noise.nsr=[0.1, 0.2]"])
        assert [setting(unit.data.noise[0], "nsr") for unit in plan.units[::2]] == [0.1, 0.2]


CHANGEABLE = "it can: samples, dt, system, excitation, noise, streams, record, estimators, metrics"
LABELLED = "as 'label: {key.path: value}'"


class TestMessages:
    @pytest.mark.parametrize("version", ["2", "0", "'1'", "null"])
    def test_another_version_is_told_before_anything_else(self, refused, version):
        assert refused(with_(("version: 1", f"version: {version}"), ("trials: 2", "x: y"))) == [
            f"a.yaml:1: version: this hident reads version 1 of the format (got {version})"
        ]

    @pytest.mark.parametrize("version", ["1.0", "true"])
    def test_the_version_is_a_whole_number(self, refused, version):
        assert refused(with_(("version: 1", f"version: {version}"))) == [
            f"a.yaml:1: version: this hident reads version 1 of the format (got {version})"
        ]

    def test_all_that_is_wrong_is_told_at_once_in_the_order_of_the_lines(self, refused):
        text = with_(
            ("version: 1\n", ""),
            ("trials: 2", "trials: 0\ntrials: 1"),
            ("std: 0.1", "sdt: 0.1"),
            ("h0: 0.2", "h0: -1"),
            ("samples: 50\n", ""),
            more="cases:\n  samples: [50, x]\n  estimators.iv.order: [1, 0]\n  seed: [1]\n",
        )
        assert refused(text) == [
            "a.yaml:1: version: is required: Version of the file format: 1",
            "a.yaml:2: trials: must be greater than or equal to 1 (got 0)",
            "a.yaml:3: trials: this key stands already in line 2",
            "a.yaml:9: noise.sdt: unknown key; did you mean 'std'? "
            "(allowed: distribution, std, variance, nsr, half_width)",
            "a.yaml:11: estimators.k.bandwidth.h0: must be greater than 0 (got -1)",
            "a.yaml:17: samples: must be a whole number >= 1, <= 100000000 (got 'x')",
            "a.yaml:18: estimators.iv.order: must be greater than or equal to 1 (got 0)",
            f"a.yaml:19: cases.seed: a case cannot change 'seed' ({CHANGEABLE}), and nothing uses '$seed'",
        ]

    @pytest.mark.parametrize(
        ("merge", "said"),
        [
            ("3", "10: noise.<<: must be a mapping whose keys are merged, or a list of such"),
            ("*self", "9: noise.<<: an anchor cannot contain itself"),
            ("[{distribution: normal}, *self]", "9: noise.<<[1]: an anchor cannot contain itself"),
        ],
    )
    def test_what_a_bad_merge_leaves_out_is_not_told_beside_it(self, refused, merge, said):
        (noise,) = (line for line in BASE.splitlines() if line.startswith("noise:"))
        assert refused(with_((noise, f"noise: &self\n  <<: {merge}"))) == [f"a.yaml:{said}"]

    def test_a_value_in_a_case_is_told_at_its_own_line(self, refused):
        text = with_(
            more="cases:\n"
            "  samples:\n"
            "    - 50\n"
            "    - 2.5\n"
            "  h:\n"
            "    narrow:\n"
            "      estimators.k.bandwidth.h0: 1\n"
            "      estimators.k.bandwidth.alpha: 0.2\n"
            "    wide:\n"
            "      estimators.k.bandwidth.h0: 2\n"
            "      estimators.k.bandwidth.alpha: 2\n"
        )
        assert refused(text) == [
            "a.yaml:20: samples: must be a whole number >= 1, <= 100000000 (got 2.5)",
            "a.yaml:27: estimators.k.bandwidth.alpha: must be less than 1 (got 2)",
        ]

    def test_a_message_about_a_whole_component_in_a_later_case_is_worded_as_in_the_first(self, refused):
        text = with_(more="cases:\n  noise:\n    a: {noise.std: 1}\n    b: {noise.variance: 1}\n")
        assert refused(text) == [
            "a.yaml:9: noise: give exactly one of std, variance, nsr, half_width (std, variance found)"
        ]

    @pytest.mark.parametrize(
        ("cases", "message"),
        [
            ("3", "cases: must be a mapping of keys to values (got 3)"),
            ("[a]", "cases: must be a mapping of keys to values (got ['a'])"),
            ("null", "cases: must be a mapping of keys to values (got null)"),
            *(
                (
                    f"{{samples: {axis}}}",
                    "cases.samples: must be a list of values, or labels with the values that each sets "
                    f"(got {got})",
                )
                for axis, got in [("5", "5"), ("null", "null")]
            ),
            ("{samples: []}", "cases.samples: must hold at least one value (got [])"),
            ("{samples: {}}", "cases.samples: must hold at least one value"),
            (
                "{noise: [{kind: white}]}",
                f"cases.noise: a list cannot hold mappings: give each a label, {LABELLED} (got [a mapping])",
            ),
            (
                "{n: {a: 3}}",
                f"cases.n: a case cannot change 'n' ({CHANGEABLE}), and nothing uses '$n'",
            ),
            (
                "{n: {a: 3, b: {samples: 3}}}",
                f"cases.n: must set values by their key path under each label, {LABELLED}, "
                "or give a value under each, as 'label: value'",
            ),
            ("{samples: [50, 60, 50]}", "cases.samples: holds 50 twice (got [50, 60, 50])"),
            ("{samples: [50, '50']}", "cases.samples: holds 50 twice (got [50, '50'])"),
            (
                "{sampels: [1]}",
                f"cases.sampels: a case cannot change 'sampels'; did you mean 'samples'? ({CHANGEABLE}), "
                "and nothing uses '$sampels'",
            ),
            (
                "{n: {a: {kind: iid, low: -1}, b: {kind: iid, low: -2}}}",
                "cases.n: under the label 'a' stands a mapping, which says by key paths what the label sets, "
                "and 'kind' is no such path: if it is the value of $n, write a: {$n: {kind: iid, ...}}",
            ),
            ("{n: {a: {title: b}}}", f"cases.n: a case cannot change 'title' ({CHANGEABLE})"),
            (
                "{estimators.kk.order: [1]}",
                "cases.estimators.kk.order: 'kk' is none of the estimators; did you mean 'k'? "
                "(there are: k, iv)",
            ),
            ("{n: {a: {metrics.q: 3}}}", "cases.n: 'q' is none of the metrics (there are: mise, a)"),
            ("{estimators: [k]}", "cases.estimators: name one of the estimators (there are: k, iv)"),
            (
                "{metrics.a.estimators: [[k]]}",
                "cases.metrics.a.estimators: a case cannot change 'metrics.a.estimators', "
                "only settings of the metric",
            ),
            (
                "{median: {a: {samples: 3}}}",
                "cases.median: an axis cannot be named 'median', which is a column of the results",
            ),
            (
                "{estimators.k.bandwith.h0: [1]}",
                "estimators.k.bandwith.h0: estimators.k has no key 'bandwith'; did you mean 'bandwidth'? "
                "(it has: kind, kernel, bandwidth)",
            ),
            (
                "{system.linear.a.1: [0.5]}",
                "system.linear.a.1: system.linear.a is a list of 1, so '1' must be one of 0",
            ),
        ],
    )
    def test_of_an_axis(self, refused, cases, message):
        assert refused(with_(more=f"cases: {cases}\n")) == [f"a.yaml:17: {message}"]

    @pytest.mark.parametrize(
        "cases",
        ["{h: {a: {estimators.kk.order: 1}}}", "{h: {a: {sample: 30}}}", "{h: {a: {$k: 1}}}"],
    )
    def test_an_axis_that_cannot_be_applied_is_no_missing_axis_elsewhere(self, refused, cases):
        rest = """\
skip: [{h: a, samples: 50}]
tables:
  t: {kind: grid, title: T, rows: h, columns: [{estimator: k, metric: mise}]}
figures:
  f: {kind: realisation, at: [{h: a}, {h: b}], estimators: [k], interval: [-1, 1]}
"""
        (message,) = refused(with_(more=f"cases: {cases[:-1]}, samples: [50, 60]}}\n{rest}"))
        assert message.startswith("a.yaml:17: cases.h: ")

    @pytest.mark.parametrize(
        ("replacement", "message"),
        [
            (
                ("of: [a_1]", "of: [b_7]"),
                [
                    "16: metrics.a: the metric 'error' needs the value b_7 of the system, which "
                    "'hammerstein' does not have "
                    "(it has: linear, nonlinearity, response, value a_1, value b_0)",
                ],
            ),
            (
                ("interval: [-1, 1], estimators: [k]", "interval: [-1, 1]"),
                [
                    "15: metrics.mise: the metric 'mise' needs the nonlinearity of the estimate, which "
                    "estimator 'iv' (instrumental_variables) does not give (it gives: linear, value a_1, "
                    "value c); 'estimators:' under the metric limits it to some"
                ],
            ),
            (
                ("estimators: [k]", "estimators: [kk]"),
                [
                    "15: metrics.mise.estimators[0]: there is no estimator 'kk'; did you mean 'k'? "
                    "(there are: k, iv)",
                ],
            ),
            (
                ("mise: {kind: mise, interval: [-1, 1], estimators: [k]}", ""),
                ["12: estimators.k: no metric scores this estimator"],
            ),
            (
                ("samples: 50", "samples: 2"),
                ["13: estimators.iv: needs at least 4 samples, but samples is 2"],
            ),
            (
                ("order: 1", "order: 1000000000"),
                ["13: estimators.iv: needs at least 2000000002 samples, but samples is 50"],
            ),
            (
                (
                    "kind: iid, distribution: uniform, low: -2*pi, high: 2*pi",
                    "kind: staircase, levels: [1, 2], hold: 99",
                ),
                [
                    "8: excitation: a record of 50 samples ends before the last of 2 levels "
                    "(at least 100 samples reach it)"
                ],
            ),
            (
                ("samples: 50", "samples: 50\nestimators2: 3"),
                [
                    "11: estimators2: unknown key; did you mean 'estimators'? (allowed: cases, skip, "
                    "samples, dt, system, excitation, noise, streams, record, version, title, plugins, "
                    "paper, seed, trials, estimators, metrics, tables, figures, formats, published, "
                    "alternatives)"
                ],
            ),
            (
                ("  iv: {", "  i.v: {"),
                ["11: estimators: the name 'i.v' must not be empty or hold a dot"],
            ),
            (
                (
                    "samples: 50",
                    "samples: 50\n"
                    "tables: {a/b: {kind: grid, title: a, rows: a, columns: [{estimator: k, metric: mise}]}}",
                ),
                ["11: tables: the name 'a/b' must consist of letters, digits, - and _"],
            ),
        ],
    )
    def test_of_parts_that_do_not_fit(self, refused, replacement, message):
        assert refused(with_(replacement)) == [f"a.yaml:{line}" for line in message]

    def test_estimators_and_metrics_are_needed(self, refused):
        text = BASE.partition("estimators:")[0]
        assert refused(f"{text}estimators: {{}}\nmetrics: {{}}\n") == [
            "a.yaml:11: estimators: must hold at least one",
            "a.yaml:12: metrics: must hold at least one",
        ]

    def test_names_that_refer_to_nothing(self, refused):
        text = with_(
            more="""\
cases: {samples: [50, 60]}
tables:
  t:
    kind: grid
    title: T
    rows: sample
    columns:
      - {estimator: k, metric: mise}
      - {estimator: kk, metric: a}
figures:
  f: {kind: realisation, at: [{samples: 70}], estimators: [k], interval: [-1, 1]}
published:
  paper_trials: 10
  cells:
    - {table: T, row: "N={n}", quantity: "q {samples}", estimator: ik, metric: mis, at: {x: 1}}
    - {table: T, row: r, quantity: q, estimator: iv, metric: a a_1, at: {samples: 61}}
"""
        )
        assert refused(text) == [
            "a.yaml:22: tables.t.rows: there is no axis 'sample'; did you mean 'samples'? "
            "(there are: samples)",
            "a.yaml:25: tables.t.columns[1].estimator: there is no estimator 'kk'; did you mean 'k'? "
            "(there are: k, iv)",
            "a.yaml:25: tables.t.columns[1].metric: there is no metric 'a' (there are: mise, a a_1)",
            "a.yaml:27: figures.f.at[0].samples: there is no label of samples '70' (there are: 50, 60)",
            "a.yaml:28: published: needs 'paper', the folder under experiments/ with the numbers",
            "a.yaml:31: published.cells[0].row: there is no axis 'n' (there are: samples)",
            "a.yaml:31: published.cells[0].estimator: there is no estimator 'ik'; did you mean 'k'? "
            "(there are: k, iv)",
            "a.yaml:31: published.cells[0].metric: there is no metric 'mis'; did you mean 'mise'? "
            "(there are: mise, a a_1)",
            "a.yaml:31: published.cells[0].at.x: there is no axis 'x' (there are: samples)",
            "a.yaml:32: published.cells[1].at.samples: there is no label of samples '61' (there are: 50, 60)",
        ]

    @pytest.mark.parametrize("runs", ["0", "-3", "1.5", "true", "unknwn", "[1]"])
    def test_runs_of_the_paper(self, refused, runs):
        got = f"'{runs}'" if runs == "unknwn" else runs
        assert refused(with_(more=f"published: {{paper_trials: {runs}, cells: []}}")) == [
            "a.yaml:17: published.paper_trials: must be a whole number of at least 1, 'unknown' or 'exact' "
            f"(got {got})"
        ]

    def test_the_papers_folder_must_exist(self, refused, write, tmp_path):
        (tmp_path / "experiments" / "mzyk2009").mkdir(parents=True)
        assert refused(with_(more="paper: mzyk2008\n")) == [
            "a.yaml:17: paper: there is no folder experiments/mzyk2008; did you mean 'mzyk2009'?"
        ]
        plan = load(write(with_(more="paper: mzyk2009\n")))
        assert plan.paper == tmp_path / "experiments" / "mzyk2009"


def test_a_need_may_be_met_by_either_of_two_parts(write, refused):
    text = """\
version: 1
title: Either
trials: 2
samples: 600
dt: 0.1
system:
  kind: hammerstein
  nonlinearity: identity
  linear: {kind: continuous, a: [2]}
excitation: {kind: multistep, switching_time: 1, std: 1}
estimators:
  continuous: {kind: linear_model, block: {n: 1, horizon: 4}}
  discrete: {kind: instrumental_variables, order: 1, instrument: identity}
metrics:
  p: {kind: linear_percent_error, step: 0.1}
"""
    assert units(load(write(text))) == [("continuous",), ("discrete",)]
    kernel = "static: {kind: kernel, kernel: window_unit, bandwidth: {h0: 0.2, alpha: 1/5}}"
    assert refused(text.replace("metrics:", f"  {kernel}\nmetrics:")) == [
        "a.yaml:16: metrics.p: the metric 'linear_percent_error' needs the linear or continuous of the "
        "estimate, which estimator 'static' (kernel) does not give (it gives: left_out, nonlinearity); "
        "'estimators:' under the metric limits it to some"
    ]
    discrete = text.replace("{kind: continuous, a: [2]}", "{kind: ar, a: [0.9]}")
    (said,) = refused(discrete)
    assert said.startswith(
        "a.yaml:15: metrics.p: the metric 'linear_percent_error' needs the continuous of the system, which "
        "'hammerstein' does not have (it has: linear, nonlinearity, response, "
    )


def test_numbers_beyond_all_sense_say_nothing_on_their_way():
    """Warnings are errors in the tests; what such numbers do, the trials say."""
    load(Path(__file__).parents[2] / "configs/chen_example3.yaml", ["system.pk_1=1e17"])


def test_numbers_that_no_memory_holds_are_refused():
    with pytest.raises(ConfigError, match=r"band\.count: must be less than or equal to 10000"):
        load(
            Path(__file__).parents[2] / "configs/brouri_bode.yaml",
            ["estimators.rational.band.count=1000000000000000000"],
        )


def _places(data, at=()):
    yield at
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, item in items:
        yield from _places(item, (*at, key))


_SOUND = yaml.safe_load(
    with_(
        more="""\
cases:
  samples: [50, 60]
  n: {"one": {noise.std: 1, $kernel: gaussian}, "two": {noise.std: 2, $kernel: window_unit}}
  h: [0.1, 0.2]
skip: [{samples: 50, n: one}, {estimator: "w 2", h: [0.1]}]
dt: 0.5
tables:
  t: {kind: grid, title: T, rows: samples, columns: [{estimator: [k, w 1], each: {m: [mise]}, metric: $m}]}
  r: {kind: parameters, title: T, metric: every, of: all, estimators: [iv]}
figures: {f: {kind: curve, x: samples, metric: mise, x_label: N, y_label: MISE}}
"""
    )
    .replace("estimators: [k]", "estimators: [k, w 1, w 2]")
    .replace("metrics:\n", "metrics:\n  every: {kind: value, of: all, estimators: [iv]}\n")
    .replace(
        "estimators:\n  k",
        "estimators:\n"
        "  w $i: {each: {i: [1, 2]}, kind: kernel, kernel: $kernel, bandwidth: {h0: $h*$i, alpha: 1/5}}\n  k",
    )
)
_ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.floats(),
    st.sampled_from(["", "kernel", "2*pi", "1/0", "a.b", "samples", 10**30, 1e308, 5e-324, "iid"]),
    st.sampled_from(
        ["$h", "$i", "2*$h", "$x", "$$", "$a$", "${n}", "all", {"each": {"i": [[1]]}}, {"each": 3}]
    ),
    st.sampled_from([[], {}, [1, 2], [[]], [{}], {"kind": "iid"}, {"kind": []}, {"a": {"b": {}}}, ["a", 1]]),
)


def test_the_sound_file_is_sound(write):
    assert len(load(write(json.dumps(_SOUND))).units) == 15


@settings(deadline=None, derandomize=True, max_examples=250)
@given(st.data())
def test_any_change_of_a_sound_file_is_loaded_or_refused(tmp_path_factory, data):
    changed = copy.deepcopy(_SOUND)
    for _ in range(data.draw(st.integers(1, 2))):
        place = data.draw(st.sampled_from([at for at in _places(changed) if at]))
        within = changed
        for key in place[:-1]:
            within = within[key]
        within[place[-1]] = copy.deepcopy(data.draw(_ODD))
    path = tmp_path_factory.getbasetemp() / "changed.yaml"
    text = (
        json.dumps(changed).replace("-Infinity", "-.inf").replace("Infinity", ".inf").replace("NaN", ".nan")
    )
    path.write_text(text)
    try:
        load(path)
    except ConfigError as error:
        assert all(line.startswith(f"{path}:1: ") for line in str(error).splitlines())
