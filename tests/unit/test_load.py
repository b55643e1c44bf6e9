import json
import math
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hident.config.load import Document, Problem, override, read, read_leniently
from hident.config.yaml12 import Location, Place, shown, spelled
from hident.errors import ConfigError
from tests.unit.counted_calls import counted_calls

TEXTS = "no off yes on y 12:30 190:20:30 1_000 0b1 0o8 0x 1e . + 2*pi 2001-01-01 = << .e5 +.".split()  # noqa: SIM905


def loaded(folder, text):
    path = folder / "a.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read(path)


def value_of(folder, text):
    return loaded(folder, f"a: {text}\n").data["a"]


def refused(folder, text):
    """The message, with the folder left out."""
    with pytest.raises(ConfigError) as caught:
        loaded(folder, text)
    return str(caught.value).replace(f"{folder}/", "")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1E5", 1e5),
        (".5", 0.5),
        ("1.", 1.0),
        ("+12", 12),
        ("-0", 0),
        ("007", 7),
        ("0o17", 15),
        ("0x1F", 31),
        ("true", True),
        ("FALSE", False),
        ("~", None),
        ("null", None),
        ("", None),
        ("-.INF", -math.inf),
        ("'12'", "12"),
        ('"true"', "true"),
        *((text, text) for text in TEXTS),
        ("|\n  12\n", "12\n"),
    ],
)
def test_scalars_are_read_by_the_core_schema(tmp_path, text, value):
    found = value_of(tmp_path, text)
    assert (found, type(found)) == (value, type(value))


def test_nan(tmp_path):
    assert math.isnan(value_of(tmp_path, ".nan"))


def test_a_whole_number_of_too_many_digits_is_infinite_as_its_float_is(tmp_path):
    assert value_of(tmp_path, "9" * 250) == int("9" * 250)
    assert value_of(tmp_path, "9" * 5000) == math.inf
    assert value_of(tmp_path, "-" + "9" * 5000) == -math.inf
    assert value_of(tmp_path, "0x" + "f" * 300) == math.inf


@settings(deadline=None, derandomize=True, max_examples=200)
@given(st.one_of(st.integers(), st.floats(allow_nan=False, allow_infinity=False)), st.sampled_from("fegdxo"))
def test_numbers_are_read_as_python_reads_them(tmp_path_factory, value, form):
    folder = tmp_path_factory.getbasetemp()
    if isinstance(value, int):
        text = {"x": f"0x{abs(value):x}", "o": f"0o{abs(value):o}"}.get(form, str(value))
        assert value_of(folder, text) == (abs(value) if form in "xo" else value)
    else:
        text = f"{value:{form if form in 'feg' else ''}}"
        found = value_of(folder, text)
        assert found == float(text)
        assert isinstance(found, float) is not text.lstrip("-").isdigit()


def test_places_are_those_of_the_keys(tmp_path):
    document = loaded(tmp_path, "# first\na: 1\nb:\n  c:\n    - 1\n    - d: 2\n      e:\n        3\n")
    lines = {
        ("a",): 2,
        ("b", "c"): 4,
        ("b", "c", 0): 5,
        ("b", "c", 1, "e"): 7,
        ("b", "c", 1, "missing", "deeper"): 6,
        ("missing",): 2,
    }
    for location, line in lines.items():
        assert document.place(location) == Place(line, f"{tmp_path}/a.yaml:{line}")


def test_anchors_are_followed(tmp_path):
    document = loaded(tmp_path, "a: &x {k: [1, 2]}\nb: *x\n")
    assert document.data == {"a": {"k": [1, 2]}, "b": {"k": [1, 2]}}
    assert document.place(("b",)).line == 2
    assert document.place(("b", "k")).line == 1


MERGED = """\
common: &common
  kind: kernel
  bandwidth: &wide {h0: 1, alpha: 0.2}
other: &other
  kind: other
  order: 3
a:
  <<: *common
  kernel: gaussian
b: {kernel: window, <<: [*common, *other], bandwidth: {<<: *wide, h0: 2}}
c: {"<<": {kind: x}}
"""


def test_merge_keys_add_what_a_mapping_does_not_give_itself(tmp_path):
    data = loaded(tmp_path, MERGED).data
    assert data["a"] == {"kind": "kernel", "bandwidth": {"h0": 1, "alpha": 0.2}, "kernel": "gaussian"}
    assert data["b"] == {
        "kernel": "window",
        "kind": "kernel",
        "bandwidth": {"h0": 2, "alpha": 0.2},
        "order": 3,
    }
    assert data["c"] == {"<<": {"kind": "x"}}
    assert list(data["a"]) == ["kind", "bandwidth", "kernel"]


def test_merged_keys_stand_where_they_were_written(tmp_path):
    document = loaded(tmp_path, MERGED)
    places = {("a", "kind"): 2, ("a", "bandwidth", "h0"): 3, ("a", "kernel"): 9, ("b", "order"): 6}
    assert {at: document.place(at).line for at in places} == places


def test_merges_cannot_grow_without_bound(tmp_path):
    keys = ", ".join(f"k{i}: 1" for i in range(500))
    merges = ", ".join(["*a"] * 500)
    assert "holds more than 200000 values" in refused(tmp_path, f"a: &a {{{keys}}}\nb: {{<<: [{merges}]}}")


def test_a_file_that_is_too_large_is_refused_before_it_is_read_as_yaml(tmp_path):
    message = "a.yaml: cannot be read: it is larger than 256 kB, the most that a file of YAML may have"
    assert refused(tmp_path, "a: [" + "1," * 2**17 + "]") == message
    # Cut off in the middle of a character.
    assert refused(tmp_path, "#" * (2**18) + "\N{EURO SIGN}") == message
    assert loaded(tmp_path, "a: 1\n" + "#" * (2**18 - 5)).data == {"a": 1}


@pytest.mark.parametrize("text", ["a: 1\r\nb: 2\r\n", "\ufeffa: 1\nb: 2", "---\na: 1\nb: 2\n...\n"])
def test_line_ends_byte_order_mark_and_document_marks(tmp_path, text):
    assert loaded(tmp_path, text).data == {"a": 1, "b": 2}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.yaml:1: file: must be a mapping of keys to values, but it is empty"),
        ("# only a comment\n", "a.yaml:1: file: must be a mapping of keys to values, but it is empty"),
        ("- a\n- b", "a.yaml:1: file: must be a mapping of keys to values, but it is a list"),
        ("hello", "a.yaml:1: file: must be a mapping of keys to values, but it is 'hello'"),
        ("a: 1\n\tb: 2", "a.yaml:2: is not valid YAML: found character '\\t' that cannot start any token"),
        ("a: [1\nb: 2", "a.yaml:2: is not valid YAML: expected ',' or ']', but got ':'"),
        ("a: 'open", "a.yaml:1: is not valid YAML: found unexpected end of stream"),
        ("a: &x 1\nb: &x 2", "a.yaml:2: is not valid YAML: found duplicate anchor 'x'"),
        ("a: *x", "a.yaml:1: is not valid YAML: found undefined alias 'x'"),
        ("a: 1\n---\nb: 2", "a.yaml:2: is not valid YAML: but found another document"),
        ("a: 1\nb: '\x01'", "a.yaml:2: is not valid YAML: the character U+0001 is not allowed"),
        (b"a: 1\nb: \xff", "a.yaml:2: cannot be read: it is not UTF-8 text"),
        ("a: &x\n  - *x", "a.yaml:1: a[0]: an anchor cannot contain itself"),
        ("a: &x {b: {c: *x}}", "a.yaml:1: a.b.c: an anchor cannot contain itself"),
        ("a: &x {<<: *x}", "a.yaml:1: a.<<: an anchor cannot contain itself"),
        ("a: &x {<<: [{b: 1}, *x]}", "a.yaml:1: a.<<[1]: an anchor cannot contain itself"),
        (
            "a: &x 3\nb:\n  <<: *x",
            "a.yaml:1: b.<<: must be a mapping whose keys are merged, or a list of such",
        ),
        (
            "a: &x {c: 1}\nb: {<<: [*x, 2]}",
            "a.yaml:2: b.<<: must be a mapping whose keys are merged, or a list of such",
        ),
        ("a: &x {c: 1}\nb:\n  <<: *x\n  <<: *x", "a.yaml:4: b.<<: this key stands already in line 3"),
        ("b:\n  <<: {c: 1, c: 2}", "a.yaml:2: b.c: this key stands already in line 2"),
        ("? [a]\n: 1", "a.yaml:1: file: a key must be plain text"),
        ("a:\n  b: 1\n  c: 2\n  b: 3", "a.yaml:4: a.b: this key stands already in line 2"),
        ("1: a\n'1': b", "a.yaml:2: 1: this key stands already in line 1"),
        (
            "a: !!str 12",
            "a.yaml:1: a: the tag tag:yaml.org,2002:str is not allowed; quotation marks make a text",
        ),
        (
            "a: !!python/object/apply:os.system [ls]",
            "a.yaml:1: a: the tag tag:yaml.org,2002:python/object/apply:os.system is not allowed; "
            "quotation marks make a text",
        ),
        ("a: " + "[" * 60 + "]" * 60, "a.yaml:1: is nested more than 50 deep"),
        ("[" * 3000, "a.yaml: is not valid: it is nested more than 50 deep"),
        (
            "a: 1\nb: {c: 1, c: 2}\na: 2\nd: !x 1",
            "a.yaml:2: b.c: this key stands already in line 2\n"
            "a.yaml:3: a: this key stands already in line 1\n"
            "a.yaml:4: d: the tag !x is not allowed; quotation marks make a text",
        ),
    ],
)
def test_messages(tmp_path, text, message):
    assert refused(tmp_path, text) == message


def test_anchors_cannot_grow_without_bound(tmp_path):
    text = "a0: &a0 [1, 1]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
    said = []
    # A few for each of the values that are allowed.
    counted_calls(lambda: said.append(refused(tmp_path, text)), limit=20 * 200_000)
    assert "the file holds more than 200000 values" in said[0]


def test_a_key_in_quotation_marks_is_no_merge(lab):
    lab.configure(tables={"t": {"title": "t", "<<": 1}})
    assert "'<<': 1" in (lab.folder / "tiny.yaml").read_text()
    said = lab.hident("validate", "tiny.yaml", code=2).stderr
    assert "tables.t.kind: is required" in said


def test_what_is_quoted_at_length_is_shortened(lab):
    table = {
        "kind": "grid",
        "title": "t",
        "rows": "samples",
        "columns": [{"estimator": "x" * 20_000, "metric": "a"}],
    }
    lab.configure(tables={"t": table})
    said = lab.hident("validate", "tiny.yaml", code=2).stderr
    assert "there is no estimator 'xxx" in said
    assert "x ... x" in said
    assert all(len(line) < 2200 for line in said.splitlines())


def test_a_file_that_is_none(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "table1.yaml").touch()
    messages = {
        "configs": "configs: cannot be read: is a directory",
        "configs/tabel1.yaml": "configs/tabel1.yaml: no such file; did you mean 'configs/table1.yaml'?",
        "tabel1": "tabel1: no such file; did you mean 'table1'?",
        "something.yaml": "something.yaml: no such file",
    }
    for name, message in messages.items():
        with pytest.raises(ConfigError) as caught:
            read(type(tmp_path)(name))
        assert str(caught.value) == message


def test_a_bare_name_away_from_the_configurations_is_told_where_they_are_looked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        read(type(tmp_path)("table1"))
    assert str(caught.value) == (
        "table1: no such file, and no folder configs is here, in which such a name is looked for: "
        "run hident in the folder that holds it, or give the path of a file"
    )


def test_what_is_only_unclear_can_be_collected(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("a: 1\na: 2\n")
    document = read_leniently(path)
    assert document.data == {"a": 1}
    assert [complaint.line for complaint in document.complaints] == [2]


@settings(deadline=None, derandomize=True, max_examples=400)
@given(st.one_of(st.text(), st.text("ab:-[]{},&*!|>'\"#%?~ \n\t0.e", max_size=80), st.binary(max_size=40)))
@example("a: " + "{a: " * 2000)
@example("&a [*a]")
@example("!<tag:yaml.org,2002:int> x: 1")
@example("%YAML 3.0\n---\na: 1")
@example("a: 0x" + "f" * 6000)
@example("a: 1" + "0" * 6000)
@example("\ud800: 1".encode("utf-8", "surrogatepass"))
def test_any_text_is_read_or_refused(tmp_path_factory, text):
    folder = tmp_path_factory.getbasetemp()
    try:
        document = loaded(folder, text if isinstance(text, bytes) else text.encode("utf-8", "replace"))
    except ConfigError:
        return
    assert isinstance(document.data, dict)


_PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@settings(deadline=None, derandomize=True, max_examples=150)
@given(st.dictionaries(st.text(), _PLAIN, max_size=4))
def test_json_is_read_as_json_reads_it(tmp_path_factory, data):
    """JSON is YAML 1.2; PyYAML does not join surrogate pairs, so they are not escaped."""
    text = json.dumps(data)
    if "\\ud" not in text:
        assert loaded(tmp_path_factory.getbasetemp(), text).data == json.loads(text)


def document():
    data = {
        "seed": 1,
        "noise": "white",
        "cases": {"x.y": [1, 2], "h": {"0.5": {"a": 1}}},
        "system": {"linear": {"a": [0.8, 0.1]}},
    }
    places: dict[Location, Place] = {
        (): Place(1, "f:1"),
        ("seed",): Place(1, "f:1"),
        ("system", "linear", "a"): Place(4, "f:4"),
    }
    return Document("f", data, places)


@pytest.mark.parametrize(
    ("path", "location"),
    [
        ("seed", ("seed",)),
        ("new", ("new",)),
        ("system.linear.a.1", ("system", "linear", "a", 1)),
        ("system.linear.new", ("system", "linear", "new")),
        ("noise.std", ("noise", "std")),
        ("cases.x.y.0", ("cases", "x.y", 0)),
        ("cases.h.0.5.a", ("cases", "h", "0.5", "a")),
    ],
)
def test_a_patch_replaces_one_value_and_its_place(path, location):
    before = document()
    after = before.patched(path, 7, Place(9, "patch"))
    at = after.data
    for key in location:
        at = at[key]
    assert at == 7
    assert after.place(location) == Place(9, "patch")
    assert after.place((*location, "deeper")) == Place(9, "patch")
    assert before.data == document().data
    assert before.place(location).text.startswith("f:")


def test_a_bare_name_becomes_a_component_when_a_key_of_it_is_set():
    assert document().patched("noise.std", 1, Place(0, "x")).data["noise"] == {"kind": "white", "std": 1}


def test_a_later_patch_hides_the_earlier_ones_inside_it():
    after = document().patched("system.linear.a.0", 1, Place(1, "one")).patched("system", 2, Place(2, "two"))
    assert after.place(("system", "linear", "a", 0)).text == "two"


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("seed", "must be of the form key.path=value"),
        ("=3", "must be of the form key.path=value"),
        ("seed=[1", "is not valid YAML: expected ',' or ']', but got '<stream end>'"),
        ("seed={a: 1, a: 2}", "a: this key stands already"),
        ("seed=!!int 3", "value: the tag tag:yaml.org,2002:int is not allowed; quotation marks make a text"),
        (
            "sed.x=1",
            "sed.x: the file has no key 'sed'; did you mean 'seed'? (it has: seed, noise, cases, system)",
        ),
        ("seed.x=1", "seed.x: seed is 1, which has no key 'x'"),
        (
            "system.linar.a=1",
            "system.linar.a: system has no key 'linar'; did you mean 'linear'? (it has: linear)",
        ),
        (
            "system.linear.a.2=1",
            "system.linear.a.2: system.linear.a is a list of 2, so '2' must be one of 0, 1",
        ),
        (
            "system.linear.a.x=1",
            "system.linear.a.x: system.linear.a is a list of 2, so 'x' must be one of 0, 1",
        ),
    ],
)
def test_an_assignment_that_cannot_be_applied(assignment, message):
    with pytest.raises(ConfigError) as caught:
        override(document(), [assignment])
    assert str(caught.value) == f"--set {assignment}: {message}"


NAMES = ["W = I", "a=b=c", 'it\'s "so"', "x[0]", "=", "über", "a: b, {c}"]


@pytest.mark.parametrize("name", NAMES)
def test_names_in_an_assignment_may_hold_any_sign(name):
    data = {"estimators": {name: {"lags": 2}, "W": {"lags": 1}}, "cases": {f"estimators.{name}.degree": [1]}}
    before = Document("f", data)
    places: dict[str, Location] = {
        f"estimators.{name}.lags=3": ("estimators", name, "lags"),
        f"estimators.{name}.new = 3": ("estimators", name, "new"),
        f"estimators.{name} =3": ("estimators", name),
        f"cases.estimators.{name}.lags=3": ("cases", f"estimators.{name}.lags"),
        f"cases.estimators.{name}.degree=3": ("cases", f"estimators.{name}.degree"),
        f"cases.estimators.{name}.degree.0=3": ("cases", f"estimators.{name}.degree", 0),
    }
    for assignment, at in places.items():
        found: Any = override(before, [assignment]).data
        for key in at:
            found = found[key]
        assert found == 3, assignment
    assert before.data["estimators"][name] == {"lags": 2}


@pytest.mark.parametrize("value", ["a=b", "where(u >= 1, 2, 3)", "estimators.W=2"])
def test_values_in_an_assignment_may_hold_equals_signs(value):
    data = {"title": "", "estimators": {"W": {"lags": 1}}}
    assert override(Document("f", data), [f"title={value}"]).data["title"] == value
    assert override(Document("f", data), [f"estimators.W.new='{value}'"]).data["estimators"]["W"] == {
        "lags": 1,
        "new": value,
    }


def test_an_index_that_is_no_number_of_the_list_is_refused():
    with pytest.raises(ConfigError, match="must be one of 0, 1"):
        override(document(), [f"system.linear.a.{'9' * 5000}=1"])


def test_all_assignments_that_cannot_be_applied_are_named():
    with pytest.raises(ConfigError) as caught:
        override(document(), ["a", "seed=2", "b"])
    assert str(caught.value).splitlines() == [
        "--set a: must be of the form key.path=value",
        "--set b: must be of the form key.path=value",
    ]


def test_assignments_are_applied_in_their_order_and_read_as_yaml():
    after = override(document(), ["seed=5", "seed=1e-3", "noise={kind: white, std: [no, .5]}", "new=a=b"])
    assert after.data["seed"] == 1e-3
    assert after.data["noise"] == {"kind": "white", "std": ["no", 0.5]}
    assert after.data["new"] == "a=b"


def test_null_takes_out_what_has_a_name_of_its_own():
    data = {
        "noise": {"std": 1},
        "figures": {"wide": {}, "b": {}},
        "estimators": {"W": {"kind": "w", "known_point": {}}},
        "cases": {"N": [1], "noise.std": [2]},
    }

    def left(*assignments):
        return override(Document("f", data), assignments).data

    assert left("figures.wide=null")["figures"] == {"b": {}}
    assert "figures" not in left("figures=null")
    assert "tables" not in left("tables=null")
    assert left("estimators.W=null")["estimators"] == {}
    assert left("cases.noise.std=null")["cases"] == {"N": [1]}
    # What has no name of its own is set to null.
    assert left("estimators.W.known_point=null")["estimators"]["W"]["known_point"] is None
    assert left("noise=null")["noise"] is None
    assert data["figures"] == {"wide": {}, "b": {}}
    with pytest.raises(ConfigError) as caught:
        left("figures.wider=null")
    assert str(caught.value) == "--set figures.wider=null: figures.wider: " + (
        "there is no figure 'wider'; did you mean 'wide'? (there are: wide, b)"
    )
    with pytest.raises(
        ConfigError, match=r"^--set tables\.a=null: tables\.a: there is no table 'a' \(there is"
    ):
        left("tables.a=null")


def test_problems_are_shown_once_in_the_order_of_their_lines():
    problems = [
        Problem(("system", "linear", "a", 1), "is wrong", 0.1),
        Problem(("seed",), "must be text", True),
        Problem((), "is odd"),
        Problem(("seed",), "must be text", True),
    ]
    assert str(document().error(problems)).splitlines() == [
        "f:1: seed: must be text (got true)",
        "f:1: file: is odd",
        "f:4: system.linear.a[1]: is wrong (got 0.1)",
    ]


def test_spelled():
    assert spelled(("cases", "samples", 2, "a.b")) == "cases.samples[2].a.b"
    assert spelled(()) == ""


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "null"),
        (True, "true"),
        (math.nan, ".nan"),
        (-math.inf, "-.inf"),
        ([1, "a", [None]], "[1, 'a', [null]]"),
        ({"a": 1}, "a mapping"),
        (1e-3, "0.001"),
    ],
)
def test_shown(value, text):
    assert shown(value) == text


@pytest.mark.parametrize(
    ("message", "value", "got"),
    [
        ("must be text", None, " (got null)"),
        ("must be text", {"a": 1}, " (got a mapping)"),
        ("must be text", "a" * 100, f" (got '{'a' * 76}...)"),
        ("give exactly one", {"a": 1}, ""),
        ("is required: the seed", {}, ""),
        ("unknown key (allowed: a)", 3, ""),
        ("cannot read the formula '2*'", "2*", ""),
    ],
)
def test_the_value_is_shown_where_it_helps(message, value, got):
    assert str(document().error([Problem(("seed",), message, value)])) == f"f:1: seed: {message}{got}"
