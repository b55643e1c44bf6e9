"""Exact steady states of Brouri's Wiener-Hammerstein system, eq. (43), with a polynomial between."""

from collections.abc import Mapping

import numpy as np

from hident.estimators.frequency.harmonics import harmonics
from hident.estimators.frequency.staircase_levels import PolynomialFit
from hident.records import Held, Part, Periodic, Record

CUBIC = np.array([50.0, 10.0, 1.0, 1.0 / 15.0])


def g_i(omega):
    s = 1j * np.asarray(omega)
    return 0.05 / ((s + 0.1) * (s + 0.5))


def g_o(omega):
    s = 1j * np.asarray(omega)
    return 0.002 / ((s + 0.2) * (s + 0.01))


def steady(t, omega, amplitude=1.5, offset=0.0, c=CUBIC, first=g_i, second=g_o, phase=0.0):
    """The output at the times t (N,), by a Fourier transform of f(u_i) over one period."""
    n = 256
    theta = 2.0 * np.pi * np.arange(n) / n
    gain = first(omega)
    inner = offset + amplitude * abs(gain) * np.sin(theta + np.angle(gain))
    spectrum = np.fft.rfft(np.polyval(c[::-1], inner)) / n
    k = np.arange(1, len(c))
    turned = np.exp(1j * np.outer(omega * t + phase, k))
    return spectrum[0].real + 2.0 * (turned @ (spectrum[1 : len(c)] * second(k * omega))).real


def exact(c=CUBIC, errors=0.0):
    """The polynomial as known up to independent standard errors."""
    return PolynomialFit(np.asarray(c, dtype=float), np.diag(np.broadcast_to(errors, len(c)) ** 2.0))


def found(omega, n=64, periods=20, noise=0.0, rng=None, order=3, **settings):
    """The harmonics of a sine experiment with n samples in a period."""
    dt = 2.0 * np.pi / omega / n
    y = steady(np.arange(n * periods) * dt, omega, **settings)
    if rng is not None:
        y = y + noise * rng.standard_normal(len(y))
    return harmonics(y, dt, omega, order)


def record(sines: Mapping[float, float], levels=(), n=64, periods=20, noise=0.0, hold=400):
    """A record of settled sines {frequency: amplitude}, after a staircase where there are levels."""
    rng = np.random.default_rng(0)
    outputs, parts, start = [], {}, 0

    def add(name, y, dt, waveform):
        nonlocal start
        outputs.append(y)
        parts[name] = Part(start, start + len(y), dt, waveform)
        start += len(y)

    if levels:
        at = np.arange(float(len(levels))) * hold
        y = np.repeat(np.polyval(CUBIC[::-1], np.array(levels)), hold)
        since = np.tile(np.arange(hold), len(levels))
        step = np.repeat(np.diff(np.polyval(CUBIC[::-1], np.array([0.0, *levels]))), hold)
        add("staircase", y - step * np.exp(-since / 12.0), 1.0, Held(at, np.array(levels, dtype=float)))
    for omega, amplitude in sines.items():
        dt = 2.0 * np.pi / omega / n
        y = steady(np.arange(n * periods) * dt, omega, amplitude)
        wave = Periodic(2.0 * np.pi / omega, 0.0, np.array([1]), np.array([-1j * amplitude]))
        add(f"sine {omega}", y, dt, wave)
    y = np.concatenate(outputs)
    return Record(np.zeros_like(y), y + noise * rng.standard_normal(len(y)), 1.0, parts=parts)
