"""Compilation for other processors, kept on disk by several processes, and where no folder is open."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("numba")
ROOT = Path(__file__).parents[3]
COMPARE = """
import numpy as np
from shake_env import make_scenario, numba_support
from shake_env.simulation.simulation import Simulation
for name in ("linear", "laboratory"):
    numba_support.COMPILED, scenario = True, make_scenario(name)
    batch, alone = Simulation(scenario, 37), Simulation(scenario, 1)
    numba_support.COMPILED = False
    plain = Simulation(scenario, 37)
    numba_support.COMPILED = True
    streams = lambda lanes: [np.random.default_rng(lane) for lane in lanes]
    batch.start(range(37), streams(range(37)))
    alone.start([0], streams([35]))
    numba_support.COMPILED = False
    plain.start(range(37), streams(range(37)))
    rng = np.random.default_rng(0)
    for _ in range(30):
        action = rng.normal(0.0, 0.2, 37)
        numba_support.COMPILED = True
        ours, single = batch.step(action), alone.step(action[35:36])
        numba_support.COMPILED = False
        theirs = plain.step(action)
        assert (ours.report[:, 35] == single.report[:, 0]).all()
        size = np.abs(theirs.report).max(axis=1, keepdims=True) + 1e-300
        assert (np.abs(ours.report - theirs.report) <= 1e-11 * size).all()
        assert np.abs(ours.observation - theirs.observation).max() < 1e-4
print("alike")
"""
FIRST = """
import gymnasium, numpy as np, time
env = gymnasium.make("shake_env:ShakeTable-v0")
env.reset(seed=0)
print(env.step(np.zeros(1, np.float32))[1], time.process_time())
"""


def start(script, folder, **environment):
    given = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "OMP_NUM_THREADS": "1", **environment}
    return subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=given, cwd=ROOT,
    )  # fmt: skip


def finished(process):
    out, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    return out.strip(), errors


@pytest.mark.slow
@pytest.mark.parametrize("processor", ["x86-64", "x86-64-v3", "x86-64-v4"])
def test_other_processors_step_alike(processor, tmp_path):
    """SSE2 alone, AVX2 with fused products, and AVX-512 where this machine has it."""
    info = Path("/proc/cpuinfo")
    flags = info.read_text(encoding="utf-8") if info.exists() else ""
    if {"x86-64": "sse2", "x86-64-v3": "avx2", "x86-64-v4": "avx512vl"}[processor] not in flags:
        # Instructions that the processor lacks would end the process: it cannot be tried here.
        pytest.skip("this machine has no such registers")
    features = {"x86-64": "+sse2", "x86-64-v3": "+avx2,+fma", "x86-64-v4": "+avx512f"}[processor]
    found = start(COMPARE, tmp_path, NUMBA_CPU_NAME=processor, NUMBA_CPU_FEATURES=features)
    assert finished(found)[0] == "alike"


@pytest.mark.slow
def test_a_first_use_takes_seconds_and_two_at_once_share_one_folder(tmp_path):
    pair = [start(FIRST, tmp_path) for _ in range(2)]
    rewards, times = zip(*(finished(each)[0].split() for each in pair), strict=True)
    again, later = finished(start(FIRST, tmp_path))[0].split()
    assert {*rewards, again} == {rewards[0]}
    assert max(map(float, times)) < 10.0  # [s] of processor time, imports included
    assert float(later) < min(map(float, times))
    assert not list(tmp_path.rglob("*.tmp*"))


def test_without_a_folder_that_can_be_written_one_line_says_so(monkeypatch, caplog):
    """numba refuses where neither the package's folder nor the user's is open: then in memory."""
    from numba import int64, njit

    from shake_env.kernels import compiling

    def refusing(*given, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return njit(*given, **options)

    monkeypatch.setattr(compiling, "njit", refusing)
    assert compiling.cached(int64(int64), lambda x: x + 1)(2) == 3
    (record,) = caplog.records
    assert record.levelname == "WARNING" and "NUMBA_CACHE_DIR" in record.message


def test_the_stamp_changes_with_every_source(tmp_path, monkeypatch):
    from shake_env.kernels import compiling

    folder = Path(compiling.__file__).parent
    for path in (*folder.glob("*.py"), folder.parent / "model" / "random_numbers.py"):
        copy = tmp_path / path.relative_to(folder.parent)
        copy.parent.mkdir(exist_ok=True)
        copy.write_text(path.name)
    monkeypatch.setattr(compiling, "__file__", str(tmp_path / "kernels" / "compiling.py"))
    sources = list(tmp_path.rglob("*.py"))
    found = {compiling.stamp()}
    for path in sources:
        path.write_text(path.read_text() + "#")
        found.add(compiling.stamp())
    assert len(found) == len(sources) + 1 > 10
