"""What a table does depends on no other table of its batch."""

import numpy as np
import pytest

pytest.importorskip("numba")

from shake_env import make_scenario
from shake_env.kernels.vectors import BLOCK
from shake_env.simulation import compiled_engine
from shake_env.simulation.simulation import Simulation


def test_a_lanes_field_depends_on_its_seed_alone():
    scenario = make_scenario("field", {"duration": 0.5})
    shown = []
    for lanes, lane in ((1, 0), (3, 1), (BLOCK + 3, BLOCK + 1)):
        simulation = Simulation(scenario, lanes)
        seeds = [np.random.default_rng(50 + i) for i in range(lanes)]
        seeds[lane] = np.random.default_rng(7)
        simulation.start(range(lanes), seeds)
        for _ in range(20):
            result = simulation.step(np.full(lanes, 0.1))
        shown.append(np.append(result.observation[lane], simulation.memory.gain[lane]))
    np.testing.assert_allclose(shown[1], shown[0], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(shown[2], shown[0], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", ["linear", "laboratory", "unknown-specimen", "yielding", "records"])
def test_a_table_begins_alone_as_it_does_with_its_block(name, monkeypatch):
    """Episodes that begin one by one in the middle of others, to the bit."""
    seen = []
    for few in (0, compiled_engine.FEW):
        monkeypatch.setattr(compiled_engine, "FEW", few)
        simulation, rng = Simulation(make_scenario(name), 40), np.random.default_rng(2)
        simulation.start(range(40), [np.random.default_rng(i) for i in range(40)])
        shown = []
        for t in range(12):
            if t % 3 == 1:  # at every place of the preview's ring
                lanes = [t, 33, 20]
                streams = [np.random.default_rng((t, lane)) for lane in lanes]
                shown.append(simulation.start(lanes, streams))
            result = simulation.step(rng.uniform(-0.2, 0.2, 40))
            shown += [result.observation, result.report]
        state = simulation.get_state()
        seen.append([*shown, *(state[key] for key in sorted(state) if state[key].dtype != object)])
    assert all(np.array_equal(*pair) for pair in zip(*seen, strict=True))
