"""Components and configurations in words: the verbs list and schema."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from hident import plugins
from hident.commands.plans import described, load_plans
from hident.commands.showing import print_columns
from hident.config.reference import markdown
from hident.config.schema import json_schema
from hident.config.spec import PLURALS, components
from hident.config.suggest import did_you_mean, one_of
from hident.engine.cases import DATA
from hident.engine.experiment import Experiment
from hident.errors import ConfigError


def print_listing(families: Sequence[str], plugin_files: Iterable[Path]) -> None:
    """One line for each component of the families; a heading for each where there are several."""
    plugins.load(plugin_files)
    several = len(families) > 1
    for family in families:
        lines = list(_config_titles()) if family == "configs" else _summaries(family)
        if several:
            print(f"{family}:")
        width = max((len(name) for name, _ in lines), default=0)
        for name, text in lines:
            print(f"{'  ' * several}{name:<{width}}  {text}")


def _summaries(family: str) -> list[tuple[str, str]]:
    return [(kind, cls.summary()) for kind, cls in components(PLURALS[family]).items()]


def _config_titles() -> Iterator[tuple[str, str]]:
    from hident.config.load import read

    for path in sorted(Path("configs").glob("*.yaml")):
        try:
            yield path.stem, str(read(path).data.get("title", ""))
        except ConfigError as error:
            yield path.stem, f"({error})"


def print_component(family: str, kind: str, plugin_files: Iterable[Path]) -> None:
    """A component's description, source and fields."""
    from hident.config.describe import fields

    plugins.load(plugin_files)
    known = components(PLURALS[family])
    if kind not in known:
        near = did_you_mean(kind, known)
        raise ConfigError(f"no {PLURALS[family]} is named '{kind}'{near} (there are: {one_of(known)})")
    cls = known[kind]
    print(f"{kind}: {cls.summary()}")
    if cls.source:
        print(f"source: {cls.source}")
    if rows := list(fields(cls)):
        print()
        print_columns([("key", "holds", "default", "meaning"), *rows])


def print_config(config: Path, plugin_files: Iterable[Path]) -> None:
    """A configuration's title, path, cases and estimators."""
    [plan] = load_plans([config], plugin_files=plugin_files)
    print(f"{plan.name}: {plan.experiment.title}")
    print(described(plan))
    cases = [(axis.name, one_of(map(str, axis.labels))) for axis in plan.axes]
    estimators = [(name, spec.summary()) for name, spec in plan.experiment.estimators.items()]
    for header, rows in ((("case", "labels"), cases), (("estimator", "what it is"), estimators)):
        if rows:
            print()
            print_columns([header, *rows])


def schema(plugin_files: Iterable[Path], *, unicode: bool = True) -> str:
    """The JSON Schema of configurations, in ASCII alone if it is to be."""
    plugins.load(plugin_files)
    return json.dumps(json_schema(Experiment, DATA), indent=2, ensure_ascii=not unicode)


def reference(plugin_files: Iterable[Path]) -> str:
    """All keys of configurations in Markdown, those of every component under its kind."""
    plugins.load(plugin_files)
    return markdown(Experiment)
