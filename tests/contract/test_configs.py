"""Every file under configs/ is sound, for hident and for an editor that knows the JSON Schema."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hident import plugins
from hident.config.load import read
from hident.engine.experiment import load
from hident.errors import RecordAbsent

ROOT = Path(__file__).parents[2]
CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))
FIRST_LINE = "# yaml-language-server: $schema=../docs/config.schema.json"
TYPES: dict[str, Any] = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "null": type(None),
    "integer": int,
    "number": int | float,
}
# Pydantic writes a discriminator beside "oneOf", which says the same.
ANNOTATIONS = {"$defs", "$schema", "title", "description", "default", "discriminator"}


def complaints(value, rule, definitions, at="file"):
    """What a value breaks of a JSON Schema; a keyword that is not known here is an error."""
    mapping, items = value if isinstance(value, dict) else {}, value if isinstance(value, list) else []
    number, text = value if isinstance(value, int | float) else math.nan, str(value)
    for word, wanted in rule.items():
        broken = False
        match word:
            case "$ref":
                yield from complaints(value, definitions[wanted.removeprefix("#/$defs/")], definitions, at)
            case "anyOf":
                broken = all(any(complaints(value, option, definitions, at)) for option in wanted)
            case "oneOf":
                broken = sum(not any(complaints(value, option, definitions, at)) for option in wanted) != 1
            case "type":
                kind = TYPES[wanted]
                broken = not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool)
            case "const":
                broken = value != wanted
            case "enum":
                broken = value not in wanted
            case "required":
                broken = not set(wanted) <= set(mapping)
            case "properties":
                for key in mapping.keys() & wanted.keys():
                    yield from complaints(mapping[key], wanted[key], definitions, f"{at}.{key}")
            case "additionalProperties":
                others = mapping.keys() - rule.get("properties", {}).keys()
                broken = wanted is False and bool(others)
                for key in others if isinstance(wanted, dict) else ():
                    yield from complaints(mapping[key], wanted, definitions, f"{at}.{key}")
            case "items" | "prefixItems":
                rules = [wanted] * len(items) if word == "items" else wanted
                for i, (item, inner) in enumerate(zip(items, rules, strict=False)):
                    yield from complaints(item, inner, definitions, f"{at}[{i}]")
            case "minProperties":
                broken = isinstance(value, dict) and len(value) < wanted
            case "pattern" | "minLength":
                short = len(text) < wanted if word == "minLength" else not re.search(wanted, text)
                broken = isinstance(value, str) and short
            case "minItems":
                broken = isinstance(value, list) and len(items) < wanted
            case "maxItems":
                broken = len(items) > wanted
            case "minimum":
                broken = number < wanted
            case "maximum":
                broken = number > wanted
            case "exclusiveMinimum":
                broken = number <= wanted
            case "exclusiveMaximum":
                broken = number >= wanted
            case _:
                assert word in ANNOTATIONS, f"unknown keyword {word}"
        if broken:
            yield f"{at}: {word}"


@pytest.fixture(scope="module")
def printed():
    """What ``hident schema`` prints, in a process where no test has registered components."""
    command = [sys.executable, "-m", "hident", "schema"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def current(printed):
    return json.loads(printed)


def test_there_are_configurations():
    assert CONFIGS


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
class TestEveryConfiguration:
    def test_tells_the_editor_its_schema(self, path):
        assert path.read_text(encoding="utf-8").splitlines()[0] == FIRST_LINE
        assert (path.parent / FIRST_LINE.partition("=")[2]).is_file()

    def test_is_sound(self, path):
        plugins.load()
        try:
            plan = load(path)
        except RecordAbsent as absent:
            pytest.skip(str(absent))
        assert plan.units
        assert plan.paper is None or plan.paper.is_dir()

    def test_fits_the_json_schema(self, path, current):
        assert not list(complaints(read(path).data, current, current["$defs"]))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"version": 2}, "file.version: const"),
        ({"titel": "T"}, "file: additionalProperties"),
        ({"trials": 0}, "file.trials: oneOf"),
        ({"trials": {"until": {"most": 9}}}, "file.trials: oneOf"),
        ({"samples": "many"}, "file.samples: anyOf"),
        ({"system": "hammerstien"}, "file.system: anyOf"),
        ({"metrics": {"a": {"kind": "error", "off": ["a_1"]}}}, "file.metrics.a: anyOf"),
        ({"cases": {"samples": 5}}, "file.cases.samples: anyOf"),
        ({"dt": [1]}, "file.dt: anyOf"),
        ({"streams": {"kind": "numpy", "fixed": ["imput"]}}, "file.streams: anyOf"),
    ],
)
def test_the_json_schema_finds_what_is_wrong(current, change, complaint):
    data = {**read(ROOT / "configs" / "mzyk_table1.yaml").data, **change}
    assert list(complaints(data, current, current["$defs"])) == [complaint]


@pytest.mark.parametrize(
    ("validation", "found"),
    [
        ("701..1000", []),
        ("uVal,yVal", []),
        ("other.csv", []),
        (["uVal", 4], []),
        ({"samples": "701..1000"}, []),
        (["uVal"], ["file.record: anyOf"]),
        (701, ["file.record: anyOf"]),
        ({"sample": "701..1000"}, ["file.record: anyOf"]),
    ],
)
def test_the_json_schema_knows_all_that_a_validation_part_may_be(current, validation, found):
    data = read(ROOT / "configs" / "data_example.yaml").data
    data["record"]["validation"] = validation
    assert list(complaints(data, current, current["$defs"])) == found


def test_the_stored_json_schema_is_current(printed):
    stored = (ROOT / "docs" / "config.schema.json").read_text(encoding="utf-8")
    assert stored == printed, "run: hident schema > docs/config.schema.json"


def test_the_json_schema_documents_the_fields(current):
    assert current["properties"]["seed"]["description"] == "Seed of all random streams."
    assert (
        current["$defs"]["Bandwidth"]["properties"]["h0"]["description"]
        == "Factor, in the unit of the input."
    )


def test_validating_loads_no_library_that_is_slow_to_import():
    program = (
        "import sys; from hident.commands.plans import load_plans; from pathlib import Path;"
        "load_plans([Path('configs/mzyk_table1.yaml')], None, {}, ());"
        "print(sorted({name.split('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    loaded = set(json.loads(done.stdout.replace("'", '"')))
    assert "numpy" in loaded
    assert not loaded & {"scipy", "pandas", "matplotlib", "finufft", "threadpoolctl", "rich", "pyarrow"}
