"""Chains of linear and static blocks by prediction error: Hammerstein, Wiener, and what is longer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator

from hident.arrays import Characteristic
from hident.block_chain import Block, BlockChain, Start
from hident.config.spec import Count, NonEmpty, Of, Spec, component
from hident.errors import EstimationError
from hident.estimators.base import CONTINUOUS, DISCRETE, AtOneInterval, require_usable, unknown_past
from hident.estimators.discrete_response import at_step
from hident.estimators.normalisation import MissedConstant, Normalisation, missed_constant, unit_static_gain
from hident.estimators.prediction_error.block_specs import (
    BlockSpec,
    ContinuousBlock,
    DynamicSpec,
    StaticSpec,
)
from hident.estimators.prediction_error.chain_fit import ChainFit, fit_chain
from hident.estimators.prediction_error.criterion import Data
from hident.estimators.prediction_error.parameters import LinearStructure, Parameters
from hident.estimators.prediction_error.standard_errors import names, normal_form, standard_errors, values
from hident.estimators.prediction_error.starts import DEFAULT, Initialisation
from hident.estimators.prediction_error.structure import ChainStructure
from hident.fitted_model import Begun, FittedModel, NoiseModel, digest
from hident.records import Estimate, Record, Response
from hident.sampled_blocks import SampledTransferFunction
from hident.static_functions import StaticFunction
from hident.systems.function_basis import Functions, Series

_MOST_BLOCKS = 9
_SUMMARY = ("mse", "iterations", "starts", "finalists", "agreeing")


class NoiseOrders(Spec):
    """Orders of D and C in D(q) v = C(q) e, the noise on the output; both zero: output error."""

    ar: Annotated[Count, Field(ge=0, le=100)] = 0
    """Order of D."""
    ma: Annotated[Count, Field(ge=0, le=100)] = 0
    """Order of C."""


_A_CONSTANT = (
    "a static block that holds a constant estimates it, such as a polynomial, or an expansion with {kind: "
    "power, exponent: 0} in its basis"
)


@component("estimator", "prediction_error", source="Ljung, System Identification, 2nd ed., 7.2, 10.2")
class PredictionError(AtOneInterval):
    """Chain of blocks whose sum of squared prediction errors is least, of several starts.

        y = G_n(... f_2(G_1(f_1(u)))) + v,    D(q) v = C(q) e,    sum_k e_k^2 least

    The blocks say what is fitted: static-linear is a Hammerstein system, linear-static a Wiener system,
    linear-static-linear a Wiener-Hammerstein system, static-linear-static a Hammerstein-Wiener one. With
    ``noise`` of orders zero this is output error: the simulation is fitted; else one-step predictions are.
    What no data determine is fixed by static gains of 1, see :mod:`hident.estimators.prediction_error.gauge`.

    Examples
    --------
    >>> import hident as hi
    >>> system = hi.Hammerstein(nonlinearity=hi.Polynomial(coefficients=[0, 1, 0.5]), linear=hi.Ar(a=[0.5]))
    >>> record = hi.simulate(system, hi.Iid(distribution="uniform", low=-1, high=1), 500)
    >>> blocks = [hi.PolynomialBlock(degree=2), hi.LinearBlock(nb=1, nf=1)]
    >>> found = hi.fit(hi.PredictionError(blocks=blocks, start="rest", n_init=50), record)
    >>> round(found.linear.a[0], 6), found.model.chain.structure
    (0.5, 'N-L')
    """

    blocks: Annotated[NonEmpty[Annotated[BlockSpec, Of("block")]], Field(max_length=_MOST_BLOCKS)]
    """The blocks from the input to the output."""
    noise: NoiseOrders = NoiseOrders()
    """Orders of the noise model."""
    start: Literal["settled", "rest", "estimated"] = "settled"
    """What was before a record: its first input for ever, nothing, or what its first samples tell."""
    n_init: Annotated[Count, Field(ge=0)] = 0
    """First samples of each experiment that are simulated but not fitted."""
    starts: Annotated[Count, Field(ge=1, le=1000)] = 8
    """Most starts that are raced."""
    initialisation: Annotated[tuple[Initialisation, ...], Field(min_length=1)] = DEFAULT
    """The methods that make the starts, of which those count that suit the structure; ``fewer_linear_blocks``
    (for L-N-L, from the fits of L-N and N-L) is one to ask for where linear models explain little."""
    max_iterations: Annotated[Count, Field(ge=1)] = 100
    """Most iterations of the last descent."""

    @field_validator("blocks")
    @classmethod
    def _something_to_find(cls, blocks: tuple[BlockSpec, ...]) -> tuple[BlockSpec, ...]:
        if all(block.held for block in blocks):
            raise ValueError("all blocks are held: one at least must be found")
        for i, (one, other) in enumerate(pairwise(blocks), start=1):
            if isinstance(one, StaticSpec) and isinstance(other, StaticSpec):
                raise ValueError(
                    f"blocks {i} and {i + 1} are both static, which together are one static function"
                )
        return blocks

    def fewest_samples(self) -> int:
        return self.n_init + 2 * self._count()

    def _count(self) -> int:
        """How many numbers are to be found, at least."""
        count = self.noise.ar + self.noise.ma
        for block in self.blocks:
            if not block.held:
                count += block.fewest_numbers()
            if self.start == "estimated" and isinstance(made := block.structure(), LinearStructure):
                count += made.states
        return count

    def begun_in_motion(self, shortest: int) -> Self:
        if self.start == "estimated":
            return self
        return self.model_copy(update={"n_init": max(self.n_init, unknown_past(shortest))})

    def free_parameters(self) -> int:
        # The gain of each linear block is one with a static function, unless a block is held.
        gains = len(self._places()) - self._kept_gains() if len(self._places()) < len(self.blocks) else 0
        count = self.noise.ar + self.noise.ma + sum(one.numbers() for one in self.blocks if not one.held)
        return count - (0 if any(block.held for block in self.blocks) else gains)

    def _kept_gains(self) -> int:
        """How many linear blocks keep their gain: before the first static one, of functions with a unit."""
        first = next((i for i, block in enumerate(self.blocks) if isinstance(block, StaticSpec)), None)
        if first is None:
            return 0
        block = self.blocks[first]
        return first if isinstance(block, StaticSpec) and block.has_unit() else 0

    def _places(self) -> dict[int, str]:
        """What the names of each block's values begin with: nothing where there is one of its sort.

        The two of a Wiener-Hammerstein model are named as those of the system.
        """
        linear = [i for i, block in enumerate(self.blocks) if isinstance(block, DynamicSpec)]
        if len(self.blocks) == 3 and linear == [0, 2]:
            return {0: "input_", 2: "output_"}
        return {i: f"l{k}_" if len(linear) > 1 else "" for k, i in enumerate(linear, start=1)}

    def names(self) -> Sequence[str]:
        found: list[str] = []
        for i, before in self._places().items():
            own = self._numbers_of(i)
            found += [f"{before}{name}" for name in own]
            found += [f"se_{before}{name}" for name in own]
        return [*found, *_SUMMARY]

    def _numbers_of(self, i: int) -> list[str]:
        """The names of the numbers of a linear block by its place."""
        block = self.blocks[i]
        assert isinstance(block, DynamicSpec)
        return block.number_names()

    def provides(self) -> frozenset[str]:
        parts = {"response", "model"}
        if len(self._places()) == 1:
            parts.add("continuous" if self._continuous() else "linear")
        if len(self.blocks) - len(self._places()) == 1:
            parts.add("nonlinearity")
        return frozenset((*parts, *(f"value {name}" for name in self.names())))

    def _continuous(self) -> int:
        """How many linear blocks are continuous."""
        return sum(isinstance(block, ContinuousBlock) for block in self.blocks)

    def letters(self) -> Mapping[str, str]:
        # In a chain of both sorts a letter has no meaning of its own.
        return {len(self._places()): CONTINUOUS, 0: DISCRETE}.get(self._continuous(), {})

    def check(self, n: int, dt: float | None) -> None:
        if why := self._unsuited(n, dt):
            raise ValueError(why)

    def _unsuited(self, samples: int, dt: float | None) -> str:
        """Why records of so many samples every ``dt`` do not suit the continuous blocks; empty if they do."""
        if not self._continuous():
            return ""
        if dt is None:
            return "a continuous block needs the sampling interval 'dt' of the data"
        for i, block in enumerate(self.blocks, start=1):
            if isinstance(block, ContinuousBlock) and not block.delay_at(dt) < samples * dt:
                delay = block.delay_at(dt)
                record = f"a record of {samples} samples every {dt:g}"
                return f"the delay {delay:g} of block {i} is as long as {record}"
        return ""

    def normalisations(self) -> tuple[Normalisation, ...] | None:
        if any(block.held for block in self.blocks) or self._kept_gains():
            return None
        rule = unit_static_gain("b l1_b l2_b l3_b input_b output_b")
        # The orders of two linear blocks with a nonlinearity between them say which of them has a delay.
        return (replace(rule, free=rule.free | {"delay"}) if len(self._places()) > 1 else rule,)

    def misses_constant(self, nonlinearity: Characteristic) -> MissedConstant | None:
        # A constant is held where one of the static functions holds it.
        static = [block.functions() for block in self.blocks if isinstance(block, StaticSpec)]
        missed = [missed_constant(one, nonlinearity, _A_CONSTANT) for one in static or [()]]
        return missed[0] if all(missed) else None

    def fit(self, record: Record, rng: np.random.Generator | None = None) -> Estimate:
        fit = self.identify(record)
        return self.estimate(fit, record)

    def identify(self, record: Record) -> ChainFit:
        """The fit, with all that is known of the search."""
        require_usable(record)
        self.require_experiments(record)
        data = self.data(record)
        if data.count < self.fewest_samples() - self.n_init:
            raise EstimationError(
                f"{data.count} samples are left after n_init, and at least "
                f"{self.fewest_samples() - self.n_init} are needed"
            )
        if why := self._unsuited(len(record), record.dt):
            raise EstimationError(why)
        return fit_chain(
            self.structure(record.dt),
            data,
            ar=self.noise.ar,
            ma=self.noise.ma,
            most_starts=self.starts,
            max_iterations=self.max_iterations,
            states=self.start == "estimated",
            initialisation=self.initialisation,
        )

    def data(self, record: Record) -> Data:
        """The record as the criterion takes it."""
        past: Start = "rest" if self.start == "rest" else "settled"
        return Data(record.u, record.y, record.experiments, past, self.n_init)

    def standard_errors(self, of_blocks: Sequence[Mapping[str, float]]) -> dict[str, float]:
        """The standard errors of the linear blocks by the names of values; 0 for what is held."""
        return {
            f"se_{before}{name}": of_blocks[i].get(name, 0.0)
            for i, before in self._places().items()
            for name in self._numbers_of(i)
        }

    def structure(self, dt: float | None = None) -> ChainStructure:
        """What is to be found, from samples every ``dt`` (None: discrete time)."""
        if self._continuous() and dt is None:
            raise ValueError("a continuous block needs the sampling interval 'dt' of the data")
        step = 1.0 if dt is None else dt
        blocks = tuple(self._sampled_blocks())
        given = {i: block.given(step) for i, block in enumerate(blocks)}
        return ChainStructure(
            tuple(block.structure(step) for block in blocks),
            {i: block for i, block in given.items() if block is not None},
            frozenset(i for i, block in enumerate(self.blocks) if block.held),
        )

    def _sampled_blocks(self) -> Iterator[BlockSpec]:
        """The blocks, of which each continuous one says what its input is between samples."""
        moves = False
        for block in self.blocks:
            if not isinstance(block, ContinuousBlock):
                yield block
                continue
            yield block.model_copy(
                update={"intersample": block.intersample or ("linear" if moves else "held")}
            )
            moves = True

    def estimate(self, fit: ChainFit, record: Record) -> Estimate:
        """The fit as an estimate, in the normal form."""
        point = fit.point
        form = normal_form(point)
        errors = standard_errors(point)
        numbers = self.standard_errors(errors)
        for i, before in self._places().items():
            own = names(form, i)
            numbers |= {f"{before}{name}": value for name, value in zip(own, values(form, i), strict=True)}
        mse = point.loss / point.data.count
        summary = (mse, fit.iterations, fit.starts, fit.finalists, fit.agreeing)
        numbers |= dict(zip(_SUMMARY, map(float, summary), strict=True))
        model = FittedModel(
            chain=replace(_seen(form, point.data), dt=record.dt),
            start=self.start,
            noise=NoiseModel(point.noise.ar, point.noise.ma, mse),
            errors=errors,
            about=_about(fit, record),
            begun=_begun(form, record),
        )
        chain = model.chain
        [only] = chain.linear if len(chain.linear) == 1 else [None]
        continuous = only.continuous if isinstance(only, SampledTransferFunction) else None
        return Estimate(
            nonlinearity=chain.static[0] if len(chain.static) == 1 else None,
            linear=only if continuous is None else None,
            continuous=continuous,
            response=_response(chain),
            model=model,
            values={name: float(numbers[name]) for name in self.names()},
            details={"status": fit.status},
        )


def _response(chain: BlockChain) -> Response:
    """What the chain answers from rest; discrete blocks at their own interval."""
    if chain.linear and not chain.is_continuous:
        return at_step(chain.response, chain.dt or 1.0)
    return lambda u, dt: (chain.every(dt) if chain.is_continuous else chain).response(u)


def _seen(form: Parameters, data: Data) -> BlockChain:
    """The chain, in which given functions say between which inputs they were fitted."""
    blocks: list[Block] = []
    x = data.u
    for i, block in enumerate(form.chain.blocks):
        if isinstance(block, StaticFunction) and isinstance(block.basis, Functions | Series):
            met = x[data.counted]
            seen = block.basis.seen(float(np.min(met)), float(np.max(met)))
            blocks.append(block if i in form.held else replace(block, basis=seen))
        else:
            blocks.append(block)
        x = data.begun(block, x, form.states.get(i, ()))
    return replace(form.chain, blocks=tuple(blocks))


def _begun(form: Parameters, record: Record) -> tuple[Begun, ...]:
    """The states of each experiment of a record, in the normal form; nothing where they were not found."""
    if not form.states:
        return ()
    of_blocks = [form.states[i] for i in sorted(form.states)]
    return tuple(
        Begun(digest(record.u[part], record.y[part]), tuple(tuple(one[k].tolist()) for one in of_blocks))
        for k, part in enumerate(record.experiments)
    )


def _about(fit: ChainFit, record: Record) -> Mapping[str, Any]:
    return {
        **({"offsets": dict(record.offsets)} if record.offsets else {}),
        **({"detrend": "linear"} if record.detrended else {}),
        "method": "prediction_error",
        "status": fit.status,
        "iterations": fit.iterations,
        "starts": fit.starts,
        "finalists": fit.finalists,
        "agreeing": fit.agreeing,
    }
