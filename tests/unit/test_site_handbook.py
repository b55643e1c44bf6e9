"""The site's handbook: every link of every document is alive, and what it says is shown as it stands."""

import posixpath
from pathlib import Path
from urllib.parse import unquote

import pytest

from hident import plugins
from hident.reports.site import components, handbook, papers
from hident.reports.site.markdown import code, document, site_path, slug
from hident.reports.site.notation import formula, in_words
from hident.reports.site.pages import Run, Sources, handbook_page
from hident.reports.site.rendering import rendered
from hident.run_folder import RunFolder
from tests.unit.test_site_components import Read

plugins.load()
ROOT = Path(__file__).parents[2]
RUNS = tuple(
    Run(path.parent.name, RunFolder(path.parent), ROOT / "results")
    for path in sorted((ROOT / "results").glob("*/run.json"))
)
SOURCES = Sources(RUNS, ROOT / "experiments", ROOT / "configs", ROOT / "docs")
DOCUMENTS = sorted(SOURCES.documents)


@pytest.fixture(scope="module")
def pages():
    parts = [part for module in (handbook, papers, components) for part in module.parts(SOURCES)]
    return {page.path: rendered(page) for part in parts for page in part.make()}


@pytest.fixture(scope="module")
def read(pages):
    return {path: Read(page.html) for path, page in pages.items()}


def test_every_document_has_a_page_but_the_reference():
    assert {path.stem for path in (ROOT / "docs").glob("*.md")} | {"README", "bench"} == {
        *DOCUMENTS,
        "reference",
    }


@pytest.mark.parametrize("stem", [*DOCUMENTS, "index"])
def test_every_link_is_alive(pages, read, stem):
    path = handbook_page(stem)
    held = {*SOURCES.held, *pages, "index.html", "runs/index.html", "search.html"}
    assert_links_are_alive(path, read, held)


@pytest.mark.parametrize("paper", sorted(path.parent.name for path in ROOT.glob("experiments/*/README.md")))
def test_every_link_of_a_paper_is_alive(pages, read, paper):
    held = {*SOURCES.held, *pages, "index.html", "runs/index.html", "search.html"}
    assert_links_are_alive(f"papers/{paper}.html", read, held)


def assert_links_are_alive(path, read, held):
    for link in read[path].links:
        if link.startswith(("https://", "http://")):
            continue
        target, _, anchor = link.partition("#")
        to = posixpath.normpath(posixpath.join(posixpath.dirname(path), unquote(target))) if target else path
        assert to in held, f"{path}: {link}"
        if anchor and to in read:
            assert anchor in read[to].ids, f"{path}: {link}"


@pytest.mark.parametrize("stem", DOCUMENTS)
def test_no_link_of_a_document_is_lost(read, stem):
    """A link that the site cannot follow would become plain words: of ours, none does."""
    from markdown_it import MarkdownIt

    text = SOURCES.documents[stem].read_text(encoding="utf-8")
    tokens = MarkdownIt("commonmark").enable("table").parse(text)
    written = [child for token in tokens for child in token.children or () if child.type == "link_open"]
    body = handbook.read(stem, SOURCES).body
    automatic = len([one for one in Read(body).links if one.startswith("#")]) - len(
        [one for one in written if str(one.attrs["href"]).startswith("#")]
    )
    own = body.count('class="anchor"')
    assert automatic == own
    named = sum(1 for token in tokens for child in token.children or () if _is_run(child))
    assert len(Read(body).links) - own >= len(written)
    assert len(Read(body).links) - own <= len(written) + named


def _is_run(token):
    name = token.content.removeprefix("configs/").removesuffix(".yaml")
    return token.type == "code_inline" and name in {run.name for run in RUNS}


@pytest.mark.parametrize("stem", DOCUMENTS)
def test_every_word_of_a_document_stands_on_its_page(read, stem):
    text = SOURCES.documents[stem].read_text(encoding="utf-8")
    words = {word for word in text.split() if word.isalpha() and word not in ("begin", "end")}
    assert words - {*read[handbook_page(stem)].words.replace("(", " ").split()} == set()


def test_a_document_has_a_table_of_contents_and_neighbours(read):
    page = read["handbook/verdicts.html"]
    assert {"#the-interval", "#the-joint-test", "#the-ledger"} <= {*page.links}
    assert {"reproducing.html", "comparisons.html", "architecture.html"} <= {*page.links}


def test_links_lead_to_pages_of_the_site(read):
    assert "../components/index.html" in read["handbook/README.html"].links
    assert "../papers/mzyk2009.html" in read["handbook/README.html"].links
    assert "README.html" in read["handbook/configuration.html"].links
    assert "../runs/chen_table1.html" in read["handbook/verdicts.html"].links
    assert "../handbook/verdicts.html" in read["papers/chen2009.html"].links
    assert "bench.html" in {link for page in read.values() for link in page.links}


def test_the_index_says_what_each_document_is_about(read):
    for stem in DOCUMENTS:
        assert f"{stem}.html" in read["handbook/index.html"].links
    assert all(lead for group in handbook._GROUPS.values() for lead in group.values())


def test_no_page_is_larger_than_300_kb(pages):
    assert max(len(page.html.encode()) for page in pages.values()) < 300_000


def test_the_same_pages_come_out_again(pages):
    again = [page for part in handbook.parts(SOURCES) for page in part.make()]
    assert all(rendered(page) == pages[page.path] for page in again)


def test_without_documents_the_page_says_where_to_have_them(tmp_path):
    sources = Sources((), tmp_path, tmp_path, tmp_path / "docs")
    [page] = [page for part in handbook.parts(sources) for page in part.make()]
    assert "hident report --docs FOLDER" in Read(rendered(page).html).words


def test_the_documents_of_the_package_are_those_of_the_checkout():
    assert handbook.docs_folder().resolve() == ROOT / "docs"


def nothing(path):
    return False


def everything(path):
    return True


def test_markup_of_a_text_is_shown_and_a_comment_is_not():
    made = document(
        "# <i>T</i>\n\n<script>x</script>\n\na <b>b</b> <!-- no -->\n\n<!-- no\nno -->", "p.html", "", nothing
    )
    assert made.title == "T"
    assert {*Read(made.body).tags} <= {"h1", "p"}
    assert "<script>x</script>" in Read(made.body).words
    assert "no" not in Read(made.body).words


def test_headings_have_the_anchors_of_code_hosts_each_its_own():
    made = document(
        "# A\n\n## Up to `what`, a metric?\n\n## Up to what a metric\n\n### Café_2", "p.html", "", nothing
    )
    anchors = [heading.anchor for heading in made.headings]
    assert anchors == ["up-to-what-a-metric", "up-to-what-a-metric-1", "café_2"]
    assert slug("a - b") == "a---b"


@pytest.mark.parametrize(
    ("file", "page"),
    [
        ("docs/verdicts.md", "handbook/verdicts.html"),
        ("docs/reference.md", "components/index.html"),
        ("README.md", "handbook/README.html"),
        ("experiments/mzyk2009/README.md", "papers/mzyk2009.html"),
        ("results/power/chen_table1/table.md", "runs/chen_table1.html"),
        ("results/chen_table1/stage2.png", "runs/chen_table1/stage2.png"),
        ("results/bench.md", "handbook/bench.html"),
        ("configs/chen_table1.yaml", "runs/chen_table1.html"),
        ("LICENSE", "handbook/LICENSE"),
        ("tests/unit/test_spec.py", None),
    ],
)
def test_files_of_the_project_have_their_place(file, page):
    assert site_path(file) == page


def test_a_link_to_what_is_not_there_becomes_its_words():
    made = document("[one *two*](gone.md) ![a `picture`](gone.png) [three](#a)", "p.html", "docs", nothing)
    assert Read(made.body).links == ["#a"]
    assert "img" not in Read(made.body).tags
    assert Read(made.body).words.split() == ["one", "two", "a", "picture", "three"]


def test_a_link_and_a_picture_lead_there_from_where_the_page_stands():
    text = '[a](../results/r/table.md "row; column") ![b](../results/r/x y.png) [c](javascript:alert(1))'
    body = document(text.replace("x y", "x%20y"), "handbook/p.html", "docs", everything).body
    assert '<a href="../runs/r.html" title="row; column">' in body
    assert '<img src="../runs/r/x~20~y.png" alt="b" loading="lazy" />' in body
    assert "[c](javascript:alert(1))" in Read(body).words


def test_the_name_of_a_run_leads_to_its_page():
    body = document(
        "`r` [`r`](#x) `configs/r.yaml` `s`", "p.html", "", lambda path: path == "runs/r.html"
    ).body
    assert Read(body).links == ["runs/r.html", "#x", "runs/r.html"]


def test_a_table_can_be_scrolled_by_keyboard():
    body = document("| a |\n| - |\n| <b> |", "p.html", "", nothing).body
    assert '<div class="scroll" role="region" aria-label="Table 1" tabindex="0"><table>' in body
    assert "&lt;b&gt;" in body


@pytest.mark.parametrize(
    "language", ["yaml", "python", "console", "text", "", "no such language", '"><script>']
)
def test_code_is_escaped_in_every_language(language):
    source = "a: \"<script>\" # & 'x'\n\n  b: 1\n"
    marked = code(source, language)
    assert Read(marked).words == source
    assert {*Read(marked).tags} <= {"pre", "code", "span"}


def test_few_words_of_code_are_marked():
    marked = code("key: value  # why\n", "yaml")
    assert '<span class="keyword">key</span>' in marked
    assert '<span class="comment"># why</span>' in marked
    assert marked.count("<span") == 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a_1, ..., a_n", "<var>a</var><sub>1</sub>, ..., <var>a</var><sub>n</sub>"),
        ("e^(-delay s)", "<var>e</var><sup>\N{MINUS SIGN}delay <var>s</var></sup>"),
        ("exp(-x^2/2) N^1/5", "exp(-<var>x</var><sup>2</sup>/2) <var>N</var><sup>1/5</sup>"),
        ("y^(n)", "<var>y</var><sup>(<var>n</var>)</sup>"),
        ("-u^2 < 10^4", "-<var>u</var><sup>2</sup> &lt; 10<sup>4</sup>"),
        ("known_point, wang_table1, x_label, se_b_i", "known_point, wang_table1, x_label, se_b_i"),
        ("(s - p_2)^2", "(s - <var>p</var><sub>2</sub>)<sup>2</sup>"),
        ("a_<b>", "a_&lt;b&gt;"),
    ],
)
def test_symbols_in_sentences_have_their_indices(text, expected):
    assert in_words(text) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("theta = the sum of x", "θ = the sum of <var>x</var>"),
        ("sum_{i != k} b_i", "∑<sub><var>i</var> ≠ <var>k</var></sub> <var>b</var><sub>i</sub>"),
        (
            "pseudo-inverse - x(t-d)",
            "pseudo-inverse \N{MINUS SIGN} <var>x</var>(<var>t</var>\N{MINUS SIGN}<var>d</var>)",
        ),
        (
            "e^(-j (k-1) pi/2) <i>",
            "<var>e</var><sup>\N{MINUS SIGN}<var>j</var> (<var>k</var>\N{MINUS SIGN}1) π/2</sup> "
            "&lt;<var>i</var>&gt;",
        ),
        ("phi_k' y", "φ<sub>k</sub>\N{PRIME} <var>y</var>"),
    ],
)
def test_formulas_have_their_signs(text, expected):
    assert formula(text) == expected
