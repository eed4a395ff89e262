"""Damage passes from shake to shake: two shakes with a rest between are one long motion."""

from dataclasses import replace

import numpy as np
import pytest

from shake_env import numba_support
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.specimen_state import NEW, SpecimenState
from shake_env.motion.targets import RecordedMotion
from shake_env.records.record import Record
from shake_env.rollout import Earthquake, rollout
from shake_env.scenario.limits import Limits
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.plants.samples import PlantSamples
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.streams import earthquake_stream
from shake_env.simulation.trajectory import Trajectory

STORIES, QUIET = 2, 4.0  # [s] after which nothing moves
STATE = SpecimenState(slip=(2e-3, -1e-3), reference_slip=(1e-3, 5e-4), energy=3.0, reference_energy=2.0)


def yielding_scenario(**changes):
    scenario = make_scenario(
        "yielding", {"stories": STORIES, "damping_ratio": 0.3, "mass_ratio": 0.5, **changes}
    )
    return replace(scenario, limits=Limits())


def pulses(*amplitudes):
    """A second of a sine of 3 Hz, then rest, for each amplitude; at the physics step, not resampled."""
    time = 0.001 * np.arange(1000)
    shake = np.concatenate([np.sin(6 * np.pi * time), np.zeros(round(QUIET / 0.001))])
    return Record("pulses", np.concatenate([a * shake for a in amplitudes]), 0.001, ())


class Played:
    """Plays actions; memory is the step."""

    def __init__(self, *levels):
        time = 0.005 * np.arange(200)
        shake = np.concatenate([np.cos(6 * np.pi * time), np.zeros(round(QUIET / 0.005))])
        self.actions = np.concatenate([level * shake for level in levels])

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        step = 0 if state is None else state[0]
        value = self.actions[min(step, len(self.actions) - 1)]
        return np.full((*observation.shape[:-1], 1), value, np.float32), (step + 1,)


def run(scenario, levels, amplitudes, specimen=None) -> Trajectory:
    quake = Earthquake(
        "pulses", RecordedMotion(record=pulses(*amplitudes), highpass_frequency=None), 1, specimen
    )
    return rollout(Played(*levels), scenario, [quake], record=[0])[1][0]


def ends(trajectory):
    """Base shears and drifts of the first storey at the ends of the periods, (2, periods) each."""
    k = len(trajectory.base_shear) // len(trajectory.current)
    shears = np.stack([trajectory.base_shear, trajectory.reference_base_shear])[:, k - 1 :: k]
    return shears, np.stack([trajectory.state[:, 4], trajectory.reference[:, 0]])


def energies(trajectory, first=(0.0, 0.0)):
    shears, drifts = ends(trajectory)
    shears = np.concatenate([np.zeros((2, 1)), shears], axis=1)
    drifts = np.concatenate([np.array(first)[:, None], drifts], axis=1)
    return np.sum(0.5 * (shears[:, 1:] + shears[:, :-1]) * np.diff(drifts), axis=1)


def test_two_shakes_one_after_the_other_are_one_long_motion():
    scenario = yielding_scenario()
    levels, amplitudes = (0.3, 0.5), (2.0, 4.0)
    whole = run(scenario, levels, amplitudes)
    first = run(scenario, levels[:1], amplitudes[:1])
    # The state of the reference's slip is in no trajectory: a simulation that ends there has it.
    simulation = Simulation(scenario, 1)
    motion = RecordedMotion(record=pulses(amplitudes[0]), highpass_frequency=None)
    simulation.start([0], [earthquake_stream(1)], [motion])
    for action in Played(levels[0]).actions[: len(first.current)]:
        simulation.step(np.array([action], dtype=np.float32).astype(np.float64))
    states, references = simulation.specimens
    middle = NEW.after(states[0], references[0], *energies(first))
    assert min(np.abs(middle.slip)) > 1e-4 and min(np.abs(middle.reference_slip)) > 1e-4
    second = run(scenario, levels[1:], amplitudes[1:], middle)
    # The long motion's first shake has a sample more between the two.
    shears, drifts = ends(whole)
    own_shears, own_drifts = ends(second)
    count = own_drifts.shape[1]
    size, force = np.abs(drifts).max(), np.abs(shears).max()
    assert np.abs(own_drifts - drifts[:, -count:]).max() < 1e-9 * size
    assert np.abs(own_shears - shears[:, -count:]).max() < 1e-9 * force
    start = np.cumsum((1.0 - scenario.nonlinearity.yielding.stiffness_ratio) * np.array(middle.slip))
    reference_start = own_drifts[1, 0]
    total = [*energies(second, (start[0], reference_start))]
    total = [total[0] + middle.energy, total[1] + middle.reference_energy]
    assert total == pytest.approx(energies(whole), rel=1e-6)
    new = run(scenario, levels[1:], amplitudes[1:])
    assert np.abs(new.state[:, 4] - second.state[:, 4]).max() > 1e-2 * size


@pytest.mark.parametrize("lanes", [1, 3])
def test_both_engines_begin_from_the_same_damage(lanes, monkeypatch):
    scenario = yielding_scenario()
    specimens = [STATE] if lanes == 1 else [None, STATE, NEW]
    looks = []
    for compiled in (True, False):
        monkeypatch.setattr(numba_support, "COMPILED", compiled)
        simulation = Simulation(scenario, lanes)
        streams = [earthquake_stream(i) for i in range(lanes)]
        look = simulation.start(range(lanes), streams, None, specimens)
        state = simulation.state[:, 4 : 4 + 3 * STORIES]
        at = 0 if lanes == 1 else 1
        assert state[at, -STORIES:] == pytest.approx(STATE.slip)
        alpha = scenario.nonlinearity.yielding.stiffness_ratio
        assert state[at, :STORIES] == pytest.approx((1 - alpha) * np.cumsum(STATE.slip))
        if lanes == 3:
            assert not state[0].any() and not state[2].any()
        for _ in range(20):
            result = simulation.step(np.zeros(lanes))
        looks.append((look, result.observation, result.report))
    for one, other in zip(*looks, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)
    # A storey at rest bears no force.
    quiet = Simulation(scenario, 1)
    quiet.start([0], [earthquake_stream(0)], [RecordedMotion(record=pulses(0.0))], [STATE])
    for _ in range(50):
        report = quiet.step(np.zeros(1)).report
    assert np.abs(report[2:4]).max() < 1e-9
    assert quiet.state[0, 4] == pytest.approx((1 - alpha) * STATE.slip[0], rel=1e-12)


def test_samples_of_a_plant_hold_the_damage_of_each():
    scenario = yielding_scenario()
    rows = [
        (0.5, *STATE.values.values()),
        (0.6, *NEW.after(np.zeros(6), np.zeros(6), 0, 0).values.values()),
    ]
    samples = PlantSamples(names=("mass_ratio", *STATE.values), rows=tuple(rows))
    simulation = Simulation(replace(scenario, uncertainty=samples), 8)
    simulation.start(range(8), [earthquake_stream(i) for i in range(8)])
    values = [each["mass_ratio"] for each in simulation.get_state()["plant_values"]]
    assert set(values) == {0.5, 0.6}
    slips = simulation.state[:, 4 + 2 * STORIES : 4 + 3 * STORIES]
    for value, slip in zip(values, slips, strict=True):
        assert slip == pytest.approx(STATE.slip if value == 0.5 else (0.0, 0.0))
    # A shake may be given another state, and a plant be kept.
    simulation.start([0], [earthquake_stream(9)], None, [NEW], draw=False)
    assert simulation.get_state()["plant_values"][0]["mass_ratio"] == values[0]
    assert not simulation.state[0].any()
    assert SpecimenState.from_values(STATE.values, STORIES) == STATE
    assert SpecimenState.from_values({"mass_ratio": 0.5}, STORIES) is None


def test_damage_that_a_specimen_cannot_have_is_refused():
    with pytest.raises(ParameterError, match="energy"):
        SpecimenState(energy=-1.0)
    with pytest.raises(ParameterError, match="as many storeys"):
        SpecimenState(slip=(1e-3,))
    with pytest.raises(ParameterError, match="finite"):
        SpecimenState(slip=(np.nan,), reference_slip=(0.0,))
    with pytest.raises(ParameterError, match="storey_slip_2"):
        SpecimenState.from_values({"storey_slip_1": 0.0}, 2)
    for scenario, words in (
        (make_scenario("laboratory"), "do not yield"),
        (yielding_scenario(stories=3), "must hold 3 storeys"),
    ):
        with pytest.raises(ScenarioError, match=words):
            Simulation(scenario, 1).start([0], [earthquake_stream(0)], None, [STATE])
