"""Tables for LaTeX."""

import re

import pytest
from matplotlib.text import Text

from hident.reports import latex
from hident.reports.base import TableSpec
from hident.reports.mathematics import typeset
from hident.reports.output import Outputs
from hident.reports.table import Table
from tests.unit.results_maker import PUBLISHED, made

GRID = """
tables:
  errors_of_both:
    kind: grid
    title: "Error of μ_w & 50 % of R^-1 in my_file"
    rows: samples
    columns:
      - {estimator: one, metric: mise, statistic: median}
      - {estimator: two, metric: mise, statistic: mean_std, header: "two, mean ± std"}
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("100 % of a & b #1", r"100 \% of a \& b \#1"),
        ("two_stage of a_1, sigma_w and b_10", r"two\_stage of $a_{1}$, $\sigma_{w}$ and $b_{10}$"),
        ("W_check, y_-1, b_0_1", r"$W_{\mathrm{check}}$, $y_{-1}$, $b_{\mathrm{0\_1}}$"),
        ("W = R^-1, 2^N", r"W = $R^{-1}$, 2\textasciicircum{}N"),
        ("Ω, λ, ϕ? and ²", "$\\Omega$, $\\lambda$, ϕ? and $^{2}$"),
        (r"$\sigma$ = 0.1 $5", r"$\sigma$ = 0.1 \$5"),
        ("Costs $5 & 7% of $10", r"Costs \$5 \& 7\% of \$10"),
        ("cost 5$ {x}_{, $\\sigma$ = 0.1", r"cost 5\$ \{x\}\_\{, $\sigma$ = 0.1"),
        ("from $5 to 7, $\\sigma$, a_1", r"from \$5 to 7, $\sigma$, $a_{1}$"),
        ("50% & $$a_1$$, $$", r"50\% \& \$$a_1$\$, \$\$"),
        ("$x_$ and $y}$", r"\$x\_\$ and \$y\}\$"),
        ("$ x $, $x $y", r"\$ x \$, \$x \$y"),
        (r"\$x$, \$5", r"\$x\$, \$5"),
        (r"$5%$, $\mathrm{5%}$", r"\$5\%\$, $\mathrm{5\%}$"),
        ("{x} \\ |G| < 3 >= 2", r"\{x\} \textbackslash{} $|$G$|$ $<$ 3 $\geq$ 2"),
        ("`~` near, `x_y` code", r"$\sim$ near, \texttt{x\_y} code"),
        ("Cramér-Rao ± 3 °C", r"Cramér-Rao $\pm$ 3 $^\circ$C"),
    ],
)
def test_every_letter_means_itself(text, said):
    assert latex.escaped(text) == said


def rows(table):
    body = latex.table("t", table, "C").partition("\\midrule\n")[2].partition("    \\bottomrule")[0]
    return [line.strip().removesuffix(r" \\").split(" & ") for line in body.splitlines()]


def kinds(table):
    [found] = re.findall(r"\\begin\{tabular\}\{(.*)\}", latex.table("t", table, "C"))
    return found


def test_plain_numbers_stand_at_their_points():
    cells = (("50", "-1.25", "1.5e-07"), ("1000", "10.5", "-"), ("3000", "", "2e+03"))
    table = Table("T", ("N", "a_1", "e"), cells)
    assert kinds(table) == "S[table-format=4] S[table-format=-2.2] S[table-format=1.1e-1]"
    assert rows(table) == [["50", "-1.25", "1.5e-07"], ["1000", "10.5", "{--}"], ["3000", "", "2e+03"]]
    assert r"{N} & {$a_{1}$} & {e} \\" in latex.table("t", table, "C")


def test_where_some_numbers_have_an_exponent_none_is_set_apart():
    table = Table("T", ("p",), (("6.9e-05",), ("0.00088",), ("1.0",), ("-",)))
    assert kinds(table) == "r"
    assert rows(table) == [[r"\num{6.9e-05}"], [r"\num{0.00088}"], [r"\num{1.0}"], ["--"]]


def test_a_wide_table_is_shrunk_to_the_line():
    wide = Table("T", ("a", "b"), (("x" * 40, "y" * 30),))
    narrow = Table("T", ("a", "b"), (("x" * 30, "y" * 30),))
    assert latex.table("t", wide, "C").count(r"\resizebox") == 1
    assert re.search(r"\\end\{tabular\}\n  \}\n", latex.table("t", wide, "C"))
    assert r"\resizebox" not in latex.table("t", narrow, "C")


def test_numbers_among_signs_are_set_by_siunitx_and_verdicts_keep_their_marks():
    cells = (
        ("b_1", "0.45 ± 0.01", "0.447 = ± 0.01 =", "1.2 [0.4, 5.2]", "7.1 ~ p73", ">= 3", "12 of 13"),
        ("2009", "-", "-0.9 ! ± 0.1 ?", "-", "", "none", "N=100"),
    )
    first, second = rows(Table("T", tuple("abcdefg"), cells))
    assert first == [
        "$b_{1}$",
        r"\num{0.45} $\pm$ \num{0.01}",
        r"\num{0.447} $=$ $\pm$ \num{0.01} $=$",
        r"\num{1.2} [\num{0.4}, \num{5.2}]",
        r"\num{7.1} $\sim$ p73",
        r"$\geq$ \num{3}",
        "12 of 13",
    ]
    assert second == [r"\num{2009}", "--", r"\num{-0.9} ! $\pm$ \num{0.1} ?", "--", "", "none", "N=100"]


def test_the_dagger_of_a_comparison_is_set():
    ((cell, words),) = rows(Table("T", ("a", "b"), (("0.353 [0.155, 0.803] †", "† of survivors"),)))
    assert cell == r"\num{0.353} [\num{0.155}, \num{0.803}] $\dagger$"
    assert words == r"$\dagger$ of survivors"


def test_a_caption_says_trials_seed_and_statistic(tmp_path):
    results = made(tmp_path, {}, rest=GRID)
    spec = results.plan.experiment.tables["errors_of_both"]
    assert isinstance(spec, TableSpec)
    table = spec.built(results, ())
    said = latex.caption(table, results.plan.trials, results.plan.seed)
    assert said == (
        "Error of μ_w & 50 % of R^-1 in my_file. 2 trials, seed 1; one: median; two, mean ± std: mean ± "
        "standard deviation."
    )
    assert latex.caption(Table("Is it?", (), ()), 1, 7) == "Is it? 1 trial, seed 7."


def test_every_table_is_written_where_it_is_asked_for(tmp_path):
    numbers = "T,N=10,error,1.5,\nT,N=100,error,2,\nT,N=1000,error,1,\n"
    rest = GRID + PUBLISHED.format(runs=1, statistic="median") + "formats: [tex]\n"
    results = made(tmp_path, {("one", "10"): [1.0, 2.0, 1.5]}, rest=rest, printed=numbers)
    out = Outputs(results.plan, tmp_path / "out")
    assert out.write(results, {}) == ()
    page = (tmp_path / "out" / "table.tex").read_text()
    own = (tmp_path / "out" / "errors_of_both.tex").read_text()
    assert page.replace("\n\n", "\n") == own.replace("\n\n", "\n")
    assert r"\label{tab:errors_of_both}" in own
    assert r"10 & 1.50 & \num{1.5} $=$ &" in own
    assert "$\\sim$ it lies in the interval" in own
    assert out.state() == "up to date"


def test_without_tables_all_statistics_are_one(tmp_path):
    results = made(tmp_path, {}, rest="formats: png,tex\n")
    Outputs(results.plan, tmp_path / "out").write(results, {})
    page = (tmp_path / "out" / "table.tex").read_text()
    assert r"\caption{All statistics. 2 trials, seed 1.}" in page
    assert page.count(r"\begin{table}") == 1


DOLLARS = """
tables:
  t:
    kind: grid
    title: "Errors, cost in US$"
    rows: samples
    row_header: "N, NZ$"
    columns:
      - {estimator: one, metric: mise, statistic: median, header: "US$"}
      - {estimator: two, metric: mise, header: "CA$"}
      - {estimator: one, metric: mise, header: "$\\\\sigma$ in US$"}
  c: {kind: comparison, title: "$p$ at US$ and CA$", metric: mise, facets: {columns: AU$, names: {AU$: HK$}}}
figures:
  f: {kind: curve, x: samples, metric: mise, x_label: "N", y_label: "error", at: {AU$: US$}}
  g: {kind: paired_differences, table: c, x_label: "cost, US$"}
formats: [png, tex]
"""
AXES = """\
  AU$: {US$: {excitation.high: 1}, $\\alpha$ US$: {excitation.high: 2}}
  NZ$: {CA$: {noise: []}, ZW$: {noise: {kind: white, std: 1}}}
"""


def test_a_dollar_of_one_label_pairs_with_none_of_another(tmp_path, monkeypatch):
    """Labels with a lone dollar each, joined by a comma: $, CA$ is no mathematics."""
    results = made(tmp_path, {}, rest=DOLLARS, axes=AXES)
    shown: list[str] = []

    def kept(figure):
        typeset(figure)
        shown.extend(text.get_text() for text in figure.findobj(Text))

    monkeypatch.setattr("hident.reports.output.typeset", kept)
    assert Outputs(results.plan, tmp_path / "out").write(results, {}) == ()
    page = (tmp_path / "out" / "table.tex").read_text()
    for text in (page, "\n".join(shown)):
        assert any(two in text for two in (r"US\$, CA\$", r"US\$, NZ\$", r"NZ\$ CA\$"))
        for found in re.findall(r"(?<!\\)\$([^$]*)(?<!\\)\$", text):
            assert not re.search(r"[A-Z]{2}|\\\$", found), found
    assert r"$\alpha$ US\$" in page
    assert r"$\sigma$ in US\$" in page
    assert r"$\alpha$ US\$" in "\n".join(shown)
