"""A chain of blocks that was fitted to a record: what it gives for another one."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from hident.arrays import Array
from hident.block_chain import BlockChain, Start
from hident.initial_states import initial_states
from hident.numerics.parts import in_each
from hident.records import Record
from hident.static_functions import StaticFunction

# Sampling intervals this close, relative to their size, are one.
_SAME = 1e-3


@dataclass(frozen=True)
class NoiseModel:
    """Noise v with D(q) v = C(q) e, e white: v_k = d_1 v_{k-1} + ... + e_k + c_1 e_{k-1} + ...

    ``ar`` are d_1, ..., d_p with the signs of :class:`hident.linear_blocks.TransferFunction`, ``ma`` are
    c_1, ..., c_m, and ``variance`` is that of e.
    """

    ar: tuple[float, ...] = ()
    ma: tuple[float, ...] = ()
    variance: float = 0.0

    def innovations(self, v: Array) -> Array:
        """e (N,) of the noise v (N,) of one experiment, whose past counts as zero."""
        from scipy.signal import lfilter

        return np.asarray(lfilter(np.r_[1.0, -np.asarray(self.ar)], np.r_[1.0, self.ma], v))


@dataclass(frozen=True)
class Begun:
    """An experiment of a fit, and the state in which each linear block began it.

    ``sha256`` is of its samples (:func:`digest`), ``states`` are those of :meth:`BlockChain.signals`, beyond
    the settled ones.
    """

    sha256: str
    states: tuple[tuple[float, ...], ...]


def digest(u: Array, y: Array) -> str:
    """The SHA-256 of the input and the output (N,) of an experiment, as doubles of 8 bytes, lowest first."""
    samples = np.concatenate((u, y)).astype("<f8")
    return hashlib.sha256(samples.tobytes()).hexdigest()


@dataclass(frozen=True)
class FittedModel:
    """A chain, how it starts, its noise, and what is known of how it was made.

    ``start`` says what was before a record: nothing (``rest``), or the first input for ever (``settled``).
    Where it is ``estimated``, the states of the linear blocks at the first sample come from the output: those
    that the fit found for its own experiments (``begun``), for others the ones with which the first samples
    are met best (:func:`hident.initial_states.initial_states`). An input alone begins settled.

    ``errors`` holds the standard errors of each block's numbers by their names (``b_0``, ``a_1``, ``c_1``,
    ``low``, ...) as far as they are known, ``ranges`` the least and the greatest input of each block in the
    fit, and ``about`` what a reader of the model should know: the record, its hash, units, the method (see
    :mod:`hident.models.model_file`).

    Where means or an operating point were taken off the record before the fit, they are the model's
    ``offsets``: inputs and outputs are as they were measured, and what is done about it is the model's
    matter. Of a record that has ``offsets`` itself the output is less those.

    Examples
    --------
    >>> import numpy as np
    >>> import hident as hi
    >>> chain = BlockChain((hi.TransferFunction(b=(0.0, 0.5), a=(0.5,)),), dt=4.0)
    >>> model = hi.FittedModel(chain, start="rest")
    >>> model.simulate(np.array([1.0, 1.0, 0.0]))
    array([0.  , 0.5 , 0.75])
    """

    chain: BlockChain
    start: Start | Literal["estimated"] = "settled"
    noise: NoiseModel = NoiseModel()
    errors: tuple[Mapping[str, float], ...] = ()
    ranges: tuple[tuple[float, float], ...] = ()
    about: Mapping[str, Any] = field(default_factory=dict)
    begun: tuple[Begun, ...] = ()

    @property
    def offsets(self) -> tuple[float, float]:
        """What is taken off the input before the chain, and added to its output: 0 where nothing is known."""
        known = self.about.get("offsets", {})
        return float(known.get("input", 0.0)), float(known.get("output", 0.0))

    @property
    def is_detrended(self) -> bool:
        """Whether it was fitted to signals less their straight lines, and knows of no others.

        What a straight line is to be taken off must have lost it before.
        """
        return self.about.get("detrend") == "linear"

    def level(self, record: Record) -> Record:
        """A record as the chain knows it: less the model's offsets.

        Raises
        ------
        ValueError
            If the record still has straight lines, and the model was fitted to one that had lost them.

        Examples
        --------
        >>> import hident as hi
        >>> model = FittedModel(BlockChain(()), about={"offsets": {"input": 20.0, "output": 5.0}})
        >>> model.level(hi.Record([21.0, 22.0], [5.0, 7.0])).u
        array([1., 2.])
        """
        u, y = self.shifts(record)
        if not (u or y):
            return record
        offsets = dict(zip(("input", "output"), self.offsets, strict=True))
        return replace(record, u=record.u - u, y=record.y - y, offsets=offsets)

    def shifts(self, record: Record) -> tuple[float, float]:
        """What is left to take off a record's input, and to add to the chain's output for its own.

        Raises
        ------
        ValueError
            As :meth:`level`.
        """
        if self.is_detrended:
            if not record.detrended:
                raise ValueError(
                    "the model was fitted to signals less their straight lines, which this record still has: "
                    "read it with detrend='linear'"
                )
            return 0.0, 0.0
        u, y = self.offsets
        return u - record.offsets.get("input", 0.0), y - record.offsets.get("output", 0.0)

    @property
    def past(self) -> Start:
        """What was before an input of which no output is known."""
        return "rest" if self.start == "rest" else "settled"

    def simulate(self, record: Record | Array) -> Array:
        """The noise-free output (N,) to a record's input, or to an input (N,).

        Each of the experiments of a record begins anew.

        Raises
        ------
        ValueError
            If an input is not of shape (N,), if a record has not the sampling interval of discrete blocks, or
            :meth:`level` raises one.
        """
        made = self.signals(record)[-1]
        add = self.shifts(record)[1] if isinstance(record, Record) else self.offsets[1]
        return made + add if add else made

    def _for(self, record: Record) -> BlockChain:
        """The chain for a record's samples: continuous blocks have some at any interval."""
        dt, own = record.dt, self.chain.dt
        if dt is None or own is None or not self.chain.linear or abs(dt - own) <= _SAME * own:
            return self.chain
        if not self.chain.is_continuous:
            raise ValueError(
                f"the model's linear blocks are discrete, for samples every {own:g}, and the record has one "
                f"every {dt:g}: resample it, or leave out its dt to take its samples as the model's"
            )
        return self.chain.every(dt)

    def every(self, dt: float) -> FittedModel:
        """The model for samples every ``dt``, without what is of its own samples: its noise and states.

        Raises
        ------
        ValueError
            If a linear block is discrete, and works at its own interval.
        """
        if dt == self.chain.dt:
            return self
        return replace(self, chain=self.chain.every(dt), noise=NoiseModel(), begun=())

    def signals(self, record: Record | Array) -> tuple[Array, ...]:
        """The input of the chain (N,) and what stands behind each block, without the model's offsets.

        See :meth:`simulate`.
        """
        if not isinstance(record, Record):
            u = np.asarray(record, dtype=float)
            if u.ndim != 1:
                raise ValueError(f"an input must be of shape (N,), not {u.shape}")
            return self.chain.signals(u - self.offsets[0] if self.offsets[0] else u, self.past)
        chain, record = self._for(record), self.level(record)
        pieces = [
            chain.signals(u, self.past, self.states(u, y, chain))
            for u, y in ((record.u[part], record.y[part]) for part in record.experiments)
        ]
        return tuple(np.concatenate(one) for one in zip(*pieces, strict=True)) if pieces[1:] else pieces[0]

    def states(self, u: Array, y: Array, chain: BlockChain | None = None) -> tuple[Array, ...] | None:
        """The states in which an experiment begins, beyond what :attr:`past` says; None if there are none.

        Its samples are those of :meth:`level`; ``chain`` are the blocks for them: by default those of the
        fit.
        """
        if self.start != "estimated":
            return None
        if (known := self.known(u, y)) is not None:
            return tuple(np.array(state) for state in known.states)
        return initial_states(chain or self.chain, u, y)

    def known(self, u: Array, y: Array) -> Begun | None:
        """The experiment of the fit that has these samples (N,) of :meth:`level`; None if there is none."""
        if not self.begun:
            return None
        sha256 = digest(u, y)
        return next((one for one in self.begun if one.sha256 == sha256), None)

    def range_of(self, place: int) -> tuple[float, float] | None:
        """Where the block at this place was fitted: its inputs then, or else what its basis spans."""
        if self.ranges:
            return self.ranges[place]
        block = self.chain.blocks[place]
        # Corners are no range: beyond them is where the function acts.
        return block.range if isinstance(block, StaticFunction) and not block.basis.shape else None

    def predict(self, record: Record, steps: int = 1) -> Array:
        """The output (N,) as predicted from all that was measured up to ``steps`` samples before.

        What the noise model makes of the past differences between output and simulation is added to the
        simulation; without a noise model the two are one.

        Raises
        ------
        ValueError
            If continuous blocks have samples at the record's interval, and the noise has none.
        """
        simulated = self.simulate(record)
        if not (self.noise.ar or self.noise.ma):
            return simulated
        if self._for(record) is not self.chain:
            raise ValueError(f"the noise model is one of samples every {self.chain.dt:g}, not {record.dt:g}")
        return simulated + in_each(
            record.experiments, lambda v: self._foreseen(v, steps), record.y - simulated
        )

    def _foreseen(self, v: Array, steps: int) -> Array:
        from scipy.signal import lfilter

        # C/D = F_k + q^-k G_k/D: what the last k innovations add is not known yet.
        impulse = np.zeros(max(steps, 1))
        impulse[0] = 1.0
        known = np.r_[1.0, -np.asarray(self.noise.ar)]
        recent = lfilter(np.r_[1.0, self.noise.ma], known, impulse)[:steps]
        return np.asarray(v - lfilter(recent, [1.0], self.noise.innovations(v)))
