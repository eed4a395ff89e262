"""The law that finds out which specimen stands on the table."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.estimation.adaptive import CertaintyEquivalence, certainty_equivalence
from baselines.estimation.specimen_bank import SpecimenBank, arriving_law
from baselines.estimation.table_observer import SIGNALS, TableObserver
from baselines.iterative.drive_file import DriveFile
from baselines.lqr.oracle import oracle_controller
from baselines.lqr.preview import PreviewFeedback, preview_lqr
from shake_env import Sensing, Sensor, Uncertainty, make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.rollout import noise_earthquakes, rollout, sampled_plants
from shake_env.scenario.observation import STATE_SIGNALS

CLEAN = Sensing(sensors=tuple(Sensor(signal=name) for name in SIGNALS), preview=0.1)


@pytest.fixture(scope="module")
def unknown():
    return make_scenario("unknown-specimen", {"duration": 5.0})


@pytest.fixture(scope="module")
def bank(unknown):
    return SpecimenBank.from_scenario(unknown, position=0.05)


class Watched:
    """A controller whose last memory is kept."""

    def __init__(self, controller):
        self.controller, self.memory = controller, None

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, self.memory = self.controller.predict(observation, state, episode_start, deterministic)
        return action, self.memory


@pytest.mark.parametrize("sensing", [CLEAN, Sensing(preview=0.1)], ids=["signals", "full state"])
def test_it_finds_the_specimen_within_seconds_of_shaking(unknown, bank, sensing):
    scenario = replace(unknown, sensing=sensing)
    quakes = noise_earthquakes(scenario, 6, seed=40)
    law = CertaintyEquivalence(scenario, bank)
    watched = Watched(law)
    rollout(watched, scenario, quakes)
    mass, frequency = law.estimate(watched.memory[0])
    true = [p.specimen.uniform_values() for p in sampled_plants(scenario, quakes)]
    true_frequency = np.array([t["storey_frequency"] for t in true])
    true_mass = np.array([t["mass_ratio"] for t in true])
    # Half a step of the frequency's grid is 0.125 Hz. At low frequencies the shear tells the total mass,
    # at the specimen's modes the stiffness; a frequency that is half a step off is paid for by the mass.
    assert np.max(np.abs(frequency - true_frequency)) < 0.13
    np.testing.assert_allclose(mass, true_mass, rtol=0.12)
    # Of what the prior left open nine tenths are gone, on average.
    assert np.mean(np.abs(mass - true_mass)) < 0.1 * np.mean(np.abs(0.55 - true_mass))


def test_before_any_shaking_it_believes_the_prior(unknown, bank):
    law = CertaintyEquivalence(unknown, bank)
    _, memory = law.predict(np.zeros((2, unknown.observation.size), dtype=np.float32))
    weight, mass = law.posterior(memory[0])
    np.testing.assert_allclose(weight, 1.0 / 17.0)
    np.testing.assert_allclose(mass, 0.55)


def test_finding_out_is_worth_something_and_knowing_more(unknown, bank):
    quakes = noise_earthquakes(unknown, 8, seed=60)
    adaptive, _ = rollout(CertaintyEquivalence(unknown, bank), unknown, quakes)
    fixed = replace(unknown, uncertainty=Uncertainty())
    nominal, _ = rollout(CertaintyEquivalence(fixed, position=0.05), unknown, quakes)
    seen, knows = oracle_controller(unknown, quakes)
    floor, _ = rollout(knows, seen, quakes)
    means = [np.mean([row.cost for row in rows]) for rows in (floor, adaptive, nominal)]
    assert means[0] < means[1] < means[2]
    shears = [np.median([row.base_shear_rms_error for row in rows]) for rows in (adaptive, nominal)]
    assert shears[0] < 0.7 * shears[1]


def test_one_candidate_without_delay_is_preview_lqr():
    scenario = replace(make_scenario("yielding"), uncertainty=Uncertainty())
    row = arriving_law(scenario, None)
    expected = PreviewFeedback(scenario).row * scenario.current_limit
    expected[: len(scenario.plant.state_scale)] /= scenario.plant.state_scale
    expected[scenario.observation.preview] /= np.sqrt(scenario.plant.target_variance)
    np.testing.assert_allclose(row[:-1], expected, rtol=1e-12)
    assert row[-1] == 0.0


def test_prediction_makes_up_for_the_delay():
    """A known plant, half a control period late: nearly the cost of the law that has no delay."""
    base = make_scenario("unknown-specimen", {"duration": 5.0})
    base = replace(base, uncertainty=Uncertainty(), sensing=Sensing(preview=0.1))
    quakes = noise_earthquakes(base, 4, seed=9)
    costs = []
    for delay in (0.0, 2.5):
        scenario = replace(base, delay=delay)
        rows, _ = rollout(CertaintyEquivalence(scenario, position=0.05), scenario, quakes)
        costs.append(np.mean([row.cost for row in rows]))
    # Left is what the straight lines between samples of a rough target cost.
    assert costs[1] < 1.15 * costs[0]


def test_laws_run_straight_between_the_grids_masses(unknown, bank):
    f, m = len(bank.frequencies), len(bank.mass_ratios)
    at = np.tile(bank.mass_ratios[2], (3, f))
    np.testing.assert_allclose(
        bank.law(at), np.broadcast_to(bank.laws[:, 2], (3, f, bank.laws.shape[2]))
    )
    between = np.full(f, 0.5 * (bank.mass_ratios[m - 2] + bank.mass_ratios[m - 1]))
    np.testing.assert_allclose(bank.law(between), 0.5 * (bank.laws[:, -2] + bank.laws[:, -1]))
    # The ends hold beyond the range, where nothing was designed.
    np.testing.assert_allclose(bank.law(np.full(f, 9.0)), bank.laws[:, -1])


def test_lanes_do_not_know_of_each_other_and_start_afresh(unknown, bank):
    law = CertaintyEquivalence(unknown, bank)
    stream = np.random.default_rng(0)
    shown = stream.standard_normal((20, 3, unknown.observation.size)).astype(np.float32)
    memory, alone, begun = None, None, None
    for t, observation in enumerate(shown):
        start = np.array([t == 0, t in (0, 10), t == 0])
        action, memory = law.predict(observation, memory, start)
        single, alone = law.predict(observation[0], alone)
        np.testing.assert_allclose(single, action[0], rtol=1e-6)
        if t >= 10:
            late, begun = law.predict(observation[1], begun)
            np.testing.assert_allclose(late, action[1], rtol=1e-6)
    assert single.shape == (1,) and action.shape == (3, 1) and np.all(np.abs(action) <= 1.0)


def test_the_tables_observer_follows_a_table_whose_base_shear_is_given():
    """True signals of a table with a loop delay, from a wrong start: what is left is the sampling's."""
    scenario = replace(make_scenario("unknown-specimen", {"duration": 3.0}), uncertainty=Uncertainty())
    observer = TableObserver.from_scenario(scenario, shear_error=10.0)
    smooth = 0.3 * np.sin(2.0 * np.pi * 2.0 * np.arange(600) * scenario.control_period)
    _, histories = rollout(DriveFile(smooth), scenario, noise_earthquakes(scenario, 1), record=[0])
    one, k = histories[0], scenario.substeps
    shear, acceleration = one.base_shear[k - 1 :: k], one.table_acceleration[k - 1 :: k]
    scale = scenario.plant.state_scale[scenario.plant.layout.actuator]
    places = [STATE_SIGNALS[name] for name in SIGNALS[:-1]]
    estimate = 0.1 * scale[None]
    for t in range(2, len(one.current)):
        readings = np.append(one.state[t, places], acceleration[t])[None]
        commands = one.current[[t, t - 1]][None]
        estimate = observer.update(estimate, commands, shear[[t - 1, t]][None], readings)
        if t == 2:
            first = np.abs(estimate[0] - one.state[2, :4]) / scale
    error = np.abs(estimate[0] - one.state[t, :4]) / scale
    assert np.max(first) > 0.02 and np.max(error) < 2e-3


def test_its_gain_at_a_candidate_is_the_candidates(unknown):
    """The stationary LQR part of the law: predicted through no delay it is that specimen's design."""
    scenario = replace(unknown, delay=0.0)
    bank = SpecimenBank.from_scenario(scenario, frequencies=2, masses=2)
    plant = replace(
        scenario, specimen=type(scenario.specimen).uniform(mass_ratio=1.0, storey_frequency=5.0)
    )
    design = preview_lqr(plant.discrete, plant.stage_cost, 0.1)
    n = len(design.gain)
    size = REFERENCE_CURRENT / plant.plant.state_scale
    np.testing.assert_allclose(bank.laws[0, 1, :n] / size, -design.gain / size, rtol=1e-9, atol=1e-9)


def test_what_does_not_suit_it_is_refused(unknown, bank):
    with pytest.raises(ScenarioError, match="table_acceleration"):
        few = Sensing(sensors=(Sensor(signal="load_pressure"),))
        CertaintyEquivalence(replace(unknown, sensing=few), bank)
    with pytest.raises(ScenarioError, match="uncertainty"):
        certainty_equivalence(replace(unknown, uncertainty=Uncertainty()))
    with pytest.raises(ScenarioError, match="delay"):
        SpecimenBank.from_scenario(replace(unknown, delay=6.0), frequencies=2, masses=2)
    with pytest.raises(ParameterError, match="grid"):
        SpecimenBank.from_scenario(unknown, masses=1)
    with pytest.raises(ParameterError, match="floor"):
        CertaintyEquivalence(unknown, bank, floor=0.0)


def test_what_was_given_counts_and_not_what_was_asked():
    """A supervisor's changes are in the last action that the scenario shows."""
    scenario = make_scenario("unknown-specimen")
    shown = scenario.observation
    assert shown.sensing.last_action
    controller = certainty_equivalence(scenario)
    observation = np.zeros((1, shown.size), dtype=np.float32)
    _, state = controller.predict(observation)
    observation[:, shown.last_action] = 0.25
    _, told = controller.predict(observation, state)
    assert told[0].commands[0, 1] == pytest.approx(0.25 * scenario.current_limit)
