"""Configurations without repetition: axes as variables, cases left out, repeated entries, every value."""

from functools import partial

import pytest

from hident import plugins
from hident.config.spec import canonical
from hident.config.variables import filled, labelled, variables_in
from tests.unit.plans import planned, refusals

BASE = """\
version: 1
title: Base
trials: 2
samples: 50
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: ar, a: [0.8]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
noise: {kind: ar, a: [$pole], std: 2*$sigma}
cases:
  pole: ["0", "0.5"]
  sigma: [1, 2]
estimators:
  iv: {kind: instrumental_variables, order: 1, instrument: identity}
  k: {kind: kernel, kernel: $kernel, bandwidth: {h0: $h0, alpha: 1/5}}
metrics:
  a: {kind: value, of: [a_1], estimators: [iv]}
  mise: {kind: mise, interval: [-1, 1], estimators: [k]}
"""
KERNELS = "  smoothing: {narrow: {$kernel: window_unit, $h0: 0.2}, wide: {$kernel: gaussian, $h0: 1}}\n"
SOUND = BASE.replace("estimators:\n  iv", KERNELS + "estimators:\n  iv")


@pytest.fixture(scope="module", autouse=True)
def _components():
    plugins.load()


@pytest.fixture
def plan(tmp_path):
    return partial(planned, tmp_path)


@pytest.fixture
def refused(tmp_path):
    return partial(refusals, tmp_path)


def changed(*replacements, more=""):
    text = SOUND
    for old, new in replacements:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text + more


class TestTexts:
    @pytest.mark.parametrize(
        ("text", "names"),
        [
            ("$pole", ("pole",)),
            ("${M = N}*2", ("M = N",)),
            ("$block$i", ("block", "i")),
            ("$a/$b, ${c}/${d}", ("a", "b", "c", "d")),
            ("type $type, case $case", ("type", "case")),
            ("error of $a_1$", ()),
            ("$N^{-1/2}$ and $|G_i G_o|$, $C_B$ (mol/L)", ()),
            ("$q_b$ = $q_b", ("q_b",)),
            ("$$pole", ()),
            ("5 $ and $6", ()),
        ],
    )
    def test_mathematics_holds_no_variables(self, text, names):
        assert variables_in(text) == names

    @pytest.mark.parametrize(
        ("text", "value"),
        [
            ("$n", 3),
            ("$text", "0.5"),
            ("$list", [1, 2]),
            ("749*$n", 2247),
            ("$text*$n", 1.5),
            ("$minus**2", 4),
            ("2*$sum", 6),
            ("u + $minus*u", "u + (-2)*u"),
            ("case $n", "case 3"),
            ("$$n and $a_1$", "$n and $a_1$"),
            ("$other", "$other"),
        ],
    )
    def test_values_take_the_place_of_names(self, text, value):
        values = {"n": 3, "text": "0.5", "list": [1, 2], "minus": -2, "sum": "1 + 2"}
        assert filled(text, values) == value
        assert filled({"key": [text]}, values) == {"key": [value]}

    def test_a_text_of_a_table_stays_a_text(self):
        assert labelled("b_$i, $$${x}$$ = $x", {"i": 1, "x": -2}) == "b_1, $-2$ = -2"


class TestAxes:
    def test_are_variables_in_lists_and_formulas(self, plan):
        units = [unit for unit in plan(SOUND).units if unit.name == "iv"]
        noises = [canonical(unit.data.noise[0]) for unit in units]
        assert [(noise["a"], noise["std"]) for noise in noises] == [
            ([0.0], 2.0),
            ([0.0], 4.0),
            ([0.5], 2.0),
            ([0.5], 4.0),
        ]
        assert [unit.labels for unit in units][1:3] == [
            {"pole": "0", "sigma": 2},
            {"pole": "0.5", "sigma": 1},
        ]

    def test_mean_what_patches_mean(self, plan):
        by_patches = changed(
            ("[$pole]", "[0]"),
            ("2*$sigma", "2"),
            ("$kernel, bandwidth: {h0: $h0", "window_unit, bandwidth: {h0: 0.2"),
            ('pole: ["0", "0.5"]', 'pole: {"0": {noise.a: [0]}, "0.5": {noise.a: [0.5]}}'),
            ("sigma: [1, 2]", "sigma: {1: {noise.std: 2}, 2: {noise.std: 4}}"),
            (
                KERNELS,
                "  smoothing:\n"
                "    narrow: {estimators.k.kernel: window_unit, estimators.k.bandwidth.h0: 0.2}\n"
                "    wide: {estimators.k.kernel: gaussian, estimators.k.bandwidth.h0: 1}\n",
            ),
        )
        ours, theirs = plan(SOUND).units, plan(by_patches).units
        assert [unit.data.key for unit in ours] == [unit.data.key for unit in theirs]
        assert [unit.estimator for unit in ours] == [unit.estimator for unit in theirs]
        assert [unit.described() for unit in ours] == [unit.described() for unit in theirs]

    def test_multiply_only_what_names_them(self, plan):
        kernels = [unit for unit in plan(SOUND).units if unit.name == "k"]
        assert len(kernels) == 8
        assert [unit.labels["smoothing"] for unit in kernels[:2]] == ["narrow", "wide"]
        assert [unit.estimator.kernel for unit in kernels[:2]] == ["window_unit", "gaussian"]

    def test_what_a_label_sets_may_name_another_axis(self, plan):
        text = changed(
            ("$pole], std: 2*$sigma", "0], std: 1"), ("sigma: [1, 2]", "sigma: {a: {noise.a: [$pole]}}")
        )
        found = {unit.labels["pole"]: canonical(unit.data.noise[0]) for unit in plan(text).units}
        assert {pole: noise["a"] for pole, noise in found.items()} == {"0": [0.0], "0.5": [0.5]}

    def test_can_be_set_on_the_command_line(self, plan):
        labels = {unit.labels["pole"] for unit in plan(SOUND, "cases.pole=[0.1, 0.2, 0.3]").units}
        assert labels == {0.1, 0.2, 0.3}

    @pytest.mark.parametrize(
        ("replacement", "messages"),
        [
            (
                ("[$pole]", "[$pol]"),
                [
                    "7: noise.a[0]: there is no axis 'pol'; did you mean 'pole'? (there are: pole, "
                    "sigma, smoothing, kernel, h0); for the text '$pol' write '$$pol'",
                    "9: cases.pole: a case cannot change 'pole' (it can: samples, dt, system, excitation, "
                    "noise, streams, record, estimators, metrics), and nothing uses '$pole'",
                ],
            ),
            (
                ('["0", "0.5"]', '["0", x]'),
                ["7: noise.a[0]: must be a number, or a formula such as '2*pi' or '1/5' (got 'x')"],
            ),
            (
                ("sigma: [1, 2]", "sigma: [[1], [2]]"),
                [
                    "7: noise.std: '$sigma' is [1], which cannot stand inside a text",
                    "7: noise.std: '$sigma' is [2], which cannot stand inside a text",
                ],
            ),
            (
                ("$kernel: gaussian, $h0: 1", "$kernel: gaussian"),
                ["11: cases.smoothing.wide: must set '$h0', as other labels do"],
            ),
            (
                ("wide: {$kernel: gaussian, $h0: 1}", "wide: {$kernel: gausian, $h0: 1}"),
                [
                    "14: estimators.k.kernel: must be 'window_half', 'window_unit', 'triangular', "
                    "'epanechnikov' or 'gaussian'; did you mean 'gaussian'? (got 'gausian')"
                ],
            ),
            (
                ("  smoothing: {narrow: {$kernel", "  smoothing: {narrow: {$pole"),
                [
                    "11: cases.smoothing: the axis 'pole' has a variable 'pole' too",
                    "11: cases.smoothing.wide: must set '$pole', as other labels do",
                    "11: cases.smoothing.narrow: must set '$kernel', as other labels do",
                ],
            ),
            (
                ("estimators: [iv]}", "estimators: [$smoothing]}"),
                ["16: metrics.a.estimators[0]: a case cannot change the estimators of a metric"],
            ),
        ],
    )
    def test_messages(self, refused, replacement, messages):
        assert refused(changed(replacement)) == [f"a.yaml:{message}" for message in messages]


class TestSkip:
    def test_leaves_combinations_out(self, plan):
        skip = 'skip:\n  - {pole: "0.5", sigma: 2}\n  - {estimator: k, smoothing: wide, sigma: [1, 2]}\n'
        left = [(unit.name, *map(str, unit.labels.values())) for unit in plan(SOUND + skip).units]
        cases = [("0", "1"), ("0", "2"), ("0.5", "1")]
        assert left == [row for case in cases for row in (("iv", *case), ("k", *case, "narrow"))]

    def test_what_is_left_out_need_not_be_sound(self, refused):
        text = changed(("sigma: [1, 2]", "sigma: [1, -2]"))
        assert refused(text) == ["a.yaml:7: noise.std: must be greater than or equal to 0 (got -4)"]
        assert refused(text + "skip: [{sigma: -2}]") == []

    @pytest.mark.parametrize(
        ("skip", "message"),
        [
            (
                "[{pol: 1}]",
                "skip[0].pol: there is no axis 'pol'; did you mean 'pole'? (there are: pole, sigma, "
                "smoothing, estimator)",
            ),
            (
                "[{smoothing: wid}]",
                "skip[0].smoothing: there is no label 'wid'; did you mean 'wide'? (there are: narrow, wide)",
            ),
            (
                "[{estimator: ivs}]",
                "skip[0].estimator: there is no estimator 'ivs'; did you mean 'iv'? (there are: iv, k)",
            ),
            ("[{estimator: iv}]", "estimators.iv: is left out of every case"),
            (
                "[{estimator: iv, smoothing: wide}]",
                "skip[0]: leaves nothing out: no estimate has all these labels",
            ),
            ("[{}]", "skip[0]: must name labels of axes, an estimator, or both"),
            ("[3]", "skip[0]: must be a mapping of keys to values (got 3)"),
            ("{pole: 1}", "skip: must be a list (got a mapping)"),
        ],
    )
    def test_messages(self, refused, skip, message):
        found = refused(SOUND + f"skip: {skip}\n")
        assert [line.split(": ", 1)[1] for line in found] == [message]


REPORTS = """\
version: 1
title: Reports
trials: 2
samples: 50
system: {kind: hammerstein, nonlinearity: identity, linear: {kind: arma, a: [0.8], b: [1, 0.5]}}
excitation: {kind: iid, distribution: uniform, low: -1, high: 1}
noise: {kind: white, std: $sigma}
cases:
  sigma: ["0.1", "1"]
estimators:
  iv $i: {each: {i: [1, 2]}, kind: instrumental_variables, order: $i, instrument: identity}
metrics:
  a: {kind: value, of: [a_1, c]}
"""
TABLE = """\
tables:
  t:
    kind: grid
    title: T
    rows: sigma
    columns:
"""


class TestRepeatedEntries:
    @pytest.fixture
    def columns(self, plan):
        def columns(entry):
            found = plan(REPORTS + TABLE + f"      - {entry}\n").experiment.tables["t"].columns
            return [(one.estimator, one.metric, one.header, one.statistic) for one in found]

        return columns

    def test_under_a_name_that_holds_a_variable(self, plan):
        estimators = plan(REPORTS).experiment.estimators
        assert {name: spec.order for name, spec in estimators.items()} == {"iv 1": 1, "iv 2": 2}

    def test_lists_where_a_text_belongs_expand_the_first_the_slowest(self, columns):
        entry = (
            '{statistic: [mean, std], estimator: [iv 1, iv 2], metric: a c, header: "$estimator, $statistic"}'
        )
        assert columns(entry) == [
            ("iv 1", "a c", "iv 1, mean", "mean"),
            ("iv 2", "a c", "iv 2, mean", "mean"),
            ("iv 1", "a c", "iv 1, std", "std"),
            ("iv 2", "a c", "iv 2, std", "std"),
        ]

    def test_each_names_variables_that_may_vary_together(self, columns):
        entry = (
            "{estimator: [iv 1, iv 2], each: {'value, name': [[a_1, pole], [c, gain]]}, metric: a $value, "
            "header: '$$x$$ of $name, $y$'}"
        )
        assert columns(entry) == [
            ("iv 1", "a a_1", "$x$ of pole, $y$", "mean"),
            ("iv 1", "a c", "$x$ of gain, $y$", "mean"),
            ("iv 2", "a a_1", "$x$ of pole, $y$", "mean"),
            ("iv 2", "a c", "$x$ of gain, $y$", "mean"),
        ]

    def test_labels_of_axes_and_inner_entries(self, plan):
        text = (
            "figures:\n"
            "  f:\n"
            "    kind: scatter\n"
            "    panels:\n"
            "      - title: sigma $sigma\n"
            '        x: {estimator: iv 1, at: {sigma: ["0.1", "1"]}, metric: a a_1, label: "$a_1$"}\n'
            "        y: {estimator: iv 1, at: {sigma: $sigma}, metric: a c}\n"
        )
        panels = plan(REPORTS + text).experiment.figures["f"].panels
        assert [panel.title for panel in panels] == ["sigma 0.1", "sigma 1"]
        assert [(panel.x.at, panel.y.at) for panel in panels] == [
            ({"sigma": label},) * 2 for label in ("0.1", "1")
        ]
        assert panels[0].x.label == "$a_1$"

    def test_a_text_outside_of_such_entries_is_as_it_stands(self, columns):
        assert columns("{estimator: iv 1, metric: a c, header: $sigma and $$x}") == [
            ("iv 1", "a c", "$sigma and $$x", "mean")
        ]

    def test_a_heading_may_be_named_each(self, plan):
        text = (
            "tables:\n"
            "  t:\n"
            "    kind: distribution\n"
            "    title: T\n"
            "    columns: {each: c}\n"
            "    rows: [{label: one, estimator: iv 1, metric: a}]\n"
        )
        assert plan(REPORTS + text).experiment.tables["t"].columns == {"each": "c"}

    def test_messages_name_the_line_of_the_entry_that_is_written(self, refused):
        entries = "      - {estimator: iv 1, metric: a c}\n      - {estimator: [iv 1, iv 3], metric: a c}\n"
        assert refused(REPORTS + TABLE + entries) == [
            "a.yaml:21: tables.t.columns[2].estimator: there is no estimator 'iv 3'; did you mean 'iv 2'? "
            "(there are: iv 1, iv 2)"
        ]

    @pytest.mark.parametrize(
        ("entry", "message"),
        [
            (
                "{estimator: [iv 1, iv 2], metric: a $estimato}",
                "metric: there is no variable 'estimato'; did you mean 'estimator'? (there are: estimator); "
                "for the text '$estimato' write '$$estimato'",
            ),
            ("{each: {i: [1, 2]}, estimator: iv 1, metric: a c}", "each.i: nothing uses '$i'"),
            (
                "{each: [1, 2], estimator: iv 1, metric: a c}",
                "each: must be variables with their lists, as 'each: {name: [1, 2]}' or "
                "'each: {a, b: [[1, x], [2, y]]}'",
            ),
            (
                "{each: {'i, j': [[1, 2], [3]]}, estimator: iv $i, metric: a $j}",
                "each.i, j: must be variables with their lists, as 'each: {name: [1, 2]}' or "
                "'each: {a, b: [[1, x], [2, y]]}'",
            ),
            (
                "{each: {estimator: [iv 1]}, estimator: [iv 2], metric: a $estimator}",
                ": the variable 'estimator' has two lists: write '$estimator' in the place of one",
            ),
            (
                "{each: {i: [[1], [2]]}, estimator: iv $i, metric: a c}",
                "estimator: '$i' is [1], which cannot stand inside a text",
            ),
        ],
    )
    def test_messages(self, refused, entry, message):
        at = "tables.t.columns[0]"
        at = f"{at}{message}" if message.startswith(":") else f"{at}.{message}"
        assert refused(REPORTS + TABLE + f"      - {entry}\n")[0] == f"a.yaml:20: {at}"

    def test_a_name_must_hold_each_variable(self, refused):
        text = REPORTS.replace("iv $i:", "iv:")
        assert (
            refused(text)[0]
            == "a.yaml:11: estimators.iv: the name 'iv' stands twice: it must hold each variable"
        )


class TestEveryValue:
    def test_is_what_all_estimators_of_a_metric_have(self, plan):
        text = REPORTS.replace("of: [a_1, c]", "of: all")
        assert plan(text).experiment.metrics["a"].of == ("a_1", "c")
        alone = text.replace("of: all", "of: all, estimators: [iv 2]}\n  c: {kind: value, of: [c]")
        assert plan(alone).experiment.metrics["a"].of == ("a_1", "a_2", "c")

    def test_of_a_metric_that_compares_is_what_the_system_has_too(self, plan):
        text = REPORTS.replace("value, of: [a_1, c]", "error, of: all")
        assert plan(text).experiment.metrics["a"].of == ("a_1",)

    def test_in_a_table_is_what_its_metric_scores(self, plan):
        text = REPORTS.replace("[a_1, c]", "[c, a_1]")
        table = "tables: {t: {kind: parameters, title: T, metric: a, of: all, estimators: [iv 1]}}\n"
        assert plan(text + table).experiment.tables["t"].of == ("c", "a_1")

    def test_messages(self, refused):
        text = REPORTS.replace("value, of: [a_1, c]", "coverage, of: all")
        table = "tables: {t: {kind: parameters, title: T, metric: b, of: all, estimators: [iv 1]}}\n"
        found = refused(text + table)
        assert {
            "a.yaml:13: metrics.a.of: no value is given by all that it scores: name the values, or "
            "'estimators' (got 'all')",
            "a.yaml:14: tables.t.of: 'metric' must be the name of a metric whose values have names "
            "(got 'all')",
        } <= {*found}
