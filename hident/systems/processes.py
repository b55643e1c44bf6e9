"""Chemical processes by their differential equations: examples 3, 4 and 5 of Chen, Hwang and Chang 2009.

Input and output are deviations from a steady state, at which every simulation starts; the input is held from
sample to sample (zero-order hold). Units are those of the configuration, which holds the operating
conditions: the flows, volumes and times must fit together.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from hident.arrays import Array
from hident.config.spec import Real, component
from hident.errors import SimulationError
from hident.linear_blocks import ContinuousTransferFunction
from hident.records import Truth
from hident.systems.base import SystemSpec

Advance = Callable[[Array, float, Array], Array]
"""The states (K, n) at K times after a state (n,), at a constant flow."""
Rates = Callable[..., tuple[float, ...]]

Positive = Annotated[Real, Field(gt=0)]
NotNegative = Annotated[Real, Field(ge=0)]

# Tolerances of the solver for which the outputs of the paper's processes are right to 1e-8.
_RTOL, _ATOL = 1e-11, 1e-15
# Steps of the solver from one time to the next: a hundred are many, a tank that all but empties takes more.
_STEPS = 20_000
# More acid or base than any solution holds, as log10 of its concentration in mol/L: it brackets every pH.
_EXTREME = 2.0
# The range of the root, in units of pH, at which the search for it ends.
_PH_TOLERANCE = 1e-13


class _Process(SystemSpec):
    """A process with one manipulated flow, of which u is the deviation and y what it does to the output.

    The flow may fall to zero, not below.
    """

    manipulated: ClassVar[str]
    """The field with the steady value of the manipulated flow."""

    @property
    def steady_input(self) -> float:
        """The manipulated flow at the steady state."""
        return float(getattr(self, self.manipulated))

    def steady_state(self, inputs: Array) -> Array:
        """The states (..., n) in which the process rests at the manipulated flows ``inputs`` (...)."""
        raise NotImplementedError

    def _measure(self, states: Array) -> Array:
        """The output (...) in ``states`` (..., n)."""
        raise NotImplementedError

    def _advance(self, state: Array, flow: float, times: Array) -> Array:
        """The states (K, n) at increasing ``times`` (K,) after ``state`` (n,), at a constant flow."""
        raise NotImplementedError

    def _values(self) -> dict[str, float]:
        """The values of the truth beyond the steady input and output."""
        return {}

    def _dead_time(self) -> float:
        """The time by which the output is measured late."""
        return 0.0

    def steady_output(self, inputs: Array) -> Array:
        """The steady output (...) at the manipulated flows ``inputs`` (...); nan at a negative flow."""
        inputs = np.asarray(inputs, dtype=float)
        feasible = np.where(inputs >= 0.0, inputs, np.nan)
        return self._measure(self.steady_state(feasible))

    @cached_property
    def _output_at_rest(self) -> float:
        return float(self.steady_output(np.array(self.steady_input)))

    def gain_curve(self, u: Array) -> Array:
        """The steady output's deviation (...) at deviations ``u`` (...) of the flow; nan below no flow."""
        return self.steady_output(self.steady_input + np.asarray(u)) - self._output_at_rest

    def check(self, dt: float | None) -> None:
        if dt is None:
            raise ValueError("a continuous process needs the sampling interval 'dt' of the data")

    def simulate(self, u: Array, dt: float = 1.0) -> Array:
        """The deviation of the output (N,) at the times k dt, the flow's being held at ``u[k]`` from k dt on.

        Raises
        ------
        SimulationError
            If the flow would become negative, the solver fails, or the output is not finite.
        """
        start = self.steady_state(np.array(self.steady_input))
        flows = self._flows(u, dt)
        states = _follow(self._advance, start, flows, dt, self._dead_time())
        y = self._measure(states) - self._measure(start)
        if not np.all(np.isfinite(y)):
            first = dt * float(np.argmin(np.isfinite(y)))
            raise SimulationError(f"the output of the {self.kind} process is not finite at t = {first:g}")
        return y

    def _flows(self, u: Array, dt: float) -> Array:
        flows = self.steady_input + u
        possible = (flows >= 0.0) & np.isfinite(flows)
        if not np.all(possible):
            first = int(np.argmin(possible))
            raise SimulationError(
                f"{self.manipulated} would be {flows[first]:g} at t = {first * dt:g}; "
                f"a flow cannot be negative: the input must stay at or above {-self.steady_input:g}"
            )
        return flows

    def truth(self) -> Truth:
        """The gain curve as the nonlinearity, the process itself as the response, and its steady state."""
        return Truth(
            nonlinearity=self.gain_curve,
            response=self.simulate,
            values={
                "steady_input": self.steady_input,
                "steady_output": self._output_at_rest,
                **self._values(),
            },
        )


@component("system", "ph_neutralisation", source="Chen, Hwang, Chang 2009, example 3, table 3")
class PhNeutralisation(_Process):
    """Tank in which acid, buffer and base streams mix; from the base flow to the pH of the effluent.

        A dh/dt = q_1 + q_2 + q_3 - R_v h^0.5
        A h dW_a4/dt = q_1 (W_a1 - W_a4) + q_2 (W_a2 - W_a4) + q_3 (W_a3 - W_a4),    W_b4 likewise
        W_a4 + 10^(pH - pK_w) + W_b4 (1 + 2 10^(pH - pK_2)) / (1 + 10^(pK_1 - pH) + 10^(pH - pK_2)) = 10^(-pH)

    The states are the level h and the reaction invariants W_a4 and W_b4. At a constant level it would be a
    Wiener system with the time constant A h / (q_1 + q_2 + q_3).

    Examples
    --------
    >>> flows = {"q_1": 16.6, "q_2": 0.55, "q_3": 15.6}
    >>> acids = {"wa_1": 3e-3, "wa_2": -3e-2, "wa_3": -3.05e-3, "wb_1": 0, "wb_2": 3e-2, "wb_3": 5e-5}
    >>> tank = PhNeutralisation(area=207, valve_coefficient=8.75, pk_1=6.35, pk_2=10.25, **flows, **acids)
    >>> round(tank.truth().values["steady_output"], 2)
    7.03
    """

    manipulated: ClassVar[str] = "q_3"

    area: Positive
    """Cross-sectional area A of the tank, cm^2."""
    valve_coefficient: Positive
    """Coefficient R_v of the outlet valve: the outflow is R_v h^0.5, in mL/s at a level h in cm."""
    pk_1: Real
    """First dissociation constant pK_1 of the buffer."""
    pk_2: Real
    """Second dissociation constant pK_2 of the buffer."""
    wa_1: Real
    """Charge invariant W_a1 of the acid stream, mol/L."""
    wa_2: Real
    """Charge invariant W_a2 of the buffer stream, mol/L."""
    wa_3: Real
    """Charge invariant W_a3 of the base stream, mol/L."""
    wb_1: NotNegative
    """Buffer invariant W_b1 of the acid stream, mol/L."""
    wb_2: NotNegative
    """Buffer invariant W_b2 of the buffer stream, mol/L."""
    wb_3: NotNegative
    """Buffer invariant W_b3 of the base stream, mol/L."""
    q_1: Positive
    """Flow of the acid stream, mL/s."""
    q_2: Positive
    """Flow of the buffer stream, mL/s."""
    q_3: Positive
    """Steady flow of the base stream, mL/s; the input is the deviation from it."""
    pk_w: Positive = 14.0
    """Ionic product pK_w of water."""

    def _inflow(self, q_3: Array) -> tuple[Array, Array, Array]:
        """The total inflow and what it carries of W_a and of W_b, elementwise."""
        flow = self.q_1 + self.q_2 + q_3
        charge = self.wa_1 * self.q_1 + self.wa_2 * self.q_2 + self.wa_3 * q_3
        buffer = self.wb_1 * self.q_1 + self.wb_2 * self.q_2 + self.wb_3 * q_3
        return flow, charge, buffer

    def steady_state(self, inputs: Array) -> Array:
        """The level h and the invariants W_a4, W_b4 (..., 3) at rest at base flows ``inputs`` (...)."""
        flow, charge, buffer = self._inflow(inputs)
        return np.stack([(flow / self.valve_coefficient) ** 2, charge / flow, buffer / flow], axis=-1)

    def _advance(self, state: Array, flow: float, times: Array) -> Array:
        area, valve = self.area, self.valve_coefficient
        total, charge, buffer = map(float, self._inflow(np.array(flow)))

        def rates(_: float, state: Array) -> tuple[float, ...]:
            h, wa_4, wb_4 = state.tolist()
            if h <= 0.0:
                raise SimulationError("the tank runs dry")
            volume = area * h
            return (
                (total - valve * math.sqrt(h)) / area,
                (charge - total * wa_4) / volume,
                (buffer - total * wb_4) / volume,
            )

        return _integrate(rates, state, times)

    def _measure(self, states: Array) -> Array:
        return _root_in_ph(self._balance, self.pk_w, states[..., 1], states[..., 2])

    def _balance(self, ph: Array, wa_4: Array, wb_4: Array) -> Array:
        """The excess of positive over negative charge that the pH must leave at zero, mol/L; it rises."""
        second = 10.0 ** (ph - self.pk_2)
        dissociated = (1.0 + 2.0 * second) / (1.0 + 10.0 ** (self.pk_1 - ph) + second)
        return np.asarray(wa_4 + 10.0 ** (ph - self.pk_w) + wb_4 * dissociated - 10.0 ** (-ph))

    def _values(self) -> dict[str, float]:
        level = float(self.steady_state(np.array(self.q_3))[0])
        return {"level": level, "time_constant": self.area * level / (self.q_1 + self.q_2 + self.q_3)}


@component("system", "acid_tank", source="Chen, Hwang, Chang 2009, example 4, table 3")
class AcidTank(_Process):
    """Tank in which sodium hydroxide neutralises acetic and propionic acid; from base flow to pH.

        V dC/dt = q_in C_in - (q_a + q_b) C, for the concentration C of acetate, of propionate and of sodium
        C_Ac / (1 + 10^(pK_AcH - pH)) + C_Pr / (1 + 10^(pK_PrH - pH)) + 10^(pH - pK_w) = C_Na + 10^(-pH)

    The states are the total concentrations of acetate, propionate and sodium. The paper leaves out the
    equations: these are the balances of each in a perfectly mixed tank of constant volume, and electric
    neutrality. Simulated exactly.

    Examples
    --------
    >>> acids = {"acetic_acid": 1, "propionic_acid": 1, "pk_acetic": 4.75, "pk_propionic": 4.87}
    >>> tank = AcidTank(volume=1, q_a=14.2, q_b=14.2, sodium_hydroxide=2, **acids)
    >>> round(tank.truth().values["steady_output"], 2)
    9.41
    """

    manipulated: ClassVar[str] = "q_b"

    volume: Positive
    """Volume V of the tank, in the unit of the flows times that of time."""
    q_a: Positive
    """Flow of the acid stream."""
    q_b: Positive
    """Steady flow of the alkaline stream; the input is the deviation from it."""
    acetic_acid: NotNegative
    """Concentration C_0AcH of acetic acid in the acid stream, mol/L."""
    propionic_acid: NotNegative
    """Concentration C_0PrH of propionic acid in the acid stream, mol/L."""
    sodium_hydroxide: NotNegative
    """Concentration C_0NaOH of sodium hydroxide in the alkaline stream, mol/L."""
    pk_acetic: Real
    """Dissociation constant pK_AcH of acetic acid."""
    pk_propionic: Real
    """Dissociation constant pK_PrH of propionic acid."""
    pk_w: Positive = 14.0
    """Ionic product pK_w of water."""

    def steady_state(self, inputs: Array) -> Array:
        """Total acetate, propionate and sodium (..., 3) at rest at alkaline flows ``inputs`` (...), mol/L."""
        acid = self.q_a / (self.q_a + inputs)
        shares = [self.acetic_acid * acid, self.propionic_acid * acid, self.sodium_hydroxide * (1.0 - acid)]
        return np.stack(shares, axis=-1)

    def _advance(self, state: Array, flow: float, times: Array) -> Array:
        # V dC/dt = q_in C_in - (q_a + q_b) C, solved exactly.
        end = self.steady_state(np.array(flow))
        return np.asarray(end + np.exp(-(self.q_a + flow) / self.volume * times)[:, None] * (state - end))

    def _measure(self, states: Array) -> Array:
        acetate, propionate, sodium = np.moveaxis(states, -1, 0)
        return _root_in_ph(self._balance, self.pk_w, acetate, propionate, sodium)

    def _balance(self, ph: Array, acetate: Array, propionate: Array, sodium: Array) -> Array:
        """The excess of negative over positive charge that the pH must leave at zero, mol/L; it rises."""
        negative = acetate / (1.0 + 10.0 ** (self.pk_acetic - ph)) + propionate / (
            1.0 + 10.0 ** (self.pk_propionic - ph)
        )
        return np.asarray(negative + 10.0 ** (ph - self.pk_w) - sodium - 10.0 ** (-ph))

    def _values(self) -> dict[str, float]:
        return {"time_constant": self.volume / (self.q_a + self.q_b)}


@component("system", "van_de_vusse", source="Chen, Hwang, Chang 2009, example 5, table 3")
class VanDeVusse(_Process):
    """Stirred-tank reactor with A -> B -> C and 2A -> D; from inlet flow to the concentration of B.

        dC_A/dt = -k_1 C_A - k_3 C_A^2 + F/V (C_Af - C_A)
        dC_B/dt = k_1 C_A - k_2 C_B - F/V C_B

    The states are the concentrations C_A and C_B. Neither Hammerstein nor Wiener: gain and dynamics both
    change with the flow.

    Examples
    --------
    >>> rates = {"k_1": 50, "k_2": 100, "k_3": 10}
    >>> reactor = VanDeVusse(volume=1, inlet_flow=34.3, feed_concentration=10, **rates)
    >>> reactor.simulate(np.array([10.0, 10.0, 10.0]), dt=0.01).round(3)
    array([0.   , 0.009, 0.05 ])
    """

    manipulated: ClassVar[str] = "inlet_flow"

    volume: Positive
    """Volume V of the reactor, in the unit of the flow times that of time."""
    inlet_flow: Positive
    """Steady inlet flow F; the input is the deviation from it."""
    feed_concentration: Positive
    """Concentration C_Af of A in the feed, mol/L."""
    k_1: Positive
    """Rate constant of A -> B, per unit of time."""
    k_2: Positive
    """Rate constant of B -> C, per unit of time."""
    k_3: NotNegative
    """Rate constant of 2A -> D, L/mol per unit of time."""
    delay: NotNegative = 0.0
    """Delay of the measurement, in the unit of dt; need not be a multiple of dt."""

    def steady_state(self, inputs: Array) -> Array:
        """The concentrations C_A and C_B (..., 2) at rest at inlet flows ``inputs`` (...)."""
        dilution = inputs / self.volume
        # The positive root of k_3 C_A^2 + (k_1 + F/V) C_A - F/V C_Af, in a form without cancellation.
        linear, fed = self.k_1 + dilution, dilution * self.feed_concentration
        c_a = 2.0 * fed / (linear + np.sqrt(linear**2 + 4.0 * self.k_3 * fed))
        return np.stack([c_a, self.k_1 * c_a / (self.k_2 + dilution)], axis=-1)

    def _advance(self, state: Array, flow: float, times: Array) -> Array:
        k_1, k_2, k_3, feed = self.k_1, self.k_2, self.k_3, self.feed_concentration
        dilution = flow / self.volume

        def rates(_: float, state: Array) -> tuple[float, ...]:
            c_a, c_b = state.tolist()
            return (
                -k_1 * c_a - k_3 * c_a * c_a + dilution * (feed - c_a),
                k_1 * c_a - k_2 * c_b - dilution * c_b,
            )

        return _integrate(rates, state, times)

    def _measure(self, states: Array) -> Array:
        return states[..., 1]

    def _dead_time(self) -> float:
        return self.delay

    def gain_change(self) -> float:
        """The inlet flow at which the steady-state gain changes from positive to negative."""
        # dC_B/dF = 0 at steady state reduces to k_2 (C_Af - C_A)^2 = (k_1 + k_3 C_Af) C_A^2.
        k_1, k_2, k_3, feed = self.k_1, self.k_2, self.k_3, self.feed_concentration
        c_a = feed / (1.0 + math.sqrt((k_1 + k_3 * feed) / k_2))
        with np.errstate(all="ignore"):
            return float(np.divide(self.volume * (k_1 + k_3 * c_a) * c_a, feed - c_a))

    def linearised(self, flow: float) -> ContinuousTransferFunction:
        """The block that small deviations from the steady state at inlet flow ``flow`` obey.

        Raises
        ------
        ValueError
            If the flow is negative.
        """
        if not flow >= 0.0:
            raise ValueError(f"the inlet flow must not be negative, not {flow:g}")
        c_a, c_b = self.steady_state(np.array(flow)).tolist()
        dilution = flow / self.volume
        decay_a, decay_b = self.k_1 + 2.0 * self.k_3 * c_a + dilution, self.k_2 + dilution
        both = decay_a * decay_b
        gain = self.k_1 * (self.feed_concentration - c_a) - decay_a * c_b
        return ContinuousTransferFunction(
            b=(gain / (self.volume * both), -c_b / (self.volume * both)),
            a=((decay_a + decay_b) / both, 1.0 / both),
            delay=self.delay,
        )

    def settling_time(self, flow: float) -> float:
        """The time after which a small step at ``flow`` stays within 5 % of its end; the delay excluded."""
        return self.linearised(flow).settling_time(0.05)

    def _values(self) -> dict[str, float]:
        return {"gain_change": self.gain_change()}


def _follow(advance: Advance, start: Array, flows: Array, dt: float, delay: float) -> Array:
    """The states (N, n) at the times k dt - delay, from rest in ``start``; ``flows[k]`` acts from k dt on."""
    states = np.tile(start, (len(flows), 1))
    times = dt * np.arange(len(flows)) - delay
    # One stretch for each run of equal flows.
    first = np.flatnonzero(np.diff(flows, prepend=np.nan))
    edges = dt * np.append(first, len(flows))
    reached = np.searchsorted(times, edges, side="right")
    state = start
    for i, flow in enumerate(flows[first].tolist()):
        inside = slice(reached[i], reached[i + 1])
        try:
            found = advance(state, flow, np.append(times[inside], edges[i + 1]) - edges[i])
        except SimulationError as error:
            raise SimulationError(
                f"{error} between t = {edges[i]:g} and {edges[i + 1]:g}, at the flow {flow:g}"
            ) from error
        states[inside], state = found[:-1], found[-1]
    return states


def _integrate(rates: Rates, state: Array, times: Array) -> Array:
    """The solution (K, n) of d state / dt = rates(t, state) at ``times`` (K,) by LSODA, from time 0."""
    # solve_ivp wraps the same solver and takes four times as long.
    from scipy.integrate import ODEintWarning, odeint

    with warnings.catch_warnings():
        warnings.simplefilter("error", ODEintWarning)
        try:
            found = odeint(
                rates, state, np.append(0.0, times), tfirst=True, rtol=_RTOL, atol=_ATOL, mxstep=_STEPS
            )
        except ODEintWarning as error:
            reason = str(error).partition(" Run with")[0].rstrip(".")
            raise SimulationError(f"the solver of the differential equations fails ({reason})") from error
    return np.asarray(found[1:])


def _root_in_ph(balance: Callable[..., Array], pk_w: float, *amounts: Array) -> Array:
    """The pH at which ``balance(ph, *amounts)`` is zero, elementwise; nan where no possible pH solves it."""
    from scipy.optimize.elementwise import find_root

    found = find_root(
        balance,
        (-_EXTREME, pk_w + _EXTREME),
        args=amounts,
        tolerances={"xatol": _PH_TOLERANCE, "xrtol": 0.0},
    )
    return np.where(found.success, found.x, np.nan)
