"""A plant per lane, drawn at reset; and the yielding reference specimen."""

from dataclasses import replace

import numpy as np
import pytest

from shake_env import FilteredNoise, RecordedMotion, make_scenario, numba_support
from shake_env.dynamics import nonlinear as nonlinear_dynamics
from shake_env.dynamics import yielding_reference as reference
from shake_env.dynamics.ground import GroundMaps
from shake_env.dynamics.nonlinear import NonlinearDynamics
from shake_env.errors import ParameterError
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, Yielding
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.simulation.plant_batch import PlantBatch
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.transition import dynamics_of

WIDE = Uncertainty(
    mass_ratio=Uniform(0.1, 1.0),
    storey_frequency=Uniform(5.0, 9.0),
    damping_ratio=Uniform(0.02, 0.08),
    bulk_modulus=Uniform(1.0e8, 1.6e8),
    leakage=Uniform(1e-13, 1e-11),
    valve_time_constant=Uniform(0.008, 0.012),
    valve_gain=Uniform(4.5e-4, 5.5e-4),
    coulomb_friction=Uniform(100.0, 300.0),
    delay=Uniform(0.0, 6.0),
)


def uncertain(**changes):
    nonlinearity = Nonlinearity(friction=Friction(coulomb=150.0))
    options = {"uncertainty": WIDE, "nonlinearity": nonlinearity, "duration": 2.0, **changes}
    return make_scenario("linear", options)


def run(simulation, steps, lanes, seeds, motions=None):
    streams = [np.random.default_rng(seed) for seed in seeds]
    simulation.start(lanes, streams, motions)
    rng = np.random.default_rng(9)
    shear, reference, cost = [], [], []
    for _ in range(steps):
        result = simulation.step(np.full(simulation.lanes, rng.normal(0.0, 0.1)))
        shear.append(result.outcome.response.base_shear.copy())
        reference.append(result.ground.reference_shear.copy())
        cost.append(result.reward.copy())
    return np.array(shear), np.array(reference), np.array(cost)


MOTIONS = [FilteredNoise(duration=2.0), RecordedMotion(record="napa2014_68150_hne", duration=2.0)] * 2


def test_a_lane_of_a_fleet_is_its_drawn_plant_alone():
    """Each lane equals a batch of one of the scenario that was drawn, under the same ground."""
    scenario = uncertain()
    batch = Simulation(scenario, 4)
    shear, reference, cost = run(batch, 150, range(4), range(4), MOTIONS)
    assert len({plant.specimen.mass for plant in batch.plant_batch.plants}) == 4
    size = np.abs(shear).max()
    for lane in range(4):
        true = replace(batch.plant_batch.plants[lane], uncertainty=Uncertainty())
        dynamics = NonlinearDynamics.from_plant(
            true.plant, true.nonlinearity, 1e-3, 5, delay=true.delay, longest_delay=6
        )
        alone = Simulation(scenario, 1)
        one = run(alone, 150, [0], [lane], [MOTIONS[lane]])
        np.testing.assert_allclose(one[0][:, 0], shear[:, lane], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(one[2][:, 0], cost[:, lane], rtol=1e-8, atol=1e-12)
        state = np.zeros(dynamics.states)
        rng = np.random.default_rng(9)
        for t in range(150):
            current = true.current_limit * np.clip(rng.normal(0.0, 0.1), -1.0, 1.0)
            response = dynamics.control_step(state, np.asarray(current))
            state = response.state
            np.testing.assert_allclose(response.base_shear, shear[t, lane], rtol=1e-8, atol=1e-8 * size)
        assert np.abs(reference[:, lane]).max() > 0.1  # the record begins quietly


def test_the_fields_plants_drawn_at_once_are_those_drawn_one_by_one():
    scenario = make_scenario("field")
    batch = PlantBatch(scenario, 40)
    batch.sample(range(40), [np.random.default_rng(seed) for seed in range(40)])
    for lane in (0, 7, 39):
        true = scenario.drawn(np.random.default_rng(lane))
        assert batch.plants[lane] == true
        own = dynamics_of(true)
        scale = nonlinear_dynamics.controlled_scale(
            true.plant, true.parts, scenario.observation.low_passes
        )
        m = len(scale)
        for name in nonlinear_dynamics.ARRAYS:
            ours, theirs = getattr(batch.model.dynamics, name)[lane], getattr(own, name)
            if name == "advance":  # nothing feels a low-pass: there are zeros, but for rounding
                ours, theirs = (np.array(part) for part in (ours, theirs))
                for part in (ours, theirs):
                    part[:, :m] *= scale / scale[:, None]
                np.testing.assert_allclose(ours[:, :m], theirs[:, :m], atol=1e-13)
                ours, theirs = ours[:, m:], theirs[:, m:]
            np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=0, err_msg=name)
    nominal = scenario.actuator
    drawn = [plant.actuator for plant in batch.plants]
    for name, share in (("bulk_modulus", 0.2), ("valve_gain", 0.1), ("table_mass", 0.02)):
        ratio = np.array([getattr(each, name) for each in drawn]) / getattr(nominal, name)
        assert 0.8 * share < np.abs(ratio - 1.0).max() <= share and abs(np.mean(ratio) - 1.0) < share / 3
    valves = [plant.nonlinearity.valve for plant in batch.plants]
    assert {valve.rated_pressure for valve in valves} == {21e6}
    assert 17e6 <= min(v.supply_pressure for v in valves) < 18e6
    assert 1.5 <= min(plant.delay for plant in batch.plants) < 1.8
    storeys = np.array([plant.specimen.masses for plant in batch.plants])
    assert 0.05 < np.std(storeys[:, 0] / storeys[:, 1]) < 0.12
    assert all(plant.plant.specimen.mass > 0.0 for plant in batch.plants)


@pytest.mark.parametrize("yielding", [Yielding(), Yielding(yield_drift=0.006)])
@pytest.mark.parametrize("valve", [ServoValve(), ServoValve(natural_frequency=60.0)])
def test_plants_drawn_at_once_are_those_drawn_one_by_one(yielding, valve):
    """Every stacked matrix against the drawn scenario's own, which is never stacked."""
    parts = Nonlinearity(friction=Friction(coulomb=150.0), yielding=yielding, valve=valve)
    second_order = valve.natural_frequency is not None  # which has no time constant to draw
    wide = replace(WIDE, valve_time_constant=None) if second_order else WIDE
    scenario = uncertain(
        nonlinearity=parts, limits="laboratory", highpass_frequency=0.5, uncertainty=wide
    )
    batch = PlantBatch(scenario, 9)
    batch.sample([7, 2, 5], [np.random.default_rng(seed) for seed in (1, 2, 3)])
    assert batch.plants[0] == scenario
    for lane, seed in ((7, 1), (2, 2), (5, 3)):
        true = scenario.drawn(np.random.default_rng(seed))
        assert batch.plants[lane] == true
        maps = GroundMaps.from_plant(true.discrete, yielding)
        ours = {name: getattr(batch.model.dynamics, name)[lane] for name in nonlinear_dynamics.ARRAYS}
        own = dynamics_of(true)
        theirs = {name: getattr(own, name) for name in nonlinear_dynamics.ARRAYS}
        for field in ("acceleration", "force", "current"):
            ours[field] = getattr(batch.model.stage_cost, field)[lane]
            theirs[field] = getattr(true.stage_cost, field)
            assert isinstance(theirs[field], float)  # one plant's numbers are numbers
        ours["record"], theirs["record"] = batch.maps.record[lane], maps.record
        if yielding.active:
            for name in reference.ARRAYS:
                ours[name + " of the reference"] = getattr(batch.maps.yielding, name)[lane]
                theirs[name + " of the reference"] = getattr(maps.yielding, name)
        sizes = nonlinear_dynamics.controlled_scale(true.plant, true.parts)
        m = len(sizes)
        for name, expected in theirs.items():
            found = ours[name]
            if name in ("advance", "slope"):  # whose small entries scipy rounds at a current's size
                columns = np.ones(expected.shape[1])
                if name == "advance":
                    columns[:m] = sizes
                found, expected = (part / sizes[:, None] * columns for part in (found, expected))
                largest = np.abs(expected).max(axis=0)
                found, expected = found / largest, expected / largest
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12, err_msg=name)
                continue
            np.testing.assert_allclose(found, expected, rtol=2e-12, atol=0, err_msg=name)
        # The second direction is what the first leaves of x_w, a quarter of its noise.
        noise, expected = batch.maps.noise[lane], maps.noise
        scale = np.linalg.norm(expected, axis=1, keepdims=True)
        np.testing.assert_allclose(noise / scale, expected / scale, rtol=0, atol=1e-12)


@pytest.mark.parametrize("static", [None, 200.0])
@pytest.mark.parametrize("compiled", [True, False])
def test_friction_that_is_only_drawn_acts(static, compiled, monkeypatch):
    """A nominal table without it, as controllers that do not know of it are designed on."""
    monkeypatch.setattr(numba_support, "COMPILED", compiled)
    nominal = Nonlinearity(friction=Friction(static=static))
    drawn = Uncertainty(coulomb_friction=Uniform(300.0, 300.0))
    scenario = make_scenario("linear", {"nonlinearity": nominal, "uncertainty": drawn, "duration": 1.0})
    batch = Simulation(scenario, 4)
    shear, _, _ = run(batch, 100, range(4), range(4))
    true = batch.plant_batch.plants[0]
    assert true.nonlinearity.friction.coulomb == 300.0
    assert true.nonlinearity.friction.static == (None if static is None else 500.0)
    alone = Simulation(replace(true, uncertainty=Uncertainty()), 4)
    expected, _, _ = run(alone, 100, range(4), range(4))
    size = np.abs(expected).max()
    np.testing.assert_allclose(shear[:, 0], expected[:, 0], rtol=1e-8, atol=1e-8 * size)
    free = Simulation(make_scenario("linear", {"duration": 1.0}), 4)
    assert np.abs(run(free, 100, range(4), range(4))[0] - expected).max() > 0.05 * size


def test_a_fleet_without_spread_is_the_common_plant():
    parts = Nonlinearity(friction=Friction(coulomb=150.0))
    common = make_scenario("linear", {"nonlinearity": parts, "duration": 2.0})
    sure = replace(common, uncertainty=Uncertainty(mass_ratio=Uniform(0.5, 0.5)))
    # A recorded motion: plants are drawn from the episode's stream, ahead of its noise.
    ours = run(Simulation(sure, 2), 120, range(2), [0, 1], [MOTIONS[1]] * 2)
    theirs = run(Simulation(common, 2), 120, range(2), [0, 1], [MOTIONS[1]] * 2)
    for one, two in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-7, atol=1e-7)


def test_the_reference_of_a_lane_has_its_own_variance():
    """Its base shear's mean square is the analytic one of the drawn specimen."""
    lanes = 64
    spread = Uncertainty(mass_ratio=Uniform(0.1, 1.0), damping_ratio=Uniform(0.05, 0.05))
    scenario = make_scenario("linear", {"uncertainty": spread, "duration": 30.0})
    simulation = Simulation(scenario, lanes)
    _, reference, _ = run(simulation, 6000, range(lanes), range(lanes))
    analytic = np.array([p.plant.reference_shear_variance for p in simulation.plant_batch.plants])
    ratio = np.mean(reference[1000:] ** 2, axis=(0, 2)) / analytic
    # 25 s hold some 40 independent samples of a 4.3 Hz mode damped by 3 %; 64 lanes make the mean good
    # to 1.6 sqrt(2 / 40 / 64) = 4.5 % (95 %).
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    assert np.corrcoef(ratio, analytic)[0, 1] < 0.5


def test_draws_belong_to_the_lane_and_change_with_each_reset():
    scenario = uncertain()
    small, large = Simulation(scenario, 1), Simulation(scenario, 5)
    small.start([0], [np.random.default_rng(3)])
    large.start(range(5), [np.random.default_rng(s) for s in (7, 3, 8, 9, 10)])
    assert small.plant_batch.plants[0] == large.plant_batch.plants[1]
    before = large.plant_batch.plants[1]
    large.start([1], [np.random.default_rng(4)])
    assert large.plant_batch.plants[1] != before


def test_a_snapshot_keeps_the_plants():
    scenario = uncertain()
    simulation, other = Simulation(scenario, 3), Simulation(scenario, 3)
    run(simulation, 40, range(3), range(3))
    other.set_state(simulation.get_state())
    for _ in range(80):
        one, two = simulation.step(np.full(3, 0.05)), other.step(np.full(3, 0.05))
        np.testing.assert_array_equal(one.observation, two.observation)
        np.testing.assert_array_equal(one.reward, two.reward)


def test_the_yielding_reference_follows_the_table_that_tracks():
    """A yielding specimen on a table moved exactly as the target has the reference's base shear."""
    yielding = Yielding(yield_drift=0.006)
    scenario = make_scenario(
        "linear", {"nonlinearity": Nonlinearity(yielding=yielding), "duration": 4.0}
    )
    simulation = Simulation(scenario, 1)
    _, reference, _ = run(simulation, 800, [0], [5])
    linear = Simulation(replace(scenario, nonlinearity=Nonlinearity()), 1)
    _, elastic, _ = run(linear, 800, [0], [5])
    target = []
    again = Simulation(scenario, 1)
    again.start([0], [np.random.default_rng(5)])
    for _ in range(800):
        target.append(again.step(np.zeros(1)).ground.target[0].copy())
    target = np.concatenate([[0.0], np.concatenate(target)])
    # Ten times finer steps of the same law, the target straight between its samples.
    from shake_env.dynamics.yielding_reference import YieldingReference

    fine = YieldingReference.from_plant(scenario.plant, yielding, 1e-4)
    time = np.arange(len(target)) * 1e-3
    dense = np.interp(np.arange((len(target) - 1) * 10 + 1) * 1e-4, time, target)
    _, _, shear = fine.run(np.zeros((1, 6)), dense[:, None])
    found = reference[:, 0].reshape(-1)
    error = np.linalg.norm(found - shear[9::10, 0]) / np.linalg.norm(found)
    assert error < 2e-3  # second order: 1 % of a 10 ms error
    # It does yield: its shear stays below the elastic one's peak.
    assert np.abs(found).max() < 0.8 * np.abs(elastic).max()


def test_far_from_yield_the_reference_is_the_linear_one():
    far = Nonlinearity(yielding=Yielding(yield_drift=1e300))
    scenario = make_scenario("linear", {"nonlinearity": far, "duration": 3.0})
    _, reference, _ = run(Simulation(scenario, 2), 600, range(2), [1, 2], MOTIONS[:2])
    linear = Simulation(replace(scenario, nonlinearity=Nonlinearity()), 2)
    _, expected, _ = run(linear, 600, range(2), [1, 2], MOTIONS[:2])
    # For noise the linear reference knows the target between its samples, this one takes it straight.
    # The bridge left out adds a velocity of 2 zeta omega sqrt(dt^3 / 12) = 0.18 mm/s rms a step, which
    # the first mode (4.3 Hz, 3 % damped) gathers over some 600 steps to 4 mm/s: 2 % of the 0.24 m/s of
    # the floors.
    np.testing.assert_allclose(reference[:, 1], expected[:, 1], rtol=1e-7, atol=1e-6)
    error = np.linalg.norm(reference[:, 0] - expected[:, 0]) / np.linalg.norm(expected[:, 0])
    assert error < 2e-2


@pytest.mark.parametrize("ends", [(1.0, 0.5), (-1.0, 2.0), (0.0, float("inf")), (float("nan"), 1.0)])
def test_ranges_are_checked(ends):
    with pytest.raises(ParameterError, match="uniform range"):
        Uniform(*ends)
