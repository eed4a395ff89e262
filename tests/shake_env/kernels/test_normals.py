"""Standard normal numbers ahead: numpy's own, whatever is drawn when, and streams that can be copied."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shake_env import numba_support
from shake_env.simulation.random_streams import FEW, Normals

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
    assert numba_support.compiled_module("shake_env.kernels.normals").numpys() is not None
    normals = Normals(FEW)
    streams = [np.random.default_rng(lane) for lane in range(FEW)]
    for lane, stream in enumerate(streams):
        normals[lane] = stream
    filled(normals, range(FEW), 10)
    # Raw numbers were drawn ahead; one alone would stand at the tenth.
    assert streams[0].standard_normal() != np.random.default_rng(0).standard_normal(11)[10]


def test_numbers_at_the_bounds_of_every_layer_are_numpys():
    """Raw numbers that a stream never comes to: those beside what decides."""
    kernel = numba_support.compiled_module("shake_env.kernels.normals")
    bounds, widths, heights = kernel.numpys()
    generator = np.random.Generator(np.random.Philox(0))
    compared = 0
    for layer in range(256):
        for place in {max(int(bounds[layer]) + d, 0) for d in (-65, -1, 0, 1, 5, 64)} | {0, 2**52 - 1}:
            # Nearer to 1 the last bit of the heights decides, which are computed and not numpy's own.
            for sign, second in ((0, 0), (1, 2**63), (0, 2**64 - 2**40)):
                words = [(place << 9) | (sign << 8) | layer, second, 2**64 - 1, 12345 << 20]
                state = generator.bit_generator.state
                state["buffer"][:], state["buffer_pos"] = words, 0
                generator.bit_generator.state = state
                wanted = generator.standard_normal()
                raw, out = np.array([words], dtype=np.uint64), np.empty((1, 1))
                held, made = np.zeros(1, dtype=np.int64), np.full(1, 4)
                kernel.convert(raw, held, out, made, 0, bounds, widths, heights)
                if made[0]:  # else four words do not reach
                    compared += 1
                    assert out[0, 0] == wanted, (layer, place, sign, second)
                    assert 4 - held[0] == generator.bit_generator.state["buffer_pos"]
    assert compared > 5_000


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
    monkeypatch.setattr(numba_support, "COMPILED", False)
    after = filled(normals, range(FEW), 50)
    for lane in range(FEW):
        whole = np.random.default_rng(lane).standard_normal(100)
        assert np.array_equal(np.concatenate([before[lane], after[lane]]), whole)


def test_where_numpy_makes_its_numbers_otherwise_they_are_its_own(monkeypatch):
    monkeypatch.setattr(
        numba_support.compiled_module("shake_env.kernels.normals"), "numpys", lambda: None
    )
    normals = Normals(FEW)
    for lane in range(FEW):
        normals[lane] = np.random.default_rng(lane)
    found = filled(normals, range(FEW), 30)
    for lane in range(FEW):
        assert np.array_equal(found[lane], np.random.default_rng(lane).standard_normal(30))
