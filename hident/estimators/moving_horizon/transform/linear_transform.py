"""A continuous linear block by least squares over moving horizons, and the search for its structure.

Hwang and Lin 2003 for linear systems, and the second stage of Chen, Hwang and Chang 2009, section 4.4:
the block has a held, known input x and a sampled output y,

    y + a_1 y^(1) + ... + a_n y^(n) = b_0 x(t - d) + ... + b_m x^(m)(t - d),

and its static gain b_0 may be known. Beyond the papers, a constant k may be added to the output, as the
offset of a sensor is: y - k stands in the place of y, and k is one parameter more, as its derivatives vanish.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from hident.arrays import Array, Characteristic
from hident.config.spec import Count, Real, Spec
from hident.errors import EstimationError
from hident.estimators.moving_horizon.searches import StructureSearch
from hident.estimators.moving_horizon.transform.horizon_least_squares import solve
from hident.estimators.moving_horizon.transform.time_weighted import Horizons, Knots
from hident.linear_blocks import ContinuousTransferFunction
from hident.numerics.choices import simplest
from hident.numerics.parts import Parts, in_each, whole

Overlap = Annotated[Real, Field(gt=0, le=1)]
Order = Annotated[Count, Field(ge=1, le=8)]


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A linear block with the regressors ``phi`` (N, P) of a_1, ..., a_n, b_1, ..., b_m and, if free, b_0.

    The last is that of the ``constant`` of the output, None if that is not estimated.
    """

    block: ContinuousTransferFunction
    phi: Array
    horizons: Horizons
    knots: Knots
    constant: float | None = None

    @property
    def regressors(self) -> Array:
        """Those of the block."""
        return self.phi if self.constant is None else self.phi[:, :-1]


def linear_block(
    output: Array,
    held_input: Array,
    dt: float,
    *,
    n: int,
    m: int,
    delay: float,
    eta: float,
    overlap: float,
    start: float = 0.0,
    gain: float | None = None,
    constant: bool = False,
    parts: Parts | None = None,
) -> LinearFit:
    """The block of orders n and m < n, from ``output`` (N,) and the input ``held_input`` (N,).

    ``eta``, ``overlap`` and ``start`` set the horizons, inside the experiments ``parts`` (one by default);
    ``gain`` is b_0 if it is known, ``constant`` whether one is added to the output.

    Raises
    ------
    EstimationError
        If the horizons do not suit the record, or the regression is singular.
    """
    try:
        horizons = Horizons.of(len(output), dt, eta=eta, overlap=overlap, order=n, start=start, parts=parts)
        horizons.require(n + m + (gain is None) + constant)
    except ValueError as error:
        raise EstimationError(str(error)) from None
    knots = Knots.of(held_input, delay, dt, parts)
    y = horizons.transform(horizons.sampled(knots), output)
    x = horizons.transform(horizons.held(delay), held_input)
    free = [x[0]] if gain is None else []
    added = [horizons.constant] if constant else []
    phi = np.stack([*-y[1 : n + 1], *x[1 : m + 1], *free, *added], axis=-1)
    theta = solve(phi, y[0] if gain is None else y[0] - gain * x[0])
    theta, k = (theta[:-1], float(theta[-1])) if constant else (theta, None)
    b_0 = theta[-1] if gain is None else gain
    block = block_of(theta[:n], [b_0, *theta[n : n + m]], delay)
    return LinearFit(block, phi, horizons, knots, k)


def block_of(a: ArrayLike, b: ArrayLike, delay: float) -> ContinuousTransferFunction:
    """The block with estimated coefficients a_1, ..., a_n and b_0, ..., b_m.

    Raises
    ------
    EstimationError
        If they are not finite, or a_n is zero.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b)) and a[-1] != 0.0):
        raise EstimationError("the regressors over the horizons are linearly dependent")
    return ContinuousTransferFunction(tuple(b.tolist()), tuple(a.tolist()), delay)


def responses_in(
    parts: Parts | None, block: ContinuousTransferFunction, held_input: Array, dt: float
) -> Array:
    """The response (N,) of ``block`` to ``held_input`` (N,), from rest in each experiment."""
    return in_each(parts or whole(len(held_input)), lambda x: block.respond(x, dt), held_input)


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured behind the linear block: ``y`` (N,), after the static function ``after``.

    ``parts`` say where the experiments stand, one by default; each begins at rest.
    """

    y: Array
    after: Characteristic
    parts: Parts | None = None

    @classmethod
    def directly(cls, output: Array, parts: Parts | None = None) -> Measured:
        """The block's own output."""
        return cls(output, lambda x: x, parts)

    def error_of(
        self, block: ContinuousTransferFunction, held_input: Array, dt: float, constant: float | None = None
    ) -> float:
        """Root mean square of the simulated output's error over the output's standard deviation.

        A ``constant`` is added to the simulated output.

        Infinite for an unstable block, and where it is not a number.
        """
        if not block.is_stable():
            return math.inf
        residual = self.y - self.after(responses_in(self.parts, block, held_input, dt)) - (constant or 0.0)
        error = float(np.sqrt(np.mean(residual**2)) / np.std(self.y))
        return error if math.isfinite(error) else math.inf


def search_structure(
    output: Array,
    held_input: Array,
    dt: float,
    *,
    largest_n: int,
    delays: Sequence[float],
    eta: float,
    overlap: float,
    start: float = 0.0,
    gain: float | None = None,
    constant: bool = False,
    measured: Measured | None = None,
    nearly_best: float = 1.25,
    parts: Parts | None = None,
) -> tuple[LinearFit, StructureSearch]:
    """The block of the simplest structure (n, m, d) that is nearly the best.

    Among the stable candidates with n up to ``largest_n``, m < n and the given ``delays``, those whose
    simulated output error is within ``nearly_best`` of the least are nearly the best; of these the one
    with the fewest parameters n + m is chosen, the most accurate among equals, and the first among ties.
    The simulated output, unlike the residual of the regression, compares structures on one scale whatever
    the order of the weight; with white measurement noise its error is that noise's for every structure
    that holds the true one, so that the quotient of two such is near one, and well above it where a mode
    is missing. For that the noise must be that of a measurement: behind a Wiener system's block it is the
    ``measured`` output, not ``output``, whose noise the inverse nonlinearity has stretched.

    Raises
    ------
    EstimationError
        If no candidate is stable.
    """
    measured = measured or Measured.directly(output, parts)
    fitted = partial(
        linear_block,
        output,
        held_input,
        dt,
        eta=eta,
        overlap=overlap,
        start=start,
        gain=gain,
        constant=constant,
        parts=parts,
    )
    fits: list[LinearFit | None] = []
    candidates = [(n, m, d) for d in delays for n in range(1, largest_n + 1) for m in range(n)]
    errors, refused = [], ""
    for n, m, delay in candidates:
        try:
            fit = fitted(n=n, m=m, delay=delay)
        except EstimationError as error_of_one:
            refused = f" (the last: {error_of_one})"
            fits.append(None)
            errors.append(math.inf)
        else:
            fits.append(fit)
            errors.append(measured.error_of(fit.block, held_input, dt, fit.constant))
    error = np.array(errors)
    if not np.any(np.isfinite(error)):
        raise EstimationError(f"no structure up to n = {largest_n} gives a stable linear block{refused}")
    ns, ms, ds = (np.array(part) for part in zip(*candidates, strict=True))
    chosen = simplest(error, ns + ms, factor=nearly_best, scale=1.0)
    best = fits[chosen]
    assert best is not None
    return best, StructureSearch(ns, ms, ds.astype(float), error, chosen)


class StageSpec(Spec):
    """The structure and the horizons of the first stage."""

    instead: ClassVar[Mapping[str, str]] = {
        "n": "give a guess; 'structure: search' under 'second' searches",
        "m": "give a guess; 'structure: search' under 'second' searches",
        "horizon": "there is no automatic choice: take one to two settling times",
    }
    n: Order
    """Order n of the linear block; it may be wrong at this stage."""
    m: Annotated[Count, Field(ge=0)] = 0
    """Order m of its numerator, below n."""
    horizon: Annotated[Real, Field(gt=0)]
    """Length eta of the horizons, best between one and two settling times."""
    overlap: Overlap = 0.1
    """lambda: the horizons start lambda eta apart."""

    @model_validator(mode="after")
    def _proper(self) -> Self:
        require_proper(self.n, self.m)
        return self

    def of_structure(self, n: int, m: int) -> StageSpec:
        """The same horizons for a block of other orders."""
        return self.model_copy(update={"n": n, "m": m})

    def horizons(
        self, samples: int, dt: float, start: float, parameters: int, parts: Parts | None = None
    ) -> Horizons:
        """The horizons; ValueError if they do not suit the record or the number of parameters."""
        horizons = Horizons.of(
            samples, dt, eta=self.horizon, overlap=self.overlap, order=self.n, start=start, parts=parts
        )
        horizons.require(parameters)
        return horizons


class SecondStageSpec(Spec):
    """Orders and delay, and lengths in the unit of dt."""

    instead: ClassVar[Mapping[str, str]] = {
        "n": "'structure: search' finds n and m",
        "m": "'structure: search' finds n and m",
        "horizon": "a second stage chooses it where it is left out",
    }
    structure: Literal["given", "search"] = "given"
    """Whether n and m are given, or searched for among all up to largest_n."""
    n: Order | None = None
    """Order n of the linear block (given)."""
    m: Annotated[Count, Field(ge=0)] = 0
    """Order m of its numerator, below n (given)."""
    largest_n: Order = 4
    """Largest order n that is tried (search)."""
    delays: tuple[Annotated[Real, Field(ge=0)], ...] = ()
    """Delays that are tried (search); the estimator's own by default."""
    nearly_best: Annotated[Real, Field(ge=1)] = 1.25
    """The simplest structure whose output error is within this factor of the least is chosen (search)."""
    horizon: Annotated[Real, Field(gt=0)] | None = None
    """Length eta of the horizons; a second stage takes it from the first's settling time by default."""
    overlap: Overlap = 0.1
    """lambda: the horizons start lambda eta apart."""

    @model_validator(mode="after")
    def _keys_fit(self) -> Self:
        given = {"n", "m"} & self.model_fields_set
        searched = {"largest_n", "delays", "nearly_best"} & self.model_fields_set
        if self.structure == "search" and given:
            raise ValueError(f"a search finds n and m: leave out {', '.join(sorted(given))}")
        if self.structure == "given":
            if searched:
                raise ValueError(f"only 'structure: search' takes {' and '.join(sorted(searched))}")
            if self.n is None:
                raise ValueError("give the order 'n', or 'structure: search'")
            require_proper(self.n, self.m)
        return self

    def check(
        self,
        samples: int,
        dt: float,
        start: float,
        *,
        gain: bool,
        constant: bool = False,
        parts: Parts | None = None,
    ) -> None:
        """Raise ValueError if given horizons do not suit the record.

        ``gain`` says whether b_0 is free, ``constant`` whether one is added to the output.
        """
        if self.horizon is None:
            return
        horizons = Horizons.of(
            samples, dt, eta=self.horizon, overlap=self.overlap, order=self.most, start=start, parts=parts
        )
        horizons.require(self.most + (self.m if self.n is not None else self.most - 1) + gain + constant)

    @property
    def most(self) -> int:
        """The largest order n that this stage can find."""
        return self.n if self.n is not None else self.largest_n

    def fit(
        self,
        output: Array,
        held_input: Array,
        dt: float,
        *,
        delay: float,
        eta: float,
        start: float,
        gain: float | None,
        constant: bool = False,
        measured: Measured | None = None,
        parts: Parts | None = None,
    ) -> tuple[LinearFit, StructureSearch | None]:
        """The second stage's block, by horizons of length ``eta``, and the search for its structure."""
        if self.n is None:
            return search_structure(
                output,
                held_input,
                dt,
                largest_n=self.largest_n,
                delays=self.delays or (delay,),
                eta=eta,
                overlap=self.overlap,
                start=start,
                gain=gain,
                constant=constant,
                measured=measured,
                nearly_best=self.nearly_best,
                parts=parts,
            )
        fit = linear_block(
            output,
            held_input,
            dt,
            n=self.n,
            m=self.m,
            delay=delay,
            eta=eta,
            overlap=self.overlap,
            start=start,
            gain=gain,
            constant=constant,
            parts=parts,
        )
        return fit, None


def require_proper(n: int, m: int) -> None:
    """Raise ValueError unless m < n."""
    if m >= n:
        raise ValueError(f"m must be below n = {n}, not {m}: take m = {n - 1} or less, or a larger n")
