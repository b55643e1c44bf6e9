"""What every component owes: it explains itself, and it survives being written down and sent away."""

from __future__ import annotations

import doctest
import inspect
import json
import pickle
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args

from pydantic import ValidationError

from hident.config.describe import fields
from hident.config.load import problems_of
from hident.config.meanings import meanings
from hident.config.spec import Component, Of, Spec, canonical, components, own_docstring
from hident.estimators.base import EstimatorSpec
from hident.estimators.nonparametric.bases import BasisSpec
from hident.estimators.prediction_error.block_specs import BlockSpec
from hident.metrics.base import MetricSpec
from hident.reports.base import FigureSpec, TableSpec
from hident.signals.base import ExcitationSpec, NoiseSpec
from hident.signals.streams import StreamsSpec
from hident.systems.base import NonlinearitySpec, SystemSpec
from hident.systems.linear import LinearSpec
from hident.testing.base import Contract, must

BASES: dict[str, type[Component]] = {
    "estimator": EstimatorSpec,
    "system": SystemSpec,
    "linear": LinearSpec,
    "nonlinearity": NonlinearitySpec,
    "excitation": ExcitationSpec,
    "noise": NoiseSpec,
    "streams": StreamsSpec,
    "metric": MetricSpec,
    "basis": BasisSpec,
    "block": BlockSpec,
    "table": TableSpec,
    "figure": FigureSpec,
}
"""What a component of each family descends from."""
_LONGEST = 100


@dataclass(frozen=True)
class ClassContract(Contract):
    """What a class of components owes by its registration alone."""

    component: type[Component]

    def is_registered(self) -> None:
        cls = self.component
        family = getattr(cls, "family", None)
        must(family in BASES, f"{cls.__name__} has no family: put @component(family, kind) above the class")
        must(components(cls.family).get(cls.kind) is cls, f"another class is the {family} '{cls.kind}'")

    def descends_from_the_base_of_its_family(self) -> None:
        base = BASES[self.component.family]
        must(issubclass(self.component, base), f"{self.component.__name__} must descend from {base.__name__}")

    def says_in_one_line_what_it_is(self) -> None:
        summary = self.component.summary()
        must(
            summary.endswith(".") and 10 <= len(summary) <= _LONGEST,
            f"the first line of the docstring must be a sentence of 10 to {_LONGEST} characters that ends "
            f"with a full stop, not {summary!r}",
        )

    def documents_its_fields(self) -> None:
        for spec in _with_nested(self.component):
            for name in spec.model_fields:
                meaning = meanings(spec).get(name, "")
                must(
                    meaning.endswith((".", ")", "]")),
                    f"{spec.__name__}.{name}: a text must stand under the field, a sentence that ends with a "
                    f"full stop, not {meaning!r}",
                )

    def can_be_described(self) -> None:
        for path, holds, default, meaning in fields(self.component):
            must(
                path and meaning and (holds or (not default and ", " in path)),
                f"{path or 'a field'} cannot be described: {holds!r}, {default!r}, {meaning!r}",
            )

    def stands_in_the_schema(self) -> None:
        schema = json.loads(json.dumps(self.component.model_json_schema()))
        must(
            schema["description"] == own_docstring(self.component),
            "the description in the JSON schema is not the docstring",
        )
        undescribed = [name for name, one in schema["properties"].items() if "description" not in one]
        must(not undescribed, f"the JSON schema does not describe {undescribed}")

    def is_frozen_and_strict(self) -> None:
        for spec in _with_nested(self.component):
            must(
                spec.model_config.get("frozen") and spec.model_config.get("extra") == "forbid",
                f"{spec.__name__} must be frozen and forbid other keys: leave model_config as it is",
            )

    def refuses_an_unknown_key_with_the_nearest_name(self) -> None:
        cls = self.component
        name = next(iter(cls.model_fields), None)
        typo = f"{name}_" if name else "anything"
        near = f"; did you mean '{name}'?" if name else ""
        expected = f"unknown key{near} (allowed: {', '.join(cls.model_fields) or 'none'})"
        said = _refusal(cls, {"kind": cls.kind, typo: 1}).get((typo,))
        must(said == expected, f"of the unknown key '{typo}' it says {said!r}, not {expected!r}")

    def refuses_what_is_no_mapping(self) -> None:
        for wrong in (3, [self.component.kind], None, True):
            said = _refusal(self.component, wrong).values()
            must(
                any("must be a mapping with 'kind:'" in text for text in said),
                f"of {wrong!r} in its place it says {[*said]}",
            )


@dataclass(frozen=True)
class ExampleContract(Contract):
    """What a docstring owes: its example runs."""

    component: type[Component]

    def has_an_example_that_runs_if_it_has_one(self) -> None:
        said: list[str] = []
        names = vars(sys.modules[self.component.__module__])
        runner = doctest.DocTestRunner(verbose=False)
        for test in doctest.DocTestFinder().find(self.component, globs=dict(names)):
            runner.run(test, out=said.append)
        must(not said, "".join(said))


@dataclass(frozen=True)
class SettingContract(Contract):
    """What a component with given settings owes: files, stores and workers get it as it is."""

    component: Component

    def survives_pickling(self) -> None:
        must(pickle.loads(pickle.dumps(self.component)) == self.component, "a pickled copy is another")

    def survives_its_written_form(self) -> None:
        spec = self.component
        written = canonical(spec)
        for form in (written, json.loads(json.dumps(written))):
            must(Of(spec.family).validate(form) == spec, f"what is read from {form} is another")


def _refusal(cls: type[Component], wrong: Any) -> dict[tuple[str | int, ...], str]:
    """What is said of something that cannot be made a component of the family."""
    try:
        Of(cls.family).validate(wrong)
    except ValidationError as error:
        return {problem.location: problem.message for problem in problems_of(error)}
    raise AssertionError(f"the {cls.family} '{cls.kind}' accepts {wrong!r}")


def _with_nested(spec: type[Spec]) -> Iterator[type[Spec]]:
    """The class and the plain specs that its fields hold, however deep."""
    yield spec
    for one in spec.model_fields.values():
        pending: list[Any] = [one.annotation]
        while pending:
            annotation = pending.pop()
            if inspect.isclass(annotation) and issubclass(annotation, Spec):
                if not issubclass(annotation, Component):
                    yield from _with_nested(annotation)
            else:
                pending += get_args(annotation)
