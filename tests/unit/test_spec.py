import json
import pickle
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, ValidationError, field_validator, model_validator

from hident.config.describe import fields
from hident.config.load import problems_of
from hident.config.meanings import meanings
from hident.config.schema import json_schema
from hident.config.spec import (
    PLURALS,
    Component,
    Count,
    Flag,
    Of,
    Real,
    Spec,
    canonical,
    component,
    components,
)
from hident.config.suggest import did_you_mean, one_of
from hident.config.yaml12 import spelled


class Inner(Spec):
    """What is inside."""

    width: Annotated[Real, Field(gt=0)] = 1.0
    """Width, in metres."""
    pair: tuple[Real, Real] = (0.0, 1.0)


class Slider(Spec):
    """What tries several."""

    instead = {"gap": "'gaps' tries several"}

    gap: Annotated[Real, Field(ge=0, lt=1)] | None = None
    """The gap."""
    size: Annotated[Count, Field(ge=1)] = 1
    """The size."""
    rows: Annotated[tuple[Inner, ...], Field(min_length=1)] = (Inner(),)
    """Rows."""
    grid: Annotated[tuple[Annotated[tuple[Real, ...], Field(min_length=2)], ...], Field(min_length=2)] = ()
    """Numbers."""


class Other(Spec):
    """The other thing."""

    name: str
    """Its name."""

    class Nested(Spec):
        """A class within."""

        depth: Count
        """Depth."""


class Outer(Spec):
    """All kinds of fields."""

    number: Count
    """How many.

    In all.
    """
    colour: Literal["red", "green"] = "red"
    """The colour."""
    on: Flag = False
    """Whether it is on."""
    inner: Inner = Inner()
    """What it holds."""
    several: tuple[Inner, ...] = ()
    """More of them."""
    either: Inner | Other | Literal["none"] = "none"
    """One of three."""
    texts: Annotated[tuple[str, ...], Field(min_length=1)] = ("a",)
    """Texts."""
    table: dict[str, Count] = {}
    """By name."""
    nonlinearity: Annotated[Any, Of("nonlinearity")] | None = None
    """A component."""
    list_of: tuple[Annotated[Any, Of("nonlinearity")], ...] = ()
    """Components."""


@pytest.fixture(autouse=True)
def _register(monkeypatch):
    """A register of its own, so that no test sees what another one registers."""
    register: dict[str, dict[str, type[Component]]] = {}
    monkeypatch.setattr("hident.config.spec._REGISTER", register)

    @component("nonlinearity", "line", source="Someone 2001")
    class Line(Component):
        """A straight line.

        And more about it.
        """

        slope: Real = 1.0
        """Slope."""

    @component("nonlinearity", "knot")
    class Knot(Component):
        """A knot."""

        of: Annotated[Any, Of("nonlinearity")]
        """What is tied."""

        @field_validator("of")
        @classmethod
        def _no_knot(cls, of: Any) -> Any:
            if of.kind == "knot":
                raise ValueError("a knot cannot be tied of knots")
            return of


def complaints(**data):
    with pytest.raises(ValidationError) as caught:
        Outer.model_validate(data)
    return [f"{spelled(problem.location)}: {problem.message}" for problem in problems_of(caught.value)]


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (
            {"rows": [{"wdth": 1}]},
            ["rows[0].wdth: unknown key; did you mean 'width'? (allowed: width, pair)"],
        ),
        ({"rows": [{"width": 0}, {}]}, ["rows[0].width: must be greater than 0"]),
        ({"rows": []}, ["rows: must be a list of at least 1"]),
        (
            {"grid": [[1, True], [1, 2]]},
            ["grid[0][1]: must be a number, or a formula such as '2*pi' or '1/5'"],
        ),
        ({"grid": [[1], [1, 2]]}, ["grid[0]: must be a list of at least 2"]),
        (
            {"grid": [[1, True]]},
            [
                "grid: must be a list of at least 2",
                "grid[0][1]: must be a number, or a formula such as '2*pi' or '1/5'",
            ],
        ),
    ],
)
def test_a_list_with_a_wrong_item_is_not_too_short(data, expected):
    with pytest.raises(ValidationError) as caught:
        Slider.model_validate(data)
    assert sorted(f"{spelled(p.location)}: {p.message}" for p in problems_of(caught.value)) == expected


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (
            {"gap": "search"},
            "gap: must be a number >= 0, < 1, or a formula such as '2*pi' or '1/5'; 'gaps' tries several",
        ),
        ({"gap": [1]}, "gap: must be a number >= 0, < 1, or a formula such as '2*pi' or '1/5'"),
        ({"gap": "2*x"}, "gap: unknown name 'x' in the formula '2*x' (allowed: pi, e and the functions "),
        ({"size": "auto"}, "size: must be a whole number >= 1"),
        (
            {"grid": [["a b", 1], [1, 2]]},
            "grid[0][0]: must be a number, or a formula such as '2*pi' or '1/5'",
        ),
    ],
)
def test_a_word_where_a_number_belongs(data, expected):
    with pytest.raises(ValidationError) as caught:
        Slider.model_validate(data)
    [problem] = problems_of(caught.value)
    assert f"{spelled(problem.location)}: {problem.message}".startswith(expected)


ALLOWED = "allowed: number, colour, on, inner, several, either, texts, table, nonlinearity, list_of"


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ({}, "number: is required: How many.\n\nIn all"),
        ({"numbr": 1, "number": 1}, f"numbr: unknown key; did you mean 'number'? ({ALLOWED})"),
        ({"xyz": 1, "number": 1}, f"xyz: unknown key ({ALLOWED})"),
        *(({"number": n}, "number: must be a whole number") for n in (True, 1.0, "1", None, [1])),
        ({"number": 2**63}, "number: must be below 2^63"),
        ({"number": 1, "colour": "gren"}, "colour: must be 'red' or 'green'; did you mean 'green'?"),
        ({"number": 1, "colour": 3}, "colour: must be 'red' or 'green'"),
        *(({"number": 1, "on": on}, "on: must be true or false") for on in (1, "no", None)),
        ({"number": 1, "inner": 3}, "inner: must be a mapping of keys to values"),
        (
            {"number": 1, "inner": {"wdth": 3}},
            "inner.wdth: unknown key; did you mean 'width'? (allowed: width, pair)",
        ),
        ({"number": 1, "inner": {"width": 0}}, "inner.width: must be greater than 0"),
        ({"number": 1, "inner": {"width": float("nan")}}, "inner.width: must be a finite number"),
        ({"number": 1, "inner": {"width": float("inf")}}, "inner.width: must be a finite number"),
        *(
            (
                {"number": 1, "inner": {"width": width}},
                "inner.width: must be a number > 0, or a formula such as '2*pi' or '1/5'",
            )
            for width in (True, None, [1], {"a": 1})
        ),
        (
            {"number": 1, "inner": {"width": "1/0"}},
            "inner.width: the formula '1/0' gives inf, not a finite number",
        ),
        ({"number": 1, "inner": {"pair": [1]}}, "inner.pair: must be a list of at least 2"),
        ({"number": 1, "inner": {"pair": [1, 2, 3]}}, "inner.pair: must be a list of at most 2"),
        ({"number": 1, "inner": {"pair": 1}}, "inner.pair: must be a list"),
        ({"number": 1, "several": [{}, {"width": -1}]}, "several[1].width: must be greater than 0"),
        ({"number": 1, "several": {}}, "several: must be a list"),
        ({"number": 1, "texts": []}, "texts: must be a list of at least 1"),
        ({"number": 1, "texts": ["a", 1]}, "texts[1]: must be text"),
        ({"number": 1, "texts": [["a"]]}, "texts[0]: must be one text, not a list"),
        ({"number": 1, "table": 3}, "table: must be a mapping of keys to values"),
        ({"number": 1, "table": {"a b": "c"}}, "table.a b: must be a whole number"),
        (
            {"number": 1, "nonlinearity": "lime"},
            "nonlinearity: unknown nonlinearity; did you mean 'line'? (allowed: knot, line)",
        ),
        (
            {"number": 1, "nonlinearity": {"kind": "lime"}},
            "nonlinearity.kind: unknown nonlinearity; did you mean 'line'? (allowed: knot, line)",
        ),
        (
            {"number": 1, "nonlinearity": {"kind": 3}},
            "nonlinearity.kind: unknown nonlinearity (allowed: knot, line)",
        ),
        (
            {"number": 1, "nonlinearity": {"slope": 3}},
            "nonlinearity.kind: is required: the nonlinearity (allowed: knot, line)",
        ),
        (
            {"number": 1, "nonlinearity": 3},
            "nonlinearity: must be a mapping with 'kind:' (allowed: knot, line)",
        ),
        (
            {"number": 1, "list_of": ["line", {"kind": "line", "slop": 1}]},
            "list_of[1].slop: unknown key; did you mean 'slope'? (allowed: slope)",
        ),
        (
            {"number": 1, "nonlinearity": {"kind": "knot", "of": {"kind": "knot", "of": "line"}}},
            "nonlinearity.of: a knot cannot be tied of knots",
        ),
        ({"number": 1, "nonlinearity": "knot"}, "nonlinearity.of: is required: What is tied"),
    ],
)
def test_messages(data, expected):
    assert complaints(**data) == [expected]


def test_every_branch_of_a_union_speaks_at_the_key_that_the_user_wrote():
    assert complaints(number=1, either=3) == [
        "either: must be a mapping of keys to values",
        "either: must be a mapping of keys to values",
        "either: must be 'none'",
    ]
    assert complaints(number=1, either={"width": 0}) == [
        "either.width: must be greater than 0",
        "either.name: is required: Its name",
        "either.width: unknown key (allowed: name)",
        "either: must be 'none'",
    ]


def test_all_problems_are_found_at_once():
    assert [line.partition(":")[0] for line in complaints(colour=1, on=2, inner={"width": -1, "w": 1})] == [
        "number",
        "colour",
        "on",
        "inner.width",
        "inner.w",
    ]


def test_a_list_given_as_a_single_mapping_has_no_index_in_its_key_path():
    class Single(Spec):
        inner: tuple[Inner, ...]

        @field_validator("inner", mode="before")
        @classmethod
        def _listed(cls, value):
            return [value] if isinstance(value, dict) else value

    with pytest.raises(ValidationError) as caught:
        Single.model_validate({"inner": {"width": -1}})
    assert [spelled(problem.location) for problem in problems_of(caught.value)] == ["inner.width"]


def test_a_message_about_the_whole_stands_at_the_whole():
    class Whole(Spec):
        a: Real = 1.0
        b: Real = 1.0

        @model_validator(mode="after")
        def _one(self):
            raise ValueError("give exactly one of {a} and {b}")

    with pytest.raises(ValidationError) as caught:
        Whole.model_validate({"a": 1})
    (problem,) = problems_of(caught.value)
    assert (problem.location, problem.message) == ((), "give exactly one of {a} and {b}")


def test_reals_accept_formulas_and_give_floats():
    inner = Inner.model_validate({"width": "2*pi", "pair": [1, "-1/4"]})
    assert inner.width == pytest.approx(6.283185307179586)
    assert inner.pair == (1.0, -0.25)
    assert all(isinstance(value, float) for value in inner.pair)


def test_specs_are_frozen_and_can_be_compared_and_pickled():
    outer = Outer.model_validate({"number": 3, "inner": {"width": 2}})
    with pytest.raises(ValidationError, match="frozen"):
        outer.number = 4  # type: ignore[misc]
    assert pickle.loads(pickle.dumps(outer)) == outer
    assert Outer.model_validate(outer) == outer


def test_a_bare_name_stands_for_a_component():
    line = Of("nonlinearity").validate("line")
    assert line == Of("nonlinearity").validate({"kind": "line"})
    assert Of("nonlinearity").validate(line) is line
    assert (line.family, line.kind, line.source, line.summary()) == (
        "nonlinearity",
        "line",
        "Someone 2001",
        "A straight line.",
    )


def test_the_register_refuses_a_taken_name_and_an_unknown_family():
    with pytest.raises(ValueError, match=f"^nonlinearity 'line' is already defined in {__name__}$"):

        @component("nonlinearity", "line")
        class Another(Component):
            """Another line."""

    with pytest.raises(ValueError, match="unknown family 'estimater'; did you mean 'estimator'"):
        component("estimater", "a")  # type: ignore[arg-type]


def test_a_component_does_not_inherit_its_summary():
    class Plain(Component):
        pass

    assert Plain.summary() == ""


def test_the_register_is_sorted():
    assert list(components("nonlinearity")) == ["knot", "line"]
    assert components("basis") == {}


def test_the_canonical_form_names_kinds_and_leaves_defaults_out():
    plain = {"number": 3, "inner": {"width": "2*2"}, "nonlinearity": {"kind": "line", "slope": 1.0}}
    spec = Outer.model_validate({**plain, "colour": "red", "several": [{}], "table": {"b": 1, "a": 2}})
    assert canonical(spec) == {
        "number": 3,
        "inner": {"width": 4.0},
        "nonlinearity": {"kind": "line"},
        "several": [{}],
        "table": {"b": 1, "a": 2},
    }
    assert json.loads(json.dumps(canonical(spec))) == canonical(spec)
    assert canonical(Outer.model_validate(canonical(spec))) == canonical(spec)


def test_meanings_are_the_texts_under_the_fields():
    assert meanings(Inner) == {"width": "Width, in metres."}
    assert meanings(Other.Nested) == {"depth": "Depth."}
    assert meanings(components("nonlinearity")["line"]) == {"slope": "Slope."}
    assert meanings(Outer)["number"] == "How many.\n\nIn all."


def test_meanings_of_a_base_are_inherited_and_can_be_overridden():
    class Narrow(Inner):
        width: Real = 2.0
        """Width, narrower."""
        extra: Real = 1.0
        """Something more."""

    assert meanings(Narrow) == {"width": "Width, narrower.", "extra": "Something more."}


def test_a_class_without_source_has_no_meanings():
    space = {"Spec": Spec, "__name__": "nowhere"}
    exec("class Prompt(Spec):\n    a: int = 1\n    'One.'", space)
    assert meanings(space["Prompt"]) == {}


def test_fields_in_words():
    rows = {path: rest for path, *rest in fields(Outer)}
    assert rows == {
        "number": ["whole number", "required", "How many.\n\nIn all."],
        "colour": ["red | green", "red", "The colour."],
        "on": ["true or false", "false", "Whether it is on."],
        "inner": ["mapping", "mapping", "What it holds. What is inside."],
        "inner.width": ["number > 0", "1.0", "Width, in metres."],
        "inner.pair": ["[number, number]", "[0.0, 1.0]", ""],
        "several": ["list of mapping", "[]", "More of them. What is inside."],
        "several[].width": ["number > 0", "1.0", "Width, in metres."],
        "several[].pair": ["[number, number]", "[0.0, 1.0]", ""],
        "either": ["mapping or none", "none", "One of three."],
        "either, either": ["", "", "What is inside."],
        "either.width": ["number > 0", "1.0", "Width, in metres."],
        "either.pair": ["[number, number]", "[0.0, 1.0]", ""],
        "either, or": ["", "", "The other thing."],
        "either.name": ["text", "required", "Its name."],
        "texts": ["list of text", "[a]", "Texts."],
        "table": ["mapping to whole number", "{}", "By name."],
        "nonlinearity": ["nonlinearity", "none", "A component."],
        "list_of": ["list of nonlinearity", "[]", "Components."],
    }


def test_json_schema_links_families_and_documents_fields():
    schema = json_schema(Outer)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert schema["additionalProperties"] is False
    assert schema["required"] == ["number"]
    assert schema["properties"]["list_of"]["items"] == {"$ref": "#/$defs/nonlinearity"}
    assert schema["properties"]["number"]["description"] == "How many.\n\nIn all."
    assert schema["$defs"]["Inner"]["properties"]["width"]["anyOf"] == [
        {"type": "number"},
        {"type": "string"},
    ]
    assert schema["$defs"]["Inner"]["properties"]["width"]["description"] == "Width, in metres."
    knot, line, bare = schema["$defs"]["nonlinearity"]["anyOf"]
    assert knot["properties"]["kind"] == {"const": "knot"}
    assert knot["required"] == ["kind", "of"]
    assert line["required"] == ["kind"]
    assert bare == {"const": "line"}
    assert set(PLURALS.values()) <= set(schema["$defs"])


def test_nearest_names():
    assert did_you_mean("Kernal", ["kernel", "orthogonal"]) == "; did you mean 'kernel'?"
    assert did_you_mean("kernel", ["KERNEL"]) == "; did you mean 'KERNEL'?"
    assert did_you_mean("zzz", ["kernel"]) == ""
    assert did_you_mean("a" * 10**7, ["a" * 10**7]) == ""
    assert one_of(["a", "b"]) == "a, b"
