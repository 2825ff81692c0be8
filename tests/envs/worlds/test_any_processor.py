"""The batched world is the same to the bit on every processor."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from episode_hash import fingerprint

TESTS = Path(__file__).parents[2]
FINGERPRINT = "d46c22c3fcd01ec4ede3a95521928e61aed08ebfce5fcc687e444381e0528640"
"""Hash of 1,000 episodes. It changes with the world's behaviour, and with nothing else: if it does,
the CHANGELOG says what trained agents will see differently."""

SETTINGS = [
    *({"OPENBLAS_CORETYPE": core} for core in ("Haswell", "SkylakeX", "Sandybridge")),
    *({"OPENBLAS_CORETYPE": core} for core in ("Nehalem", "Prescott")),
    *({"NPY_DISABLE_CPU_FEATURES": names} for names in ("X86_V4", "X86_V4 X86_V3")),
    {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2_Usable,-FMA_Usable,-AVX2,-FMA,-AVX512F"},
]
"""Settings that make NumPy, BLAS and the C library take the loops of other processors."""
TOGETHER = SETTINGS[3] | SETTINGS[6] | SETTINGS[7]
"""BLAS, NumPy and the C library all without fused multiply-add."""
NEEDS = {"Haswell": "avx2", "SkylakeX": "avx512f", "Sandybridge": "avx", "haswell": "avx2"}
NEEDS |= {"skylake-avx512": "avx512vl"}
"""Features that the processor needs to run another one's loops."""
COMPILED_FOR = ["nehalem", "haswell", "skylake-avx512"]
"""Processors that the compiler can be asked to write for: without and with fused multiply-add."""

only_x86 = pytest.mark.skipif(
    platform.machine() != "x86_64" or not sys.platform.startswith("linux"),
    reason="settings of x86-64 under Linux",
)


def python_under(settings, *arguments):
    """Run Python with the tests on its path, as if on another processor; returns its output."""
    needed = {NEEDS[value] for value in settings.values() if value in NEEDS}
    if not needed <= set(Path("/proc/cpuinfo").read_text().split()):
        pytest.skip(f"this processor lacks {', '.join(needed)}")
    env = os.environ | settings | {"PYTHONPATH": os.pathsep.join([*sys.path, str(TESTS)])}
    code = [sys.executable, "-W", "ignore", *arguments]
    run = subprocess.run(code, env=env, capture_output=True, text=True, check=False, timeout=1800)
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()


def fingerprint_under(settings, episodes=1000):
    code = f"from episode_hash import fingerprint; print(fingerprint({episodes}))"
    return python_under(settings, "-c", code)


@pytest.mark.parametrize("threads", [1, None])
def test_a_thousand_episodes_are_these(threads):
    assert fingerprint(1000, threads) == FINGERPRINT


@pytest.mark.slow
@only_x86
@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: "-".join(settings.values()))
def test_numpy_blas_and_the_c_library_do_not_enter(settings):
    assert fingerprint_under(settings) == FINGERPRINT


ELEMENTARY = """
import hashlib
import numpy as np
from test_elementary import FUNCTIONS, arguments
digest = hashlib.sha256()
for name, (function, _, largest, _) in FUNCTIONS.items():
    digest.update(np.array([function(x) for x in arguments(largest, len(name))]).tobytes())
print(digest.hexdigest())
"""
"""A hash of the elementary functions, which multiply and add in one rounding."""


@only_x86
@pytest.mark.usefixtures("unmeasured")
@pytest.mark.slow
def test_the_elementary_functions_are_the_same_compiled_without_fused_multiply_add(
    monkeypatch, capsys
):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    exec(ELEMENTARY, {})
    without = {"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": ""}
    assert python_under(without, "-c", ELEMENTARY) == capsys.readouterr().out.strip()


@pytest.mark.slow
@only_x86
@pytest.mark.parametrize("processor", COMPILED_FOR)
def test_it_is_the_same_compiled_for_another_processor(processor, tmp_path):
    settings = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": ""}
    assert fingerprint_under(settings | {"NUMBA_CACHE_DIR": str(tmp_path)}) == FINGERPRINT


SAME_AND_FOLLOWS = (
    "from episode_hash import fingerprint\n"
    "from parity import *\n"
    "print(fingerprint(100))\n"
    "stand = assert_parity(Scene(), STANDING, inflation=3.0)\n"
    "rng = np.random.default_rng(3)\n"
    "scene = assert_parity(random_scene(rng), range(2), 8.0, float(rng.uniform(1, 9)))\n"
    "print(*stand, *scene)"
)
STANDING = [173]
"""Seeds of random driving in which a car nearly stops on the ramp: there one bit of highway-env's
state grows to a centimetre."""


@only_x86
@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize(
    "settings",
    [TOGETHER, *(pytest.param(each, marks=pytest.mark.slow) for each in SETTINGS)],
    ids=lambda settings: "-".join(settings.values()),
)
def test_it_is_the_same_and_follows_highway_env_wherever_that_runs(settings):
    code = SAME_AND_FOLLOWS.replace("STANDING", str(STANDING))
    found, steps, _, more, _ = python_under(settings, "-c", code).split()
    assert found == fingerprint(100), "NumPy, BLAS or the C library entered"
    assert int(steps) + int(more) > 100
