"""Standard normal numbers ahead: numpy's own, whatever is drawn when, and streams that can be copied."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shake_env import nonlinear_dynamics
from shake_env.normals import FEW, Normals, _load_kernel

LANES = 70  # more than are taken at once


def filled(normals, lanes, count):
    out = np.full((len(lanes), count), np.nan)
    normals.fill(lanes, out)
    return out


@pytest.mark.parametrize("kind", [np.random.PCG64, np.random.PCG64DXSM, np.random.SFC64])
def test_the_numbers_are_numpys_to_the_last_bit(kind):
    normals = Normals(FEW)
    for lane in range(FEW):
        normals[lane] = np.random.Generator(kind(lane))
    # Of a number in 4000 lies beyond the layers: some hundred do.
    found = np.concatenate([filled(normals, range(FEW), n) for n in (1, 640, 100_000, 7)], axis=1)
    for lane in range(FEW):
        assert np.array_equal(found[lane], np.random.Generator(kind(lane)).standard_normal(100_648))
    assert np.abs(found).max() > 3.6541528853610088


def test_the_compiled_numbers_are_what_is_tested():
    assert _load_kernel() is not None
    normals = Normals(FEW)
    streams = [np.random.default_rng(lane) for lane in range(FEW)]
    for lane, stream in enumerate(streams):
        normals[lane] = stream
    filled(normals, range(FEW), 10)
    # Raw numbers were drawn ahead; one alone would stand at the tenth.
    assert streams[0].standard_normal() != np.random.default_rng(0).standard_normal(11)[10]


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_any_order_of_draws_copies_and_restarts_gives_the_streams_numbers(data):
    normals, streams = Normals(LANES), {}
    for step in range(6):
        begun = data.draw(st.lists(st.integers(0, LANES - 1), unique=True), label="begun")
        for lane in begun:
            normals[lane] = np.random.default_rng([step, lane])
            streams[lane] = np.random.default_rng([step, lane])
        some = st.sets(st.sampled_from(sorted(streams))) if streams else st.just(set())
        lanes = sorted(data.draw(some, label="lanes"))
        count = data.draw(st.integers(0, 900), label="count")
        wanted = [streams[lane].standard_normal(count) for lane in lanes]
        assert np.array_equal(filled(normals, lanes, count), np.reshape(wanted, (len(lanes), count)))
        kept = normals.snapshot()
        assert normals.lanes == sorted(streams)
        for lane, stream in streams.items():
            assert kept[lane].bit_generator.state["state"] == stream.bit_generator.state["state"]
        if data.draw(st.booleans(), label="restored"):
            normals = Normals(LANES)
            normals.restore(kept)


def test_a_snapshot_goes_on_where_nothing_is_compiled(monkeypatch):
    normals = Normals(FEW)
    for lane in range(FEW):
        normals[lane] = np.random.default_rng(lane)
    before = filled(normals, range(FEW), 50)
    monkeypatch.setattr(nonlinear_dynamics, "COMPILED", False)
    after = filled(normals, range(FEW), 50)
    for lane in range(FEW):
        whole = np.random.default_rng(lane).standard_normal(100)
        assert np.array_equal(np.concatenate([before[lane], after[lane]]), whole)
