"""A fitted model as a file: JSON that people and other programs read, and that keeps every bit.

    {
      "hident_model": 1,
      "structure": "N-L",
      "dt": 4.0,
      "start": "settled",
      "blocks": [
        {"name": "N", "kind": "saturation", "low": -1.0, "high": 2.0, "coefficients": [0.0, 1.0], ...},
        {"name": "L", "kind": "transfer_function", "b": [0.0, 0.5], "a": [0.5], ...}
      ],
      "noise": {"ar": [], "ma": [], "variance": 0.01},
      "about": {"input": "valve", "units": {"input": "%", "output": "m", "time": "s"}, ...}
    }

Numbers are written with as many digits as give the same double again. A continuous block is of the kind
``continuous_transfer_function``, with ``b`` and ``a`` by rising power of s, ``delay``, and ``intersample``:
what its input is between the samples (``held`` or ``linear``). The ``functions`` of an ``expansion`` and the
basis of a ``series`` are written as in a configuration; they were fitted between ``low`` and ``high``. A
block also holds ``errors``, the standard errors of its numbers by name, and ``fitted_on``, the range of its
input in the fit. Where ``start`` is ``estimated``, ``begun`` holds for each experiment of the fit the SHA-256
of its samples, and the state of each linear block at the first of them (``zi`` of scipy.signal.lfilter, less
that settled to the first input).

``about`` may hold anything. What other parts of hident look for there is checked: ``input`` and ``output``
(names of columns), ``units`` (of ``input``, ``output`` and ``time``), ``offsets`` (what is taken off the
``input`` before the blocks, and off the ``output`` in the fit) and ``detrend`` (what was taken off the record
of the fit), ``data`` (the SHA-256 of each file), ``hident`` (version), ``command`` and ``method``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, PlainValidator, ValidationError

from hident.block_chain import Block, BlockChain, settled_state
from hident.config.load import Document, Problem, problems_of
from hident.config.spec import Count, NonEmpty, Of, Spec, canonical, plain
from hident.config.suggest import did_you_mean, one_of
from hident.config.yaml12 import Location
from hident.errors import ConfigError
from hident.fitted_model import Begun, FittedModel, NoiseModel
from hident.initial_states import state_sizes
from hident.linear_blocks import ContinuousTransferFunction, TransferFunction
from hident.new_files import replacing
from hident.sampled_blocks import Intersample, SampledTransferFunction
from hident.static_functions import (
    Chebyshev,
    CubicSpline,
    DeadZone,
    PiecewiseLinear,
    Saturation,
    StaticFunction,
)
from hident.systems.base import NonlinearitySpec, OfStatic
from hident.systems.function_basis import Functions, Series

VERSION = 1
LARGEST = 2**22
"""Bytes: some hundred thousand numbers."""
_DEEPEST = 20
_WIDTH = 100


def write_model(model: FittedModel, path: str | Path) -> None:
    """Write a model to a JSON file, which :func:`load_model` reads to the last bit.

    Standard errors that are no finite numbers are not known, and are left out.

    Raises
    ------
    ConfigError
        If the model holds what such a file cannot, such as a coefficient that is not finite.
    StoreError
        If the file cannot be written.

    Examples
    --------
    >>> import hident as hi
    >>> from hident.block_chain import BlockChain
    >>> hi.write_model(hi.FittedModel(BlockChain((hi.TransferFunction(b=(0.1,)),))), "gain.json")
    >>> hi.load_model("gain.json").chain.blocks[0].b
    (0.1,)
    """
    data = _encoded(model)
    _decoded(data, str(path))
    # A lone surrogate of a file's name has no place in UTF-8; its escape is JSON's own.
    content = f"{_text(data)}\n".encode("utf-8", "backslashreplace")
    with replacing(Path(path)) as new:
        new.write_bytes(content)


def load_model(path: str | Path) -> FittedModel:
    """The model of a JSON file that :func:`write_model` or ``hident identify`` wrote.

    Raises
    ------
    ConfigError
        With all that is wrong with the file: a key path, what is there and what is allowed.

    Examples
    --------
    >>> import numpy as np
    >>> import hident as hi
    >>> from hident.block_chain import BlockChain
    >>> hi.write_model(hi.FittedModel(BlockChain((hi.TransferFunction(b=(0.1,)),))), "gain.json")
    >>> hi.load_model("gain.json").simulate(np.array([1.0, 2.0]))
    array([0.1, 0.2])
    """
    return _decoded(_parsed(Path(path)), str(path))


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("must be a number")
    try:
        return float(value)
    except OverflowError:
        raise ValueError("must be a finite number") from None


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    if not interval[0] <= interval[1]:
        raise ValueError("must be [low, high] with low <= high")
    return interval


def _increasing(knots: tuple[float, ...]) -> tuple[float, ...]:
    for left, right in pairwise(knots):
        if not left < right:
            raise ValueError(f"must be in increasing order, and {right:g} stands behind {left:g}")
    return knots


def _version(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError(f"must be the number of a version of the format: {VERSION}")
    if value > VERSION:
        raise ValueError(
            f"was written by a later hident, as version {value} of the format; this one reads {VERSION}"
        )
    return value


_Number = Annotated[float, BeforeValidator(_number)]
_NotNegative = Annotated[_Number, Field(ge=0)]
_Numbers = tuple[_Number, ...]
_Knots = Annotated[tuple[_Number, ...], Field(min_length=2), AfterValidator(_increasing)]


class _Block(Spec):
    kind: ClassVar[str]
    name: str
    errors: dict[str, _NotNegative] | None = None
    fitted_on: Annotated[tuple[_Number, _Number], AfterValidator(_ordered)] | None = None

    def block(self, dt: float | None) -> Block:
        """The block for samples every ``dt``; ValueError if its numbers do not fit together."""
        raise NotImplementedError

    def numbers(self) -> Sequence[str]:
        """The names of the numbers that may have a standard error."""
        raise NotImplementedError


class _Linear(_Block):
    kind: ClassVar[str] = "transfer_function"
    b: NonEmpty[_Number]
    a: _Numbers

    def block(self, dt: float | None) -> TransferFunction:
        return TransferFunction(b=self.b, a=self.a)

    def numbers(self) -> Sequence[str]:
        return tuple(TransferFunction(b=self.b, a=self.a).values())


class _Continuous(_Block):
    kind: ClassVar[str] = "continuous_transfer_function"
    b: NonEmpty[_Number]
    a: NonEmpty[_Number]
    delay: _NotNegative
    intersample: Intersample

    def block(self, dt: float | None) -> SampledTransferFunction:
        if dt is None:
            raise ValueError("a continuous block needs the sampling interval 'dt' of the model")
        block = ContinuousTransferFunction(self.b, self.a, self.delay)
        return SampledTransferFunction(block, dt, self.intersample)

    def numbers(self) -> Sequence[str]:
        return (
            *(f"a_{i}" for i in range(1, len(self.a) + 1)),
            *(f"b_{i}" for i in range(len(self.b))),
        )


class _Static(_Block):
    coefficients: _Numbers

    def basis(self) -> Any:
        raise NotImplementedError

    def block(self, dt: float | None) -> StaticFunction:
        basis = self.basis()
        if len(self.coefficients) != basis.size:
            raise ValueError(
                f"coefficients must be {basis.size} numbers for this basis, not {len(self.coefficients)}"
            )
        return StaticFunction(basis, self.coefficients)

    def numbers(self) -> Sequence[str]:
        return tuple(f"c_{i}" for i in range(1, len(self.coefficients) + 1))


class _Ends(_Static):
    low: _Number
    high: _Number

    def _checked(self) -> tuple[float, float]:
        if not self.low < self.high:
            raise ValueError(f"low must be below high, not {self.low:g} and {self.high:g}")
        return self.low, self.high


class _Polynomial(_Ends):
    kind: ClassVar[str] = Chebyshev.kind
    degree: Annotated[Count, Field(ge=0)]

    def basis(self) -> Chebyshev:
        return Chebyshev(self.degree, *self._checked())


class _Corners(_Ends):
    def numbers(self) -> Sequence[str]:
        return ("low", "high", *super().numbers())


class _Saturation(_Corners):
    kind: ClassVar[str] = Saturation.kind

    def basis(self) -> Saturation:
        return Saturation(*self._checked())


class _DeadZone(_Corners):
    kind: ClassVar[str] = DeadZone.kind

    def basis(self) -> DeadZone:
        return DeadZone(*self._checked())


class _PiecewiseLinear(_Static):
    kind: ClassVar[str] = PiecewiseLinear.kind
    knots: _Knots

    def basis(self) -> PiecewiseLinear:
        return PiecewiseLinear(self.knots)


class _CubicSpline(_Static):
    kind: ClassVar[str] = CubicSpline.kind
    knots: _Knots

    def basis(self) -> CubicSpline:
        return CubicSpline(self.knots)


# JSON has no infinity: limits of functions are written as in a configuration.
_LIMITS = {".inf": math.inf, "-.inf": -math.inf}


def _with_limits(function: Any) -> Any:
    """A function as it is read, with the limits that JSON has as texts."""
    if not isinstance(function, Mapping):
        return function
    return {key: _LIMITS.get(item, item) if isinstance(item, str) else item for key, item in function.items()}


def _as_texts(function: Any) -> Any:
    """A function as it is written: :func:`_with_limits` the other way round."""
    names = {value: name for name, value in _LIMITS.items()}
    return {key: names.get(item, item) if isinstance(item, float) else item for key, item in function.items()}


class _Expansion(_Static):
    kind: ClassVar[str] = Functions.kind
    functions: NonEmpty[Annotated[NonlinearitySpec, OfStatic(), BeforeValidator(_with_limits)]]
    low: _Number
    high: _Number

    def basis(self) -> Functions:
        return Functions(self.functions, self.low, self.high)


class _Series(_Static):
    kind: ClassVar[str] = Series.kind
    series: Annotated[Any, Of("basis")]
    q: Annotated[Count, Field(ge=0)]
    low: _Number
    high: _Number

    def basis(self) -> Series:
        return Series(self.series, self.q, self.low, self.high)


_KINDS: dict[str, type[_Block]] = {
    cls.kind: cls
    for cls in (
        _Linear,
        _Continuous,
        _Polynomial,
        _PiecewiseLinear,
        _CubicSpline,
        _Saturation,
        _DeadZone,
        _Expansion,
        _Series,
    )
}


def _block(value: Any) -> _Block:
    if not isinstance(value, Mapping):
        raise ValueError("must be a mapping of keys to values")
    kind = value.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        near = did_you_mean(kind, _KINDS) if isinstance(kind, str) else ""
        said = f"has the unknown kind '{kind}'{near}" if isinstance(kind, str) else "must have a kind"
        raise ValueError(f"{said} (allowed: {one_of(_KINDS)})")
    return _KINDS[kind].model_validate({key: item for key, item in value.items() if key != "kind"})


class _Noise(Spec):
    ar: _Numbers
    ma: _Numbers
    variance: _NotNegative


class _Begun(Spec):
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    states: tuple[_Numbers, ...]


class _Units(Spec):
    input: str = ""
    output: str = ""
    time: str = ""


class _About(Spec):
    model_config = ConfigDict(extra="allow")

    input: str = ""
    output: str = ""
    units: _Units = _Units()
    offsets: dict[Literal["input", "output"], _Number] = {}
    detrend: str = ""
    data: dict[str, str] = {}
    hident: str = ""
    command: str = ""
    method: str = ""


class _Versioned(Spec):
    model_config = ConfigDict(extra="ignore")

    hident_model: Annotated[int, PlainValidator(_version)]
    """The version of the format."""


class _Model(Spec):
    hident_model: int
    structure: str
    dt: Annotated[_Number, Field(gt=0)] | None
    start: Literal["rest", "settled", "estimated"]
    begun: tuple[_Begun, ...] = ()
    blocks: NonEmpty[Annotated[_Block, PlainValidator(_block)]]
    noise: _Noise
    about: _About


def _encoded(model: FittedModel) -> dict[str, Any]:
    chain = model.chain
    blocks = []
    for i, (name, block) in enumerate(zip(chain.names, chain.blocks, strict=True)):
        entry = {"name": name, **_entry(block)}
        if model.errors:
            known = model.errors[i].items()
            entry["errors"] = {number: error for number, error in known if math.isfinite(error)}
        if model.ranges:
            entry["fitted_on"] = model.ranges[i]
        blocks.append(entry)
    noise = model.noise
    encoded = plain(
        {
            "hident_model": VERSION,
            "structure": chain.structure,
            "dt": chain.dt,
            "start": model.start,
            **({"begun": [vars(one) for one in model.begun]} if model.begun else {}),
            "blocks": blocks,
            "noise": {"ar": noise.ar, "ma": noise.ma, "variance": noise.variance},
            "about": model.about,
        }
    )
    assert isinstance(encoded, dict)
    return encoded


def _entry(block: Block) -> dict[str, Any]:
    if isinstance(block, SampledTransferFunction):
        continuous = block.continuous
        return {
            "kind": _Continuous.kind,
            "b": continuous.b,
            "a": continuous.a,
            "delay": continuous.delay,
            "intersample": block.intersample,
        }
    if isinstance(block, TransferFunction):
        return {"kind": _Linear.kind, "b": block.b, "a": block.a}
    basis: Any = block.basis
    if isinstance(basis, Functions):
        functions = [_as_texts(canonical(function)) for function in basis.functions]
        ends = {"low": basis.low, "high": basis.high}
        return {"kind": basis.kind, "functions": functions, **ends, "coefficients": block.coefficients}
    if isinstance(basis, Series):
        known = {"series": canonical(basis.basis), "q": basis.q, "low": basis.low, "high": basis.high}
        return {"kind": basis.kind, **known, "coefficients": block.coefficients}
    keys = [key for key in _KINDS[basis.kind].model_fields if key not in _Static.model_fields]
    return {
        "kind": basis.kind,
        **{key: getattr(basis, key) for key in keys},
        "coefficients": block.coefficients,
    }


def _decoded(data: Mapping[str, Any], name: str) -> FittedModel:
    document = Document(name, dict(data))
    try:
        _Versioned.model_validate(data)
        if unsound := list(_unsound(data)):
            raise document.error(unsound)
        read = _Model.model_validate(data)
    except ValidationError as error:
        raise document.error(problems_of(error)) from None
    if wrong := list(_misfits(read)):
        raise document.error(wrong)
    blocks = tuple(entry.block(read.dt) for entry in read.blocks)
    return FittedModel(
        BlockChain(blocks, read.dt),
        start=read.start,
        noise=NoiseModel(read.noise.ar, read.noise.ma, read.noise.variance),
        errors=_of_each([entry.errors for entry in read.blocks]),
        ranges=tuple(entry.fitted_on for entry in read.blocks if entry.fitted_on is not None),
        about=data["about"],
        begun=tuple(Begun(one.sha256, one.states) for one in read.begun),
    )


def _of_each(errors: Sequence[dict[str, float] | None]) -> tuple[dict[str, float], ...]:
    return () if all(known is None for known in errors) else tuple(known or {} for known in errors)


def _unsound(value: Any, location: Location = ()) -> Iterator[Problem]:
    """What JSON's readers or Python let through and no model holds, such as numbers that are not finite."""
    if len(location) > _DEEPEST:
        yield Problem(location[:1], f"must have no more than {_DEEPEST} lists and mappings in each other")
        return
    match value:
        case float() if not math.isfinite(value):
            yield Problem(location, "must be a finite number", value)
        case None | bool() | int() | float() | str():
            pass
        case Mapping():
            for key, item in value.items():
                if isinstance(key, str):
                    yield from _unsound(item, (*location, key))
                else:
                    yield Problem(location, f"must have keys that are text, not {key!r}")
        case list():
            for i, item in enumerate(value):
                yield from _unsound(item, (*location, i))
        case _:
            yield Problem(
                location, f"must be text, a number, a list or a mapping, not {type(value).__name__}"
            )


def _misfits(read: _Model) -> Iterator[Problem]:
    """What is wrong between keys that are sound by themselves."""
    blocks: list[Block] = []
    for i, entry in enumerate(read.blocks):
        try:
            blocks.append(entry.block(read.dt))
        except ValueError as error:
            yield Problem(("blocks", i), str(error))
            continue
        for number in entry.errors or ():
            if number not in (known := entry.numbers()):
                near = did_you_mean(number, known)
                yield Problem(
                    ("blocks", i, "errors", number), f"unknown key{near} (allowed: {one_of(known)})"
                )
        if isinstance(block := blocks[-1], TransferFunction) and read.start != "rest":
            try:
                with np.errstate(all="ignore"):
                    settled_state(np.asarray(block.b), block.denominator)
            except ValueError as error:
                yield Problem(("blocks", i), f'{error} ("start": "rest")')
    if len(blocks) < len(read.blocks):
        return
    chain = BlockChain(tuple(blocks))
    if read.structure != chain.structure:
        yield Problem(("structure",), f"must be '{chain.structure}', as the blocks are", read.structure)
    for i, (entry, name) in enumerate(zip(read.blocks, chain.names, strict=True)):
        if entry.name != name:
            yield Problem(("blocks", i, "name"), f"must be '{name}' in this place", entry.name)
    if read.begun and read.start != "estimated":
        yield Problem(("begun",), 'holds states, which only a model of "start": "estimated" has')
    sizes = state_sizes(chain)
    for i, one in enumerate(read.begun):
        if (got := tuple(map(len, one.states))) != sizes:
            yield Problem(
                ("begun", i, "states"),
                f"must have as many numbers as the states of the linear blocks, {list(sizes)}, "
                f"not {list(got)}",
            )
    if any(entry.fitted_on for entry in read.blocks):
        for i, entry in enumerate(read.blocks):
            if entry.fitted_on is None:
                yield Problem(("blocks", i, "fitted_on"), "is required: other blocks have it")


def _parsed(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except FileNotFoundError:
        near = did_you_mean(str(path), [str(other) for other in sorted(path.parent.glob("*.json"))])
        raise ConfigError(f"{path}: no such file{near}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    if len(content) > LARGEST:
        raise ConfigError(
            f"{path}: cannot be read: it is larger than {LARGEST // 1024} kB, the most that a model may have"
        )
    try:
        data = json.loads(content.decode("utf-8-sig"), object_pairs_hook=_once)
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: cannot be read: it is not UTF-8 text") from None
    except json.JSONDecodeError as error:
        raise ConfigError(
            f"{path}:{error.lineno}: cannot be read: it is no JSON ({error.msg[0].lower()}{error.msg[1:]} at "
            f"column {error.colno})"
        ) from None
    except RecursionError:
        raise ConfigError(
            f"{path}: cannot be read: lists and mappings stand too deep in each other"
        ) from None
    except ValueError as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: must be a mapping of keys to values, with 'hident_model': {VERSION}")
    return data


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A mapping of the pairs; ValueError if a key stands twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key '{next(key for key in keys if keys.count(key) > 1)}' stands twice")
    return found


def _text(value: Any, indent: str = "") -> str:
    """JSON with each key on a line of its own, and lists of numbers together."""
    inner = f"{indent}  "
    match value:
        case {**entries} if entries:
            lines = [f"{inner}{_scalar(str(key))}: {_text(item, inner)}" for key, item in entries.items()]
            return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
        case [*items] if any(isinstance(item, list | Mapping) for item in items):
            return "[\n" + ",\n".join(inner + _text(item, inner) for item in items) + f"\n{indent}]"
        case [*items]:
            line = f"[{', '.join(map(_scalar, items))}]"
            if len(indent) + len(line) <= _WIDTH:
                return line
            return "[\n" + ",\n".join(_lines(map(_scalar, items), inner)) + f"\n{indent}]"
    return _scalar(value)


def _lines(words: Iterator[str], indent: str) -> Iterator[str]:
    line = ""
    for word in words:
        if line and len(line) + len(word) + 2 > _WIDTH:
            yield line
            line = ""
        line = f"{line}, {word}" if line else f"{indent}{word}"
    yield line


def _scalar(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
