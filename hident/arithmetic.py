"""Which kernels the numerical libraries compute with: one set on all x86-64 machines with AVX2 and FMA.

OpenBLAS and numpy choose their kernels by the processor, and with them the order of their sums and so the
last bits. Both read what they may use from the environment when they are loaded, so this module, which
``hident`` imports first, sets it before. Processes that are started from here inherit it.
``HIDENT_ARITHMETIC=native`` leaves everything to the libraries. See docs/reproducibility.md.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hident.errors import ConfigError

VARIABLE = "HIDENT_ARITHMETIC"
CHOICES = ("pinned", "native")
_KERNEL = "Haswell"
_NEEDED = {"avx2", "fma"}
# What numpy calls its loops above AVX2, by the first version with these names, the latest first. It warns of
# a name that it does not know, and not of one that the processor lacks.
_AVX512 = [
    "AVX512F",
    "AVX512CD",
    "AVX512_KNL",
    "AVX512_KNM",
    "AVX512_SKX",
    "AVX512_CLX",
    "AVX512_CNL",
    "AVX512_ICL",
]
_LOOPS = (
    ((2, 4), ["X86_V4", "AVX512_ICL", "AVX512_SPR"]),
    ((2, 3), [*_AVX512, "AVX512_SPR"]),
    ((0, 0), _AVX512),
)
_TOO_LATE = "numpy was loaded before hident"
_ABOVE_AVX2 = {name for _, names in _LOOPS for name in names}


def asked() -> str:
    """What was asked for: ``pinned``, which is the default, or ``native``.

    Raises
    ------
    ConfigError
        If HIDENT_ARITHMETIC has another value.
    """
    value = os.environ.get(VARIABLE) or CHOICES[0]
    if value not in CHOICES:
        raise ConfigError(f"{VARIABLE} must be {' or '.join(CHOICES)} (got '{value}')")
    return value


def features(cpuinfo: Path = Path("/proc/cpuinfo")) -> frozenset[str]:
    """Which of avx2, fma and avx512f this processor has; empty where that cannot be found out."""
    if sys.platform == "linux":
        try:
            with cpuinfo.open(encoding="ascii", errors="replace") as lines:
                flags = next((line for line in lines if line.startswith("flags")), "")
        except OSError:
            return frozenset()
        return frozenset(flags.split()) & {*_NEEDED, "avx512f"}
    import ctypes

    if sys.platform == "darwin":
        names = {"hw.optional.avx2_0": "avx2", "hw.optional.fma": "fma", "hw.optional.avx512f": "avx512f"}
        library, value, size = ctypes.CDLL(None), ctypes.c_int(0), ctypes.c_size_t(4)
        return frozenset(
            feature
            for name, feature in names.items()
            if library.sysctlbyname(name.encode(), ctypes.byref(value), ctypes.byref(size), None, 0) == 0
            and value.value
        )
    if sys.platform == "win32":
        has = ctypes.windll.kernel32.IsProcessorFeaturePresent
        # Windows has no number for FMA; the processors that it runs on have it wherever they have AVX2.
        return frozenset({*(_NEEDED if has(40) else ()), *(("avx512f",) if has(41) else ())})
    return frozenset()


def hindrance(machine: str, processor: Set[str]) -> str:
    """Why this machine cannot have the pinned set; empty if it can."""
    if machine.lower() not in ("x86_64", "amd64"):
        return f"the machine is {machine or 'unknown'}, and the pinned arithmetic is for x86-64"
    if not processor >= _NEEDED:
        return "the processor has no AVX2 and FMA, or does not say so"
    return ""


def pinned(environment: Mapping[str, str], processor: Set[str], numpy: str) -> dict[str, str]:
    """An environment in which OpenBLAS and numpy load the pinned set; what was disabled already stays so.

    ``numpy`` is its version, which decides the names of its loops.
    """
    # To enable loops and to disable others is an error of numpy's.
    settings = {name: value for name, value in environment.items() if name != "NPY_ENABLE_CPU_FEATURES"}
    settings["OPENBLAS_CORETYPE"] = _KERNEL
    if "avx512f" in processor:
        version = tuple(int(part) for part in numpy.split(".")[:2])
        above = next(names for since, names in _LOOPS if version >= since)
        disabled = settings.get("NPY_DISABLE_CPU_FEATURES", "").replace(",", " ").split()
        settings["NPY_DISABLE_CPU_FEATURES"] = " ".join(dict.fromkeys((*disabled, *above)))
    return settings


def _prepare() -> str:
    """Set the environment, and return why that could not be done or comes too late; empty if neither."""
    if os.environ.get(VARIABLE) == "native":
        return ""
    if "numpy" in sys.modules:
        return _TOO_LATE
    processor = features()
    if reason := hindrance(platform.machine(), processor):
        return reason
    numpy = ""
    if "avx512f" in processor:
        from importlib.metadata import version

        numpy = version("numpy")
    settings = pinned(os.environ, processor, numpy)
    for name in os.environ.keys() - settings.keys():
        del os.environ[name]
    for name, value in settings.items():
        if os.environ.get(name) != value:
            os.environ[name] = value
    return ""


_REASON = _prepare()


@contextmanager
def handed_on() -> Iterator[None]:
    """Let the processes that are started here load the kernels that this one has loaded.

    Where numpy came first, hident changes nothing here, nor may it there.
    """
    before = os.environ.get(VARIABLE)
    if _REASON == _TOO_LATE:
        os.environ[VARIABLE] = "native"
    try:
        yield
    finally:
        if before is not None:
            os.environ[VARIABLE] = before
        elif _REASON == _TOO_LATE:
            del os.environ[VARIABLE]


def in_use() -> dict[str, Any]:
    """What was asked for, and what the loaded libraries compute with, as plain data."""
    import numpy as np
    import scipy.linalg  # noqa: F401  (its BLAS must be loaded to be seen)
    from threadpoolctl import threadpool_info

    simd: Any = np.show_config(mode="dicts")
    libraries = [
        {
            "library": info["internal_api"],
            "version": info["version"] or "",
            "kernel": info.get("architecture", ""),
            "threads": info["num_threads"],
        }
        for info in threadpool_info()
        if info["user_api"] == "blas"
    ]
    return {
        "asked": asked(),
        "blas": sorted(libraries, key=lambda library: str(library["version"])),
        "simd": simd["SIMD Extensions"].get("found", []),
        "processor": sorted(features()),
        "machine": platform.machine(),
        "libm": _libm(),
    }


def _libm() -> str:
    """The C library, and the setting by which a user chooses among the variants of its functions."""
    try:
        library = os.confstr("CS_GNU_LIBC_VERSION") or platform.system()
    except (AttributeError, ValueError, OSError):
        library = f"{platform.system()} {platform.release()}"
    tunables = os.environ.get("GLIBC_TUNABLES", "").split(":")
    return " ".join((library, *(tunable for tunable in tunables if "hwcaps" in tunable)))


def identity() -> str:
    """What is in use in a short text: numbers of equal texts have the same last bits."""
    use = in_use()
    return "; ".join(
        (
            ", ".join(f"{b['library']} {b['version']} {b['kernel']}" for b in use["blas"]) or "no BLAS known",
            " ".join(use["simd"]) or "no SIMD",
            # By the processor alone choose libm and FFTW, whose loops end at AVX2.
            " ".join((use["machine"], *(name for name in use["processor"] if name in _NEEDED))),
            use["libm"],
        )
    )


def shortfall(use: Mapping[str, Any], reason: str = _REASON) -> str:
    """Where the pinned arithmetic was asked for and is not in use: what is, and why; else empty."""
    if use["asked"] != "pinned":
        return ""
    others = [b for b in use["blas"] if (b["library"], b["kernel"]) != ("openblas", _KERNEL)]
    simd = set(use["simd"])
    above, missing = simd & _ABOVE_AVX2, not simd & {"X86_V3", "AVX2"}
    if use["blas"] and not (others or above or missing):
        return ""
    if not reason:
        reason = _why(others, missing=missing)
    kernels = ", ".join(dict.fromkeys(f"{b['library']} {b['kernel']}".strip() for b in use["blas"]))
    return (
        "the arithmetic in use is not the pinned one, so last digits may differ: "
        f"BLAS {kernels or 'unknown'}, numpy's loops {' '.join(use['simd']) or 'without SIMD'} ({reason})"
    )


def _why(others: list[dict[str, Any]], *, missing: bool) -> str:
    if foreign := [b["library"] for b in others if b["library"] != "openblas"]:
        return f"{foreign[0]} chooses its own kernels"
    if missing:
        return "numpy's AVX2 loops are turned off or not built in"
    return "this build of the library has no other" if others else "numpy does not turn its loops off"
