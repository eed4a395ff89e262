"""Controllers on tables that they were not made for, against theory and against each other."""

import numpy as np
import pytest

from agents.evaluation.comparison import compare
from agents.evaluation.perturbations import (
    QUANTITIES,
    NoisyState,
    nominal_value,
    observation_rescaling,
    perturb,
    perturbed_pair,
    training_range,
)
from agents.evaluation.robustness import (
    Grid,
    evaluate_perturbations,
    failed,
    robustness,
    without_nominal,
)
from agents.reporting.robustness_tables import (
    point_at,
)
from baselines.lqr.sampled import lqr, sampled_lqr, stationary_performance
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.simulation.simulation import Simulation

SHORT = {"duration": 1.5}


def perturbed(controller, scenario, earthquakes, changes):
    """Figures of one controller under every change."""
    return evaluate_perturbations({"one": controller}, scenario, earthquakes, changes)["one"]


@pytest.mark.parametrize(("mass", "frequency"), [(1.0, 7.0), (0.2, 7.0), (0.8, 5.0)])
def test_lqr_of_one_specimen_under_another_costs_what_lyapunov_says(mass, frequency):
    """Stationary cost of the mismatched loop, exact, against the mean over simulated earthquakes."""
    nominal = make_scenario("linear", {"duration": 40.0})
    values = {"mass_ratio": mass, "storey_frequency": frequency}
    true = perturb(nominal, values)
    gain = sampled_lqr(nominal.discrete, nominal.stage_cost).gain
    expected = stationary_performance(true.discrete, true.stage_cost, gain).cost
    quakes = noise_earthquakes(nominal, 24, 5_000_000)
    (rows,) = perturbed(lqr(nominal), nominal, quakes, [without_nominal(nominal, values)])
    cost = np.array([row.cost for row in rows])
    # Chance: four standard errors. The start from rest, a second of forty, is smaller than these.
    error = cost.std(ddof=1) / np.sqrt(len(cost))
    assert abs(cost.mean() - expected) < 4.0 * error
    assert error < 0.02 * expected  # so that a tenth more, as a wrong scale would give, is seen
    # The design for the true specimen costs less: what is simulated is a mismatch.
    assert sampled_lqr(true.discrete, true.stage_cost).analytic_cost < 0.95 * expected


def test_what_is_not_changed_costs_what_shake_compare_says():
    scenario = make_scenario("laboratory", SHORT)
    names = ("lqg-dac", "apg")
    compared = compare(scenario, names, noise=3, records=False, seed=5_000_000)
    result = robustness(
        scenario, names, grid=Grid.from_scenario(scenario, ("amplitude",)), earthquakes=3
    )
    unchanged = point_at(result)
    for name, rows in compared.episodes.items():
        # Side by side with seven other amplitudes a matrix product rounds otherwise.
        assert unchanged["cost"][name] == pytest.approx(np.mean([r.cost for r in rows]), rel=1e-4)


def test_a_cost_does_not_depend_on_what_else_is_swept():
    scenario = make_scenario("linear", {"duration": 0.4})
    few = robustness(scenario, ("apg",), grid=Grid.from_scenario(scenario, ("delay",)), earthquakes=2)
    more = Grid.from_scenario(scenario, ("delay", "noise", "amplitude"))
    assert len(more.maps) == 1
    many = robustness(scenario, ("apg",), grid=more, earthquakes=2)
    for delay in (0.0, 1.0):
        for name in ("lqr", "apg"):
            expected = point_at(few, delay=delay)["cost"][name]
            assert point_at(many, delay=delay)["cost"][name] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["linear", "laboratory", "unknown-specimen", "yielding"])
def test_a_controller_is_shown_si_in_the_nominal_scale(name):
    """A true observation, rescaled, is the true state over the nominal scale."""
    nominal = make_scenario(name, SHORT)
    values = {"coulomb_friction": 77.0, "delay": 3.0, "damping_ratio": 0.02}
    if not nominal.uncertainty.active:
        values |= {"mass_ratio": 0.3, "storey_frequency": 5.0}
    true = perturb(nominal, values)
    simulation = Simulation(true, 1)
    observation = simulation.start([0], [np.random.default_rng(1)])
    for action in (0.2, -0.1, 0.3):
        observation = simulation.step(np.array([action])).observation
    seen = (observation * observation_rescaling(true, nominal))[0]
    if nominal.sensing.full_state:
        table = slice(nominal.plant.layout.filter_states, nominal.plant.layout.filter_states + 4)
        si = seen[table] * nominal.plant.state_scale[table]
        assert si == pytest.approx(simulation.state[0, :4], rel=1e-5, abs=1e-12)
    else:
        raw = observation[0, true.observation.readings] * true.observation.reading_scale
        si = seen[nominal.observation.readings] * nominal.observation.reading_scale
        assert si == pytest.approx(raw, rel=1e-5)
    assert true.observation.size == nominal.observation.size


def test_values_hold_what_they_are_made_for_and_reach_beyond_training():
    for name in ("linear", "laboratory", "unknown-specimen", "yielding"):
        scenario = make_scenario(name)
        grid = Grid.from_scenario(scenario)
        assert set(grid.sweeps) == set(QUANTITIES)
        for each, values in grid.sweeps.items():
            assert nominal_value(scenario, each) in values
            assert list(values) == sorted(set(values))
            if trained := training_range(scenario, each):
                assert values[0] < trained[0] < trained[1] < values[-1]
        assert grid.changes(scenario)[0] == ()
        assert len(set(grid.changes(scenario))) == len(grid.changes(scenario))


def test_printed_equations_have_neither_friction_nor_delay():
    scenario = make_scenario("as-printed", {"duration": 0.4})
    grid = Grid.from_scenario(scenario)
    assert set(QUANTITIES) - set(grid.sweeps) == {"coulomb_friction", "delay"}
    quantities = ("mass_ratio", "damping_ratio")
    found = robustness(
        scenario, ("none",), grid=Grid.from_scenario(scenario, quantities, False), earthquakes=1
    )
    assert {name for point in found["points"] for name in point["changes"]} == set(quantities)
    with pytest.raises(ScenarioError, match="needs equations"):
        robustness(
            scenario, ("none",), grid=Grid.from_scenario(scenario, ("delay",), False), earthquakes=1
        )


def test_a_drawn_quantity_is_held_and_the_others_stay_drawn():
    scenario = make_scenario("unknown-specimen", SHORT)
    true = perturb(scenario, {"mass_ratio": 1.5})
    for seed in range(3):
        before = scenario.drawn(np.random.default_rng(seed)).specimen
        after = true.drawn(np.random.default_rng(seed)).specimen
        assert after.mass == pytest.approx(1.5 * scenario.actuator.table_mass)
        # The same seed draws the same storey frequency as without the change.
        for specimen, other in ((before, after),):
            one, two = (s.stiffnesses[0] / s.masses[0] for s in (specimen, other))
            assert one == pytest.approx(two)
    assert without_nominal(scenario, {"mass_ratio": 0.55}) == (
        ("mass_ratio", 0.55),
    )  # drawn: not as it is
    assert without_nominal(scenario, {"delay": 2.5}) == ()


def test_noise_on_a_state_is_white_and_each_lanes_own():
    scenario = make_scenario("linear")
    heard = []

    class Listener:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            heard.append(observation.copy())
            return np.zeros((len(observation), 1), dtype=np.float32), None

    measured = scenario.plant.layout.controlled
    noisy = NoisyState(Listener(), 0.03, measured, (5, 6))
    memory = None
    still = np.zeros((2, scenario.observation.size), dtype=np.float32)
    for _ in range(500):
        _, memory = noisy.predict(still, memory)
    together = np.array(heard)
    others = np.delete(together, np.r_[measured], axis=-1)
    assert not others.any()  # the target and what follows from it are known
    noise = together[:, :, measured]
    # 500 x 8 draws a lane: the relative error of their rms is 1 %.
    assert np.sqrt(np.mean(noise**2, axis=(0, 2))) == pytest.approx(0.03, rel=0.05)
    heard.clear()
    alone, memory = NoisyState(Listener(), 0.03, measured, (6,)), None
    for _ in range(5):
        _, memory = alone.predict(still[:1], memory)
    assert np.array_equal(np.array(heard)[:, 0], together[:5, 1])
    with pytest.raises(ParameterError, match="needs 1 lanes"):
        alone.predict(still, None)


def test_lost_tests_are_counted():
    """A loop that a delay makes unstable, and a motion larger than the stroke."""
    linear = make_scenario("linear", {"duration": 4.0})
    quakes = noise_earthquakes(linear, 3, 5_000_000)
    held, gone = perturbed(lqr(linear), linear, quakes, [(), (("delay", 7.0),)])
    assert [failed(row) for row in held] == [False] * 3
    assert [failed(row) for row in gone] == [True] * 3
    yielding = make_scenario("yielding")
    quakes = noise_earthquakes(yielding, 2, 5_000_000)
    law = make_baseline("preview-lqr", yielding)
    (gone,) = perturbed(law, yielding, quakes, [(("amplitude", 4.0),)])
    assert [row.broken_limit is not None for row in gone] == [failed(row) for row in gone] == [True] * 2


def test_an_unchanged_scenario_has_its_own_controller_and_noise():
    scenario = make_scenario("laboratory", SHORT)
    law = make_baseline("lqg", scenario)
    true, unaware = perturbed_pair(law, scenario, {}, [1])
    assert unaware is law and true == scenario
    quieter = perturb(scenario, {"noise": 0.0}).sensing.sensors
    assert all(sensor.noise == sensor.bias == 0.0 for sensor in quieter)
    quakes = noise_earthquakes(scenario, 2, 5_000_000)
    loud, _ = rollout(law, perturb(scenario, {"noise": 20.0}), quakes)
    usual, _ = rollout(law, scenario, quakes)
    assert all(a.cost > b.cost for a, b in zip(loud, usual, strict=True))
