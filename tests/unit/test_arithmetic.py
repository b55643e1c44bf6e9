"""Which kernels the libraries use: what is asked for, what is in use, and what is said where they part."""

import os
import subprocess
import sys

import pytest

from hident import arithmetic
from hident.engine.executors import make_executor
from hident.errors import ConfigError

AVX2 = frozenset({"avx2", "fma"})
AVX512 = AVX2 | {"avx512f"}
OPENBLAS = {"library": "openblas", "version": "0.3.30", "kernel": "Haswell", "threads": 1}
USE = {"asked": "pinned", "blas": [OPENBLAS], "simd": ["X86_V3"]}
BEFORE_2_4 = (
    "AVX512F AVX512CD AVX512_KNL AVX512_KNM AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"  # 2.3
)


@pytest.mark.parametrize(
    ("numpy", "disabled"),
    [
        ("2.4.6", "X86_V4 AVX512_ICL AVX512_SPR"),
        ("3.0.0rc1", "X86_V4 AVX512_ICL AVX512_SPR"),
        ("2.3.5", BEFORE_2_4),
        ("1.26.4", BEFORE_2_4.removesuffix(" AVX512_SPR")),
    ],
)
def test_the_loops_above_avx2_are_disabled_by_their_names_in_numpys_version(numpy, disabled):
    assert arithmetic.pinned({}, AVX512, numpy) == {
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": disabled,
    }


def test_a_processor_without_avx512_has_no_loops_to_disable():
    assert arithmetic.pinned({}, AVX2, "2.4.6") == {"OPENBLAS_CORETYPE": "Haswell"}


def test_what_is_disabled_already_stays_so_and_what_the_kernel_was_set_to_does_not():
    environment = {
        "HOME": "/home/me",
        "OPENBLAS_CORETYPE": "SkylakeX",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3,X86_V4",
        "NPY_ENABLE_CPU_FEATURES": "X86_V4",
    }
    settings = arithmetic.pinned(environment, AVX512, "2.4.6")
    assert settings == {
        "HOME": "/home/me",
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    }
    assert arithmetic.pinned(settings, AVX512, "2.4.6") == settings


@pytest.mark.parametrize(
    ("machine", "processor", "reason"),
    [
        ("x86_64", AVX2, ""),
        ("AMD64", AVX512, ""),
        ("x86_64", {"avx2"}, "the processor has no AVX2 and FMA, or does not say so"),
        ("x86_64", set(), "the processor has no AVX2 and FMA, or does not say so"),
        ("aarch64", set(), "the machine is aarch64, and the pinned arithmetic is for x86-64"),
    ],
)
def test_what_hinders(machine, processor, reason):
    assert arithmetic.hindrance(machine, processor) == reason


@pytest.mark.skipif(sys.platform != "linux", reason="Linux has /proc/cpuinfo")
def test_features_are_those_of_the_first_processor(tmp_path):
    file = tmp_path / "cpuinfo"
    file.write_text("model name : A\nflags\t\t: fpu avx avx2 fma avx512f sse2\n\nflags\t: fpu\n")
    assert arithmetic.features(file) == AVX512
    file.write_text("Features : asimd\n")
    assert arithmetic.features(file) == set()
    assert arithmetic.features(tmp_path / "none") == set()


@pytest.mark.parametrize(("value", "asked"), [(None, "pinned"), ("", "pinned"), ("native", "native")])
def test_what_is_asked_for(monkeypatch, value, asked):
    monkeypatch.delenv("HIDENT_ARITHMETIC", raising=False)
    if value is not None:
        monkeypatch.setenv("HIDENT_ARITHMETIC", value)
    assert arithmetic.asked() == asked


def test_another_value_is_refused(monkeypatch):
    monkeypatch.setenv("HIDENT_ARITHMETIC", "fast")
    with pytest.raises(ConfigError) as caught:
        arithmetic.asked()
    assert str(caught.value) == "HIDENT_ARITHMETIC must be pinned or native (got 'fast')"


@pytest.mark.parametrize(
    ("use", "reason", "said"),
    [
        ({}, "", ""),
        ({"simd": ["SSE42", "AVX", "FMA3", "AVX2"]}, "", ""),
        # Loaded before, but as it should be.
        ({}, "numpy was loaded before hident", ""),
        ({"asked": "native", "simd": ["X86_V3", "X86_V4"]}, "", ""),
        (
            {"simd": ["X86_V3", "X86_V4"], "blas": [OPENBLAS | {"kernel": "SkylakeX"}]},
            "numpy was loaded before hident",
            "BLAS openblas SkylakeX, numpy's loops X86_V3 X86_V4 (numpy was loaded before hident)",
        ),
        (
            {"blas": [OPENBLAS, {"library": "mkl", "version": "2025", "kernel": ""}]},
            "",
            "BLAS openblas Haswell, mkl, numpy's loops X86_V3 (mkl chooses its own kernels)",
        ),
        (
            {"simd": []},
            "",
            "BLAS openblas Haswell, numpy's loops without SIMD "
            "(numpy's AVX2 loops are turned off or not built in)",
        ),
        (
            {"blas": [], "simd": ["ASIMD"]},
            "the machine is arm64, and the pinned arithmetic is for x86-64",
            "BLAS unknown, numpy's loops ASIMD "
            "(the machine is arm64, and the pinned arithmetic is for x86-64)",
        ),
    ],
)
def test_a_shortfall_names_what_is_in_use_and_why(use, reason, said):
    start = "the arithmetic in use is not the pinned one, so last digits may differ: "
    assert arithmetic.shortfall(USE | use, reason) == (start + said if said else "")


can_be_pinned = pytest.mark.skipif(
    arithmetic.asked() != "pinned" or bool(arithmetic.hindrance("x86_64", arithmetic.features())),
    reason="this processor has no AVX2, or the tests were asked to run without",
)


@can_be_pinned
def test_the_tests_run_under_the_pinned_set():
    use = arithmetic.in_use()
    assert arithmetic.shortfall(use) == ""
    assert {library["kernel"] for library in use["blas"]} == {"Haswell"}
    assert os.environ["OPENBLAS_CORETYPE"] == "Haswell"


def test_workers_compute_as_this_process_does():
    with make_executor(2) as workers:
        assert workers.submit(arithmetic.identity).result() == arithmetic.identity()


def _in_a_new_process(code: str, **environment: str) -> str:
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_the_identity_tells_two_arithmetics_apart():
    theirs = _in_a_new_process(
        "from hident import arithmetic; print(arithmetic.identity())",
        HIDENT_ARITHMETIC="native",
        OPENBLAS_CORETYPE="Nehalem",
    )
    if "openblas" not in theirs:
        pytest.skip("this BLAS cannot be told which kernel to use")
    assert "Nehalem" in theirs
    assert theirs != arithmetic.identity()


_WITH_WORKERS = """
import os
import numpy
os.environ.update({changes})
from hident import arithmetic
from hident.engine.executors import make_executor
from hident.errors import ConfigError
print(arithmetic.identity())
with make_executor(2) as workers:
    try:
        print(workers.submit(arithmetic.identity).result())
    except ConfigError as error:
        print(error)
print(os.environ.get("HIDENT_ARITHMETIC"))
"""


def test_workers_compute_as_this_process_does_where_numpy_came_first():
    said = _in_a_new_process(
        _WITH_WORKERS.format(changes={}), HIDENT_ARITHMETIC="pinned", OPENBLAS_CORETYPE="Nehalem"
    )
    here, there, asked = said.splitlines()
    assert there == here
    assert asked == "pinned"


@can_be_pinned
def test_workers_of_another_arithmetic_refuse_to_work():
    changes = {"OPENBLAS_CORETYPE": "Nehalem"}
    here, said, _ = _in_a_new_process(_WITH_WORKERS.format(changes=changes)).splitlines()
    if "openblas" not in here:
        pytest.skip("this BLAS cannot be told which kernel to use")
    there = here.replace("Haswell", "Nehalem")
    assert said == (
        "worker processes compute with another arithmetic than this process, so that last digits would "
        f"differ within one result: '{there}' there, '{here}' here. Import hident before numpy, or run with "
        "--jobs 1"
    )


def test_help_loads_no_numerical_library():
    loaded = _in_a_new_process(
        "import sys\nfrom hident.cli import app\n"
        "try:\n    app(['--help'])\nexcept SystemExit:\n    pass\n"
        "print('loaded:', {'numpy', 'scipy', 'pandas', 'matplotlib', 'pydantic'} & sys.modules.keys())"
    )
    assert loaded.endswith("loaded: set()")
