"""The site of results, without a browser: what stands on its pages, and what they are made of."""

import csv
import hashlib
import json
import lzma
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from hident import plugins
from hident.config.load import read_leniently
from hident.config.spec import components
from hident.engine.run_files import RUN, TRIALS, VERDICTS
from hident.errors import ConfigError, NothingToCompare
from hident.ledger.trial_values import TrialValues
from hident.ledger.verdicts import COUNTED
from hident.reports.site import build as module
from hident.reports.site import configuration, differences, drawings, front, methods, runs, tables
from hident.reports.site.build import build
from hident.reports.site.facts import WORDS
from hident.reports.site.pages import FRONT, Run, Sources, run_page
from hident.reports.site.rendering import rendered
from hident.reports.site.truths import truths
from hident.reports.tables.writing import SIGNS
from hident.run_folder import RunFolder
from tests.accepted import RESULTS, ROOT
from tests.unit.site_reader import Reader, dead_links, pages, seen, written

MOST_BYTES = 300_000
"""Of a page without its figures."""
RUNS = sorted(path.parent.name for path in RESULTS.glob(f"*/{RUN}"))
JUDGED = sorted(path.parent.name for path in RESULTS.glob(f"*/{VERDICTS}"))
FOLDERS = {"experiments": ROOT / "experiments", "configs": ROOT / "configs", "docs": ROOT / "docs"}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site of results/."""
    plugins.load()
    folder = tmp_path_factory.mktemp("site") / "site"
    built = build([RESULTS], folder, results=RESULTS, **FOLDERS)
    assert built.runs == len(RUNS)
    assert built.faults == ()
    return folder


@pytest.fixture(scope="module")
def read(site):
    return pages(site)


@pytest.fixture
def run(tmp_path):
    """The folder of one accepted run, to be damaged."""
    plugins.load()
    folder = tmp_path / "out" / "mzyk_table1"
    shutil.copytree(RESULTS / "mzyk_table1", folder)
    return folder


def pages_of(folder):
    """The page of a run and the front page of its site alone, by their paths, and what is wrong with it."""
    of_run = Run(folder.name, RunFolder(folder), RESULTS)
    sources = Sources((of_run,), **FOLDERS)
    made = [page for module in (runs, front) for part in module.parts(sources) for page in part.make()]
    return {page.path: rendered(page).html for page in made}, of_run.facts.faults


def page_of(folder):
    """The page of a run as a browser reads it."""
    made, _ = pages_of(folder)
    return Reader(made[run_page(folder.name)])


def rewritten(run, change):
    """Change run.json of a run, and seal it again as if it had been written so."""
    folder = RunFolder(run)
    content = folder.run()
    assert content is not None
    change(content)
    if isinstance(content.get("provenance"), dict) and "files" in content:
        content["provenance"].pop("sha256", None)
        folder.seal(content)
    else:
        (run / RUN).write_text(json.dumps(content), encoding="utf-8")


def test_no_link_is_dead_and_no_anchor(site, read):
    assert len(read) > 2 * len(RUNS)
    assert dead_links(site, read) == []


def test_the_site_needs_no_network(site):
    for path in [*site.rglob("*.html"), *site.glob("static/*")]:
        text = path.read_text(encoding="utf-8")
        assert "//cdn" not in text
        reader = Reader(text) if path.suffix == ".html" else None
        for element in reader.elements if reader else ():
            loads = element["tag"] in ("script", "img", "link", "iframe", "source")
            address = element["attributes"].get("src") or element["attributes"].get("href") or ""
            assert not (loads and ":" in address), (path, address)


def test_pages_are_small(site):
    sizes = {path.name: path.stat().st_size for path in site.rglob("*.html")}
    assert {name: size for name, size in sizes.items() if size >= MOST_BYTES} == {}


def test_no_page_has_an_anchor_twice(read):
    for page, reader in read.items():
        assert sorted(set(reader.ids)) == sorted(reader.ids), page


@pytest.mark.parametrize("config", JUDGED)
def test_every_printed_number_stands_with_ours_and_its_verdict(read, config):
    """And opens to its interval, the trials behind it and the command that shows it."""
    with (RESULTS / config / VERDICTS).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    page = read[f"runs/{config}.html"]
    buttons = page.of("button", class_="number")
    details = {element["attributes"]["id"]: element for element in page.of("div", class_="detail")}
    assert len(buttons) == len(rows)
    signs: dict[str, str] = dict(SIGNS.items())
    by_id = {button["attributes"]["popovertarget"]: button for button in buttons}
    # The note of published.csv says "at least".
    shown = {("brouri_order", ">3"): "≥3"}
    for i, row in enumerate(rows):
        said = " ".join(by_id[f"n{i + 1}"]["text"].split())
        printed = shown.get((config, row["printed"]), row["printed"])
        assert said.startswith(f"printed {printed} {signs[row['verdict']]} {row['verdict']}, ours ")
        detail = " ".join(details[f"n{i + 1}"]["text"].split())
        for text in (row["table"], row["row"], row["quantity"], printed, row["interval"]):
            assert " ".join(seen(text).split()) in detail
        assert f"hident run {config}" in detail
        assert "trials" in detail
    # All trials of brouri_order give the order 1.
    drawn = [row for row in rows if config != "brouri_order" and float(row["low"]) < float(row["high"])]
    assert len(page.of("svg", class_="trials")) == len(drawn)


def detail_of(page, *said):
    """The words of the details of a number that hold some texts."""
    found = [" ".join(one["text"].split()) for one in page.of("div", class_="detail")]
    return next(one for one in found if all(text in one for text in said))


def test_no_trials_are_shown_where_they_are_the_papers_own(read):
    """Other trials than the paper's have nothing to say of equal digits, which stand with one more."""
    page = read["runs/wang_table1.html"]
    assert page.of("svg", class_="trials") == []
    every = " ".join(one["text"] for one in page.of("div", class_="detail"))
    assert "how stable" not in every
    assert "how unusual" not in every
    said = detail_of(page, "none: the trials are the paper's own data", "7.0004")
    [ours] = re.findall(r"ours([-\d.]+),", said)
    assert len(ours.partition(".")[2]) == 5
    assert f"{float(ours):.4f}" == "7.0004"


def test_a_bound_says_how_many_trials_keep_it_and_whether_it_is_allowed_itself(read):
    rows = TrialValues.decoded((RESULTS / "chen_fig9" / TRIALS).read_bytes())
    [values] = [
        v for k, v in rows.series.items() if k[-2:] == ("four-segment", "linear") and k[:2] == ("0.1", "1.5")
    ]
    said = detail_of(read["runs/chen_fig9.html"], "<5")
    assert f"{np.sum(values <= 5)} of {len(values)} trials keep the bound" in said
    assert "how unusual" not in said
    order = detail_of(read["runs/brouri_order.html"], "p by (39)")
    assert "printed≥3" in order
    assert "intervalup to 1;" in order
    assert "ours1," in order


def test_an_uncounted_number_is_no_verdict(read):
    said = detail_of(read["runs/chen_table1.html"], "the model that is fitted has no such coefficient")
    assert "ours rounds" not in said
    assert "none, as all trials give the same" in said


def test_the_commands_of_a_number_lead_to_where_they_are_to_be_given(read):
    page = read["runs/chen_table1.html"]
    numbers = [one for one in page.of("button") if "number" in (one["attributes"].get("class") or "").split()]
    links = [one for one in page.of("a") if one["text"] == "commands"]
    assert len(links) == len(numbers) > 0
    assert {one["attributes"]["href"] for one in links} == {"#again"}
    assert "again" in {one["attributes"].get("id") for one in page.of("h2")}


def flags(page):
    return [one["text"] for one in page.of("span", class_="flag")]


def test_what_a_verdict_lacks_stands_in_its_cell(read):
    gains = flags(read["runs/brouri_gains.html"])
    with (ROOT / "experiments" / "brouri" / "published.csv").open(newline="", encoding="utf-8") as file:
        derived = sum(row["note"].startswith("derived") for row in csv.DictReader(file))
    assert gains.count("derived") == derived
    assert "10 of 100 trials" in gains
    for config in JUDGED:
        rows = [
            one for one in rows_of(config) if one["verdict"] == "agrees" and float(one["width"] or "nan") > 1
        ]
        assert flags(read[f"runs/{config}.html"]).count("wide") == len(rows), config
    assert flags(read["runs/mzyk_variance.html"]) == ["misprint"]
    assert flags(read["runs/chen_vif.html"]).count("misprint") == 1
    left_out = "What the paper itself shows to be misprinted (1) is left out of it."
    assert left_out in " ".join(read["runs/mzyk_variance.html"].text_of("p"))


def test_the_front_page_says_what_its_numbers_do_not_tell(read):
    page = read["index.html"]
    said = " ".join(page.text_of("p"))
    every = [row for config in JUDGED for row in rows_of(config) if row["mark"] in COUNTED]
    agreeing = [row for row in every if row["verdict"] == "agrees"]
    wide = sum(float(row["width"] or "nan") > 1 for row in agreeing)
    once = sum(row["excluded"] == "1" for row in agreeing)
    assert f"Of the {len(agreeing)} that agree, {wide} do so by an interval wider" in said
    assert f"{once} would have differed under one alternative only" in said
    assert f"there are {len(every)} verdicts" in said
    assert "not printed, but derived from printed ones" in said
    assert "And ours: the joint p is below 0.05" in said
    bars = [one["attributes"]["aria-label"] for one in page.of("svg", class_="bar")]
    assert f"({wide} wide)" in bars[0]
    ledger = [row["text"] for row in page.of("tr") if "data-row" in row["attributes"]]
    assert sum("misprinted" in row for row in ledger) == 3
    assert not any("and ours" in row for row in ledger if "mzyk_variance" in row)
    assert any("0.050" in row and "and ours" not in row for row in ledger if "chen_example3" in row)


@pytest.mark.parametrize(
    ("run", "words"),
    [
        ("compare_wiener", {"nsr", "Told apart", "Ranks", "Geometric mean ratio"}),
        ("brouri_reading_gains", {"Gauge"}),
        ("wang_efficiency", {"Beyond"}),
        ("mzyk_reduction", {"Hang on a single trial"}),
    ],
)
def test_words_are_explained_on_the_page_that_they_stand_on(read, run, words):
    page = read[f"runs/{run}.html"]
    links = [one for one in page.of("a") if "glossary.html#" in (one["attributes"].get("href") or "")]
    assert words <= {one["text"] for one in links}
    anchors = {one["attributes"].get("id") for one in read["handbook/glossary.html"].of("h2")}
    assert {one["attributes"]["href"].partition("#")[2] for one in links} <= anchors


def test_runs_of_the_same_printed_numbers_name_each_other(read):
    for one, other in (("chen_vif", "chen_table1"), ("chen_table1", "chen_vif")):
        page = read[f"runs/{one}.html"]
        assert (other, f"{other}.html") in {(e["text"], e["attributes"].get("href")) for e in page.of("a")}
        assert "The same printed numbers stand beside" in " ".join(page.text_of("p"))
    assert "there the joint p rejects our reading" in " ".join(read["runs/chen_table1.html"].text_of("p"))


def test_numbers_of_ours_beside_one_printed_number_are_told_apart(read):
    where = [text for text in read["runs/mzyk_reduction.html"].text_of("p") if "small and moderate N" in text]
    assert len(where) == len({*where}) == len(rows_of("mzyk_reduction"))


def test_a_table_says_at_its_bar_what_it_could_not_tell_from_our_reading(read):
    said = " ".join(read["runs/chen_table1.html"].text_of("p"))
    assert "What it could not tell from our reading: " in said
    assert "noise twice as strong" in said.partition("What it could not tell")[2][:400]


def test_every_table_of_the_ledger_stands_on_the_front_page(read):
    front = read["index.html"]
    rows = [element for element in front.of("tr") if "data-verdict" in element["attributes"]]
    with_numbers = {(run, row["table"]) for run in JUDGED for row in rows_of(run) if row["mark"] == ""}
    assert len(rows) == len(with_numbers)
    words = {word for row in rows for word in row["attributes"]["data-verdict"].split("|")}
    assert words == set(WORDS)
    methods = {option["text"] for option in front.of("option")}
    assert {"kernel regression estimate (Mzyk)", "two-stage algorithm, TSA (Wang, Zhang, Ljung)"} <= methods


def rows_of(config):
    with (RESULTS / config / VERDICTS).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_differences_stand_beside_their_reasons(read):
    page = read["runs/mzyk_table1.html"]
    [first, second] = page.of("div", class_="reason")
    assert "falls more slowly than h ~ N\N{MINUS SIGN}1/5 allows" in first["text"]
    assert "printed 4.42, ours 2.807 [2.245 to 3.528]" in " ".join(first["text"].split())
    assert "9.06" in second["text"]
    assert "4.87" in second["text"]


def test_all_numbers_that_differ_stand_on_one_page_and_lead_to_their_cells(read):
    page = read["differences.html"]
    rows = page.of("li")
    rows = [one for one in rows if "data-paper" in one["attributes"]]
    differing = [
        (run, row)
        for run in JUDGED
        for row in rows_of(run)
        if row["verdict"] == "differs" and row["mark"] in COUNTED
    ]
    assert len(rows) == len(differing) > 20
    said = [" ".join(one["text"].split()) for one in rows]
    for _, row in differing:
        place = row["table"], row["row"], row.get("case"), row["quantity"]
        words = seen(", ".join(filter(None, place)))
        assert any(words in text and f"{row['printed'].lstrip('<>')}, ours " in text for text in said), words
    links = [one["attributes"]["href"] for one in page.of("a")]
    for run, row in differing:
        place = rows_of(run).index(row) + 1
        assert f"runs/{run}.html#number-{place}" in links
        assert any(
            one["attributes"].get("id") == f"number-{place}" for one in read[f"runs/{run}.html"].of("button")
        )
    assert {one["attributes"]["data-why"] for one in rows} <= {
        "misprint",
        "a reason is given",
        "no reason yet",
    }
    assert any(one["attributes"]["data-why"] == "misprint" for one in rows)
    assert "differences.html" in [one["attributes"]["href"] for one in read["index.html"].of("a")]


def test_where_nothing_differs_no_page_says_so(tmp_path):
    build([RESULTS / "wang_table1"], tmp_path / "site", results=RESULTS, **FOLDERS)
    assert not (tmp_path / "site" / "differences.html").exists()
    front = (tmp_path / "site" / FRONT).read_text(encoding="utf-8")
    assert "differences.html" not in front


def test_more_differences_than_a_page_bears_are_told_of(tmp_path, monkeypatch):
    monkeypatch.setattr(differences, "_MOST", 3)
    build([RESULTS / "chen_table1"], tmp_path / "site", results=RESULTS, **FOLDERS)
    page = pages(tmp_path / "site")["differences.html"]
    assert len([one for one in page.of("li") if "data-paper" in one["attributes"]]) == 3
    wrong = sum(row["verdict"] == "differs" and row["mark"] in COUNTED for row in rows_of("chen_table1"))
    assert f"{wrong - 3} more stand on the pages of the runs." in page.text_of("p")


def test_symbols_are_set_as_such_in_titles_tables_and_cells(site, read):
    html = (site / "runs/wang_table2.html").read_text(encoding="utf-8")
    assert "W=<var>R</var><sup>\N{MINUS SIGN}1</sup> estimated</th>" in html
    assert "R^-1</th>" not in html
    html = (site / "runs/mzyk_rates.html").read_text(encoding="utf-8")
    [title] = read["runs/mzyk_rates.html"].text_of("h1")
    assert title == seen(
        json.loads((RESULTS / "mzyk_rates" / RUN).read_bytes())["experiment"]["resolved"]["title"]
    )
    variance = read["runs/mzyk_variance.html"]
    assert any("\N{GREEK SMALL LETTER SIGMA}z2=1" in text for text in variance.text_of("th"))


def test_the_true_value_stands_in_the_details_of_an_estimated_one(read):
    rows = rows_of("chen_table1")
    details = {
        one["attributes"]["id"]: one for one in read["runs/chen_table1.html"].of("div", class_="detail")
    }
    true = {"a3": "3", "a2": "4", "a1": "4", "b1": "-1"}
    for i, row in enumerate(rows):
        said = details[f"n{i + 1}"]["text"]
        if row["quantity"] in true:
            assert f"true value{true[row['quantity']]}" in said.replace("\n", "")
        else:
            # No true value of the system is the variance inflation of an estimate.
            assert "true value" not in said


def test_true_values_are_those_of_the_file_that_was_run(tmp_path):
    plugins.load()
    config = ROOT / "configs" / "chen_table1.yaml"
    resolved = json.loads((RESULTS / "chen_table1" / RUN).read_bytes())["experiment"]["resolved"]
    assert truths(config, resolved)["I", "case B", "stage 1 a_3"] == 3.0
    assert truths(tmp_path / "nothing.yaml", resolved) == {}
    assert truths(written(tmp_path, "broken.yaml", "version: ["), resolved) == {}
    text = config.read_text(encoding="utf-8")
    assert truths(config, {**resolved, "seed": 1}) == {}
    # To load a file that names plugins is to run them.
    ran = tmp_path / "ran"
    written(tmp_path, "plugin.py", f"open({str(ran)!r}, 'w')")
    assert truths(written(tmp_path, "plugged.yaml", f"plugins: [plugin.py]\n{text}"), resolved) == {}
    assert not ran.exists()


def test_every_method_of_ours_has_the_name_that_papers_use():
    ours = {kind for kind, cls in components("estimator").items() if cls.__module__.startswith("hident.")}
    assert ours == set(methods._NAMES)
    assert len(set(methods._NAMES.values())) == len(ours)


def test_a_page_loads_files_of_the_site_alone(read):
    for page in read.values():
        [policy] = [one["attributes"] for one in page.of("meta") if "http-equiv" in one["attributes"]]
        assert policy["http-equiv"] == "Content-Security-Policy"
        assert policy["content"].startswith("default-src 'none'; ")
        assert "http:" not in policy["content"] and "unsafe-eval" not in policy["content"]
        # Scripts stand in files.
        assert all("src" in one["attributes"] and not one["text"] for one in page.of("script"))


def test_a_page_says_where_the_numbers_come_from_and_how_to_make_them_again(read):
    page = read["runs/mzyk_table1.html"]
    facts = dict(zip(page.text_of("dt"), page.text_of("dd"), strict=True))
    run = json.loads((RESULTS / "mzyk_table1" / RUN).read_bytes())
    assert facts["seed"] == "2009"
    assert facts["arithmetic"] == run["provenance"]["arithmetic"]["identity"]
    assert run["provenance"]["git_commit"] in facts["commit"]
    code = page.text_of("code")
    for command in ("hident run mzyk_table1", "hident power mzyk_table1", "hident compare out results"):
        assert command in code
    entries = "\n".join(element["text"] for element in page.of("pre"))
    assert "@article{mzyk2009," in entries
    assert "10.1109/LSP.2009.2024795" in entries


def test_commands_name_a_study_by_the_file_that_they_find(run, tmp_path):
    def commands():
        sources = Sources(
            (Run("valve", RunFolder(run), RESULTS),), ROOT / "experiments", tmp_path / "configs", ROOT
        )
        page = rendered(next(page for part in runs.parts(sources) for page in part.make()))
        return Reader(page.html).text_of("dt")

    rewritten(run, lambda content: content["experiment"].update(config="valve"))
    assert "hident run valve" in commands()
    written(tmp_path, "valve/valve.yaml", "")
    assert "hident run valve/valve.yaml" in commands()
    assert "hident show out/valve" in commands()
    # It was never accepted.
    assert not any(line.startswith("hident compare") for line in commands())
    written(tmp_path, "configs/valve.yaml", "")
    assert "hident run valve" in commands()


def test_alternatives_stand_with_what_they_change_and_what_the_table_makes_of_them(read):
    rows = [
        " ".join(row["text"].split())
        for row in read["runs/mzyk_table1.html"].of("tr")
        if "pole 0.6 for 0.8" in row["text"]
    ]
    assert rows == ["pole 0.6 for 0.8system.linear.a: [0.6]6 of 24< 0.001rejected"]


def test_each_key_of_a_configuration_leads_to_its_meaning(read):
    links = {
        (element["text"], element["attributes"]["href"]) for element in read["runs/mzyk_table1.html"].of("a")
    }
    assert ("bandwidth", "../components/estimator/kernel.html#key-bandwidth") in links
    assert ("h0", "../components/estimator/kernel.html#key-bandwidth.h0") in links
    assert ("order", "../components/estimator/instrumental_variables.html#key-order") in links
    assert ("trials", "../components/file.html#key-trials") in links
    assert ("kind", "../components/metric/mise.html") in links


@pytest.mark.parametrize("config", RUNS)
def test_the_configuration_on_a_page_is_the_yaml_of_what_was_run(config):
    plugins.load()
    resolved = json.loads((RESULTS / config / RUN).read_bytes())["experiment"]["resolved"]
    lines = configuration.lines(resolved)
    assert len(lines) < configuration.MOST_LINES
    text = "\n".join(f"{line.before}{line.key}{line.after}" for line in lines)
    assert read_leniently(Path("shown.yaml"), text.encode()).data == resolved
    assert any(line.target.startswith("components/estimator/") for line in lines)


def test_the_same_results_give_the_same_bytes(site, tmp_path):
    again = tmp_path / "elsewhere" / "other"
    build([RESULTS], again, results=RESULTS, **FOLDERS)
    assert digests(again) == digests(site)


def digests(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_pages_are_kept_until_what_they_are_made_of_changes(run, tmp_path):
    other = tmp_path / "out" / "wang_table2"
    shutil.copytree(RESULTS / "wang_table2", other)
    both = [tmp_path / "out"]
    first = build(both, tmp_path / "site", results=RESULTS, **FOLDERS)
    before = digests(tmp_path / "site")
    second = build(both, tmp_path / "site", results=RESULTS, **FOLDERS)
    assert (first.made, second.made) == (first.pages, 0)
    assert digests(tmp_path / "site") == before
    rewritten(run, lambda content: content["experiment"]["resolved"].update(title="Renamed"))
    third = build(both, tmp_path / "site", results=RESULTS, **FOLDERS)
    changed = {name for name, digest in digests(tmp_path / "site").items() if before[name] != digest}
    assert {"runs/index.html", "runs/mzyk_table1.html"} <= changed
    assert not {"runs/wang_table2.html", "handbook/verdicts.html"} & changed
    assert 0 < third.made < third.pages


def test_what_is_no_longer_shown_is_removed(run, tmp_path):
    build([run], tmp_path / "site", results=RESULTS, **FOLDERS)
    kept = tmp_path / "site" / "runs" / "mine.txt"
    kept.write_text("mine")
    renamed = run.rename(run.with_name("renamed"))
    build([renamed], tmp_path / "site", results=RESULTS, **FOLDERS)
    assert not (tmp_path / "site" / "runs" / "mzyk_table1.html").exists()
    assert not (tmp_path / "site" / "runs" / "mzyk_table1").exists()
    assert (tmp_path / "site" / "runs" / "renamed.html").exists()
    assert kept.read_text() == "mine"


def test_a_folder_of_other_files_is_not_written_to(run, tmp_path):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "thesis.tex").write_text("mine")
    with pytest.raises(ConfigError, match="site holds what is no site: name another folder with --out"):
        build([run], tmp_path / "site", results=RESULTS, **FOLDERS)
    assert [path.name for path in (tmp_path / "site").iterdir()] == ["thesis.tex"]


def test_an_interrupted_build_is_gone_on_with(run, tmp_path, monkeypatch):
    """Also in the folder that one stands in."""
    (tmp_path / "site").mkdir()
    monkeypatch.chdir(tmp_path / "site")
    write, written = module._write, []

    def interrupted(*arguments):
        written.append(arguments)
        if len(written) == 5:
            raise KeyboardInterrupt
        write(*arguments)

    monkeypatch.setattr(module, "_write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        build([run], Path(), results=RESULTS, **FOLDERS)
    monkeypatch.setattr(module, "_write", write)
    assert 0 < len(list((tmp_path / "site").rglob("*.*"))) < 20
    build([run], Path(), results=RESULTS, **FOLDERS)
    assert dead_links(tmp_path / "site", pages(tmp_path / "site")) == []


def test_a_folder_without_runs_is_nothing_to_show(tmp_path):
    with pytest.raises(NothingToCompare, match="empty holds no run"):
        (tmp_path / "empty").mkdir()
        build([tmp_path / "empty"], tmp_path / "site", **FOLDERS)
    assert not (tmp_path / "site").exists()


def test_of_two_runs_of_one_name_the_first_is_shown(run, tmp_path):
    built = build([run, RESULTS / "mzyk_table1"], tmp_path / "site", results=RESULTS, **FOLDERS)
    assert built.runs == 1
    assert built.left_out == (f"{RESULTS / 'mzyk_table1'}: {run} is shown",)


EVIL = '<script>alert("it\'s")</script> & C:\\new\\table {{ 7 * 7 }}'


def test_names_and_texts_are_shown_as_they_are(run, tmp_path):
    """In titles, names of estimators and of tables, records, reasons and in the name of the folder."""
    run = run.rename(run.with_name("a \"b\" <i>'c' #1 100%"))

    def change(content):
        resolved = content["experiment"]["resolved"]
        resolved["title"] = EVIL
        content["experiment"]["records"] = [EVIL]
        content["provenance"]["cpu"] = EVIL
        resolved["estimators"][EVIL] = {"kind": EVIL}
        resolved["figures"] = {EVIL: {"kind": EVIL}, **resolved["figures"]}
        resolved["alternatives"]["pole 0.6 for 0.8"] = {EVIL: EVIL}

    for name in (VERDICTS, "table.md", "table.csv"):
        text = (run / name).read_text(encoding="utf-8")
        for was in ("Table I", "filtered series (16)", "MISE"):
            text = text.replace(was, EVIL.replace("|", "").replace('"', "") if name != "table.md" else EVIL)
        (run / name).write_text(text, encoding="utf-8")
    rewritten(run, change)
    built = build([run], tmp_path / "site", results=RESULTS, **FOLDERS)
    every_page = pages(tmp_path / "site")
    assert dead_links(tmp_path / "site", every_page) == []
    read = every_page[run_page(run.name)]
    scripts = [element for element in read.of("script") if "src" not in element["attributes"]]
    assert scripts == []
    assert read.text_of("h1") == [EVIL]
    assert read.text_of("title") == [f"{EVIL} · hident"]
    every = " ".join(element["text"] for element in read.elements if element["tag"] == "main")
    assert every.count("<script>alert") > 10
    assert "49" not in " ".join(read.text_of("h1"))
    assert built.runs == 1


def test_a_long_table_leaves_the_page_short(run):
    """10^4 rows in table.md and in timing.csv, 10^4 printed numbers, axes of 10^4 labels."""
    text = (run / "table.md").read_text(encoding="utf-8")
    row = "| 3000 | 2.81 |  4.42 ! | 0.269 |  0.22 ? | 2.69 |  4.87 ! | 1.34 |  1.25 ~ |\n"
    (run / "table.md").write_text(text.replace(row, 10_000 * row, 1), encoding="utf-8")
    timing = "samples,estimator,fits,median\n" + "".join(f"{i},kernel (4),7,0.002\n" for i in range(10_000))
    (run / "timing.csv").write_text(timing, encoding="utf-8")
    header, *numbers = (run / VERDICTS).read_text(encoding="utf-8").splitlines()
    many = [number.replace("N=", f"{i} N=") for i in range(500) for number in numbers[:20]]
    (run / VERDICTS).write_text("\n".join([header, *many, ""]), encoding="utf-8")
    header, *rows = (run / "table.csv").read_text(encoding="utf-8").splitlines()
    failed = [f"{i},kernel (4),mise,200,1,,,,,,,," for i in range(10_000)]
    (run / "table.csv").write_text("\n".join([header, *rows, *failed, ""]), encoding="utf-8")

    def lengthen(content):
        content["experiment"]["resolved"]["cases"].update(samples=[*range(10_000)])
        # As in the folders of runs that did not list them.
        del content["failures"]

    rewritten(run, lengthen)
    made, faults = pages_of(run)
    assert faults == ()
    assert max(len(html.encode()) for html in made.values()) < MOST_BYTES
    read = Reader(made[run_page(run.name)])
    said = read.text_of("p")
    assert len(read.of("button", class_="number")) == tables.MOST_NUMBERS
    assert f"{10_000 - tables.MOST_NUMBERS} more printed numbers stand in verdicts.csv." in said
    assert any(text.endswith("more rows stand in table.md.") for text in said)
    assert any(text.endswith("more rows stand in timing.csv.") for text in said)
    assert any(text.endswith("more rows stand in run.json.") for text in read.text_of("td"))


DAMAGE = {
    "run.json is missing: the run did not end": lambda run: (run / RUN).unlink(),
    "run.json cannot be read": lambda run: (run / RUN).write_bytes(b'{"experiment": '),
    "run.json is not that of a run": lambda run: (run / RUN).write_bytes(b'{"experiment": 7}'),
    "run.json is not as it was written": lambda run: (run / RUN).write_text(
        (run / RUN).read_text().replace('"seed": 2009', '"seed": 2010')
    ),
    "mise.png is missing": lambda run: (run / "mise.png").unlink(),
    "mise.png is not as it was written": lambda run: (run / "mise.png").write_bytes(b"GIF"),
    "verdicts.csv is missing": lambda run: (run / VERDICTS).unlink(),
    "verdicts.csv is not as it was written": lambda run: (run / VERDICTS).write_bytes(b"\xff\x00"),
    "trials.csv.xz is missing": lambda run: (run / "trials.csv.xz").unlink(),
    "trials.csv.xz is not as it was written": lambda run: (run / "trials.csv.xz").write_bytes(b""),
    "table.csv is not as it was written": lambda run: (run / "table.csv").write_bytes(b'a,"b\n\xff'),
    "table.md is not as it was written": lambda run: (run / "table.md").write_text("| a |\n## b\n| c | d"),
    "trials crashed: crashes.txt has the tracebacks": lambda run: (run / "crashes.txt").write_text("Oh"),
    "mise.png could not be drawn": lambda run: rewritten(run, lambda c: c.update(undrawn=["mise.png"])),
    "3 trials were ended by the clock, and count as failed": lambda run: rewritten(
        run, lambda content: content.update(timed_out={"trials": 3, "trial_timeout": 1.0})
    ),
}


@pytest.mark.parametrize("said", DAMAGE)
def test_what_is_damaged_or_missing_is_said_on_the_page(run, said):
    DAMAGE[said](run)
    made, faults = pages_of(run)
    read, first = Reader(made[run_page(run.name)]), Reader(made["index.html"])
    assert said in faults
    assert said in read.of("div", class_="fault")[0]["text"]
    assert read.of("h1")
    assert "Incomplete or damaged: mzyk_table1" in " ".join(
        first.of("div", class_="fault")[0]["text"].split()
    )


def test_alternatives_that_are_altered_are_damage_and_those_that_are_missing_are_none(run, tmp_path):
    """Nobody has to run the alternatives before there is something to look at."""
    lonely = Run(run.name, RunFolder(run), run.parent)
    assert lonely.facts.faults == ()
    assert lonely.facts.verdicts is not None
    assert "hident power mzyk_table1" in lonely.facts.verdicts.stale[0]
    shutil.copytree(RESULTS / "power" / "mzyk_table1", run.parent / "power" / "mzyk_table1")
    (run.parent / "power" / "mzyk_table1" / "numbers.csv").write_text("table\n")
    damaged = Run(run.name, RunFolder(run), run.parent)
    assert damaged.facts.faults == ("power/mzyk_table1/numbers.csv is not as it was written",)


def every_place(content, path=()):
    """The places of a JSON document, down to the third level."""
    yield path
    if isinstance(content, dict) and len(path) < 4:
        for key, value in content.items():
            yield from every_place(value, (*path, key))


CONTENT = json.loads((RESULTS / "mzyk_table1" / RUN).read_bytes())


@pytest.mark.parametrize("value", [None, 7, "x", [1], {"a": 1}], ids=str)
def test_no_content_of_run_json_keeps_a_page_from_being_made(run, value):
    for path in every_place(CONTENT):
        content = json.loads(json.dumps(CONTENT))
        place = content
        for key in path[:-1]:
            place = place[key]
        if path:
            place[path[-1]] = value
        else:
            content = value
        (run / RUN).write_text(json.dumps(content), encoding="utf-8")
        made, faults = pages_of(run)
        assert faults, path
        assert len(made) == 3


def test_the_program_says_where_the_site_is_and_what_is_wrong(lab):
    lab.run()
    done = lab.hident("report", "out")
    assert "1 runs on" not in done.stdout
    assert "1 run on" in done.stdout
    assert done.stdout.splitlines()[-1] == (lab.folder / "site" / "index.html").as_uri()
    again = lab.hident("report", "out/tiny", "--out", "site")
    assert ", none of them made anew" in again.stdout
    (lab.folder / "out/tiny/table.md").unlink()
    broken = lab.hident("report", code=1)
    assert "unsound: out/tiny: table.md is missing" in broken.stdout
    assert "holds no run" in lab.hident("report", "elsewhere", code=4).stderr
    assert lab.hident("report", "--out", "tiny.yaml", code=2).stderr.startswith("error: tiny.yaml holds what")


def test_the_front_page_counts_each_printed_number_once(read):
    """And the README says of each paper how many it prints, as its published.csv has them."""
    said = " ".join(read["index.html"].of("div", class_="total")[0]["text"].split())
    papers = {file.parent.name: len(numbers_in(file)) for file in ROOT.glob("experiments/*/published.csv")}
    places: dict[tuple[str, ...], list[str]] = {}
    for config in JUDGED:
        paper = json.loads((RESULTS / config / RUN).read_bytes())["experiment"]["resolved"]["paper"]
        for row in rows_of(config):
            places.setdefault((paper, row["table"], row["row"], row["quantity"]), []).append(row["mark"])
    counting = [key for key, marks in places.items() if {*COUNTED} & {*marks}]
    verdicts = sum(mark in COUNTED for marks in places.values() for mark in marks)
    assert said.startswith(f"{sum(papers.values())} printed numbers of {len(papers)} papers.")
    assert f"{len(counting)} count; of the others, " in said
    assert f"there are {verdicts} verdicts, and" in said
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    typed = re.findall(r"\[(\d+) (?:printed )?numbers judged[^]]*\]\(experiments/(\w+)/README.md\)", readme)
    assert {paper: int(count) for count, paper in typed} == papers


def numbers_in(file):
    with file.open(newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def test_each_verdict_has_the_sign_of_table_md_and_its_word(read):
    for path, reader in read.items():
        for sign in reader.of("span", class_="sign"):
            assert not {*"\N{CHECK MARK}\N{ALMOST EQUAL TO}\N{BALLOT X}"} & {*sign["text"]}, path
    legend = [" ".join(item["text"].split()) for item in read["index.html"].of("ul", class_="legend")]
    assert len(legend) == 1
    for word, sign in SIGNS.items():
        assert f"{sign} {word} " in legend[0]


def test_failures_stand_by_their_reasons(run):
    """Those that run.json lists; of older files, what table.csv counts."""
    unit = {"estimator": "kernel (4)", "at": {"samples": 50}, "failed": 3, "trials": 200}
    reasons = [{"reason": "the matrix is <singular>", "trials": 2}, {"reason": "no descent", "trials": 1}]
    other = {"estimator": "orthogonal (7)", "at": {}, "metrics": ["mise"], "failed": 4, "trials": 200}
    listed = [
        {**unit, "reasons": reasons},
        {**other, "reasons": [{"reason": "no descent", "trials": 4}]},
        {"estimator": 3},
    ]
    rewritten(run, lambda content: content.update(failures=listed))
    said = [" ".join(row["text"].split()) for row in page_of(run).of("tr")]
    at = said.index("5 \N{MULTIPLICATION SIGN} no descent")
    assert said[at : at + 5] == [
        "5 \N{MULTIPLICATION SIGN} no descent",
        "kernel (4)samples 501200the estimate",
        "orthogonal (7)4200mise",
        "2 \N{MULTIPLICATION SIGN} the matrix is <singular>",
        "kernel (4)samples 502200the estimate",
    ]
    rewritten(run, lambda content: content.update(failures=[]))
    assert "No trial failed." in page_of(run).text_of("p")
    rewritten(run, lambda content: content.pop("failures"))
    assert "No trial failed." in page_of(run).text_of("p")
    header, first, *rows = (run / "table.csv").read_text(encoding="utf-8").splitlines()
    cells = first.split(",")
    cells[header.split(",").index("failed")] = "7"
    (run / "table.csv").write_text("\n".join([header, ",".join(cells), *rows, ""]), encoding="utf-8")
    assert any(
        "7 \N{MULTIPLICATION SIGN} The files do not hold why" in row["text"] for row in page_of(run).of("tr")
    )
    (run / "table.csv").unlink()
    assert "Not known." in page_of(run).text_of("p")


def test_seconds_are_shown_in_milliseconds_with_the_machine(run):
    rows = "50,kernel (4),200,0.00123456,0.001,0.002,1.0,True\n50,orthogonal (7),0,,,,,False\n"
    (run / "timing.csv").write_text(
        f"samples,estimator,fits,median,q25,q75,relative,batched\n{rows}", encoding="utf-8"
    )
    page = page_of(run)
    said = [" ".join(row["text"].split()) for row in page.of("tr")]
    assert "50kernel (4)2001.231.002.001.00yes" in said
    assert "50orthogonal (7)0no" in said
    cpu = json.loads((RESULTS / "mzyk_table1" / RUN).read_bytes())["provenance"]["cpu"]
    assert any(text.startswith("What one fit takes") and f"cpu {cpu}" in text for text in page.text_of("p"))


def test_the_numbers_that_a_figure_draws_stand_beside_it_unpacked(run, tmp_path):
    text = "panel,curve,x,y\n1,kernel (4),50,12.5\n"
    (run / "mise.data.csv.xz").write_bytes(lzma.compress(text.encode()))
    rewritten(run, lambda content: content["files"].append("mise.data.csv.xz"))
    built = build([run], tmp_path / "site", results=RESULTS, **FOLDERS)
    assert built.faults == ()
    assert (tmp_path / "site/runs/mzyk_table1/mise.data.csv").read_text(encoding="utf-8") == text
    read = pages(tmp_path / "site")
    assert [link for page, link in dead_links(tmp_path / "site", read) if page.startswith("runs/")] == []
    captions = [" ".join(one["text"].split()) for one in read["runs/mzyk_table1.html"].of("figcaption")]
    assert any(said.endswith("what it draws: mise.data.csv") for said in captions)
    (run / "mise.data.csv.xz").write_bytes(b"no xz")
    broken = build([run], tmp_path / "site", results=RESULTS, **FOLDERS)
    assert any("mise.data.csv.xz is not as it was written" in fault for fault in broken.faults)


def test_the_packed_drawing_of_a_figure_is_shown_and_a_broken_one_is_not(run, tmp_path):
    text = '<svg width="504pt" height="324pt" viewBox="0 0 504 324" xmlns="http://www.w3.org/2000/svg"/>'
    (run / "mise.svg.xz").write_bytes(lzma.compress(text.encode()))
    rewritten(run, lambda content: content.update(files=[*dict.fromkeys([*content["files"], "mise.svg.xz"])]))
    built = build([run], tmp_path / "site", results=RESULTS, **FOLDERS)
    assert built.faults == ()
    assert (tmp_path / "site/runs/mzyk_table1/mise.svg").read_text(encoding="utf-8") == text
    read = pages(tmp_path / "site")
    assert [link for page, link in dead_links(tmp_path / "site", read) if page.startswith("runs/")] == []

    def shown(read):
        found = [one["attributes"] for one in read["runs/mzyk_table1.html"].of("img")]
        [one] = [one for one in found if "(mise)" in one["alt"]]
        return one["src"], one["width"], one["height"]

    # As large as the PNG of the same figure, of 7 x 4.5 inches.
    assert shown(read) == ("mzyk_table1/mise.svg", "1120", "720")
    (run / "mise.svg.xz").write_bytes(b"no xz")
    broken = build([run], tmp_path / "site", results=RESULTS, **FOLDERS)
    assert any("mise.svg.xz is not as it was written" in fault for fault in broken.faults)
    assert shown(pages(tmp_path / "site"))[0] == "mzyk_table1/mise.png"


def test_the_picture_of_the_ledger_has_every_table(site):
    text = (site / "ledger.svg").read_text(encoding="utf-8")
    for config, table in {(run, row["table"]) for run in JUDGED for row in rows_of(run) if not row["mark"]}:
        assert f"{table} ({config})" in text.replace("&amp;", "&")
    assert text.startswith("<svg xmlns")


def test_the_picture_in_the_readme_is_that_of_the_accepted_results(site):
    """`make ledger` writes it anew."""
    assert (ROOT / "docs" / "ledger.svg").read_bytes() == (site / "ledger.svg").read_bytes()
    assert "docs/ledger.svg" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_a_bar_has_a_length_for_each_verdict_and_says_it_in_words():
    bar = drawings.bar({"exact": 1, "differs": 3}, 100)
    assert 'aria-label="1 exact, 3 differs"' in bar
    assert bar.count('width="25"') == bar.count('width="75"') == 2


def test_no_page_of_a_record_shows_the_folders_of_a_machine(site):
    for path in (FRONT, run_page("data_tanks")):
        said = (site / path).read_text(encoding="utf-8")
        assert "Measured record dataBenchmark.csv" in said
        assert "record ../" not in said
    assert tables.without_folders("Record /home/a/b.csv: 3 m/s") == "Record b.csv: 3 m/s"


def test_the_front_page_shows_no_statistics_of_single_trials(site):
    said = (site / FRONT).read_text(encoding="utf-8").partition('id="measured"')[2]
    assert ">trials</th>" not in said and "data_example" in said


def test_a_popover_has_a_button_that_closes_it(read):
    elements = read[run_page("chen_table1")].elements
    opened = {e["attributes"]["id"] for e in elements if "popover" in e["attributes"]}
    closed = {
        e["attributes"]["popovertarget"]
        for e in elements
        if e["attributes"].get("popovertargetaction") == "hide"
    }
    assert opened and opened == closed


def test_print_leaves_popovers_out(site):
    (css,) = site.rglob("site*.css")
    printed = css.read_text(encoding="utf-8").partition("@media print")[2]
    assert ".detail[popover] { display: none; }" in printed


def test_the_front_page_explains_the_columns_of_a_record_and_rounds_p_values(site):
    said = (site / FRONT).read_text(encoding="utf-8").partition('id="measured"')[2]
    assert "RMSE in V, fit index in percent" in said and "Metric white: p-value of" in said
    assert "&lt; 1e-3" in said and not re.search(r">\d\.\d+e-(\d{3}|0[4-9]|[1-9]\d)<", said)


def test_a_readme_that_a_configuration_names_is_a_link_where_it_has_a_page(site):
    said = (site / run_page("data_tanks")).read_text(encoding="utf-8")
    assert re.search(r'<p class="lead">.*<a href="[^"]+">experiments/data_tanks/README.md</a>', said)


def test_a_readme_without_a_page_stays_text(tmp_path):
    sources = Sources((), **{**FOLDERS, "experiments": tmp_path})
    assert runs._linked("See experiments/none/README.md.", sources) == [
        ("See ", ""),
        ("experiments/none/README.md", ""),
        (".", ""),
    ]
