"""Scenarios by name, with parts and fields changed; limits that cost before they end an episode."""

import numpy as np
import pytest

from agents.scenario_options import ScenarioOptions, assignment
from shake_env import RECORD_NAMES, Limits, MotionSet, RecordedMotion, Uniform, make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.scenario.builder import with_fields
from shake_env.scenario.limits import REASONS
from shake_env.simulation.simulation import Simulation


def test_any_field_by_its_path():
    scenario = make_scenario(
        "laboratory",
        {
            "fields": {
                "nonlinearity.friction.coulomb": 300.0,
                "nonlinearity.valve.natural_frequency": 60.0,
                "sensing.preview": 0.2,
                "sensing.sensors.load_pressure.noise": 5e4,
                "uncertainty.mass_ratio": [0.2, 0.4],
                "motion.envelope": None,
                "actuator.leakage": 1e-12,
                "delay": 4,
            }
        },
    )
    assert scenario.nonlinearity.friction.coulomb == 300.0
    assert scenario.nonlinearity.valve.natural_frequency == 60.0
    assert scenario.nonlinearity.valve.spool_limit == 2e-5  # the rest of the part stays
    assert scenario.observation.preview_samples == 200
    noise = dict(
        zip(scenario.observation.reading_names, scenario.observation.sensor_values("noise"), strict=True)
    )
    assert noise["load_pressure"] == 5e4 and noise["table_velocity"] == pytest.approx(6.5e-4)
    assert scenario.uncertainty.mass_ratio == Uniform(0.2, 0.4)
    assert scenario.motion.envelope is None
    assert scenario.plant.actuator.leakage == 1e-12


def test_a_part_that_is_none_is_made_of_a_mapping():
    scenario = make_scenario("linear", {"fields": {"motion.envelope": {"rise": 1.0, "hold": 2.0}}})
    assert scenario.motion.envelope.rise == 1.0 and scenario.motion.envelope.decay_rate == 0.3


def test_one_list_of_a_specimen_decides_the_number_of_storeys():
    plain = make_scenario("linear").specimen
    specimen = make_scenario("linear", {"fields": {"specimen.masses": [60.0, 40.0, 20.0]}}).specimen
    assert specimen.masses == (60.0, 40.0, 20.0)
    assert specimen.stiffnesses == plain.stiffnesses[:1] * 3
    assert specimen.dampings == plain.dampings[:1] * 3
    lists = {"masses": [60.0, 40.0, 20.0], "stiffnesses": [6e4, 4e4, 2e4], "dampings": [9.0, 8.0, 7.0]}
    uneven = make_scenario("linear", {"fields": {f"specimen.{k}": v for k, v in lists.items()}})
    assert uneven.specimen.dampings == (9.0, 8.0, 7.0)
    with pytest.raises(ParameterError, match="same number of storeys"):
        make_scenario(uneven, {"fields": {"specimen.masses": [1.0, 2.0]}})


def test_a_name_of_results_says_which_scenario_it_stands_for():
    with pytest.raises(ScenarioError, match=r"linear with --set nonlinearity.*=300; .*known"):
        make_scenario("friction")


def test_fields_of_a_part_are_checked_together():
    fields = {"nonlinearity.friction.static": 90.0, "nonlinearity.friction.coulomb": 50.0}
    friction = make_scenario("laboratory", {"fields": fields}).nonlinearity.friction
    assert (friction.static, friction.coulomb) == (90.0, 50.0)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("nonlinearity.frictoin.coulomb", 1.0, "did you mean 'friction'"),
        ("nonlinearity.friction.coulomb.value", 1.0, "has no fields"),
        ("nonlinearity.friction", 150.0, "name one of its fields"),
        ("sensing.sensors.sped.noise", 1.0, "known: "),
        ("tempo", 1.0, "known: "),
    ],
)
def test_a_path_that_leads_nowhere(path, value, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("laboratory", {"fields": {path: value}})


def test_a_field_outside_its_range_is_named():
    with pytest.raises(ParameterError, match="coulomb"):
        with_fields(make_scenario(), {"nonlinearity.friction.coulomb": -3.0})


def test_command_line_assignments():
    assert assignment("a.b=1e-3") == ("a.b", 1e-3)
    assert assignment("a=[0.1, 1]") == ("a", [0.1, 1])
    assert assignment("a=none") == ("a", None) and assignment("a=inf") == ("a", np.inf)
    assert assignment("motion.record=x") == ("motion.record", "x")
    with pytest.raises(ScenarioError, match="PATH=VALUE"):
        assignment("friction")
    options = ScenarioOptions(
        scenario="laboratory", set=("nonlinearity.friction.coulomb=42",), delay=3.0
    )
    built = options.build()
    assert built.nonlinearity.friction.coulomb == 42 and built.delay == 3.0


def test_a_table_as_a_field_is_refused_for_it_changes_a_name_alone():
    for scenario in ("linear", "laboratory"):
        with pytest.raises(ScenarioError, match="--table NAME"):
            make_scenario(scenario, {"fields": {"table": "lnec-uniaxial"}})
    own = make_scenario("laboratory", {"fields": {"table": "gavin-hoagg-2009"}})  # as it is
    assert own == make_scenario("laboratory")
    lnec = make_scenario("laboratory", {"table": "lnec-uniaxial"})
    assert make_scenario(lnec, {"fields": {"table": "lnec-uniaxial"}}) == lnec


def test_a_record_for_a_limited_table_is_scaled_to_it_unless_told():
    name = RECORD_NAMES[0]
    fitted = make_scenario("laboratory", {"record": name}).motion
    assert 0.1 < fitted.amplitude < 1.0
    assert make_scenario("laboratory", {"record": name, "amplitude": 1.0}).motion.amplitude == 1.0
    assert make_scenario("linear", {"record": name}).motion.amplitude == 1.0


def test_a_motion_set_draws_every_motion_from_the_episodes_stream():
    scenario = make_scenario("records")
    assert isinstance(scenario.motion, MotionSet) and len(scenario.motion.motions) == 6
    simulation = Simulation(make_scenario("records", {"duration": 1.0}), 60)
    simulation.start(range(60), [np.random.default_rng(i) for i in range(60)])
    drawn = [motion.record for motion in simulation.engine.motions]
    assert set(drawn) == set(RECORD_NAMES)
    again = scenario.motion.pick(np.random.default_rng(7))
    assert again.record == drawn[7]
    half = make_scenario("records", {"amplitude": 0.5}).motion
    assert half.scaled[0].amplitude == pytest.approx(0.5 * scenario.motion.motions[0].amplitude)
    with pytest.raises(ParameterError, match="motions"):
        MotionSet(())


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ({"limits.current": 0.01}, "current"),
        ({"limits.specimen_acceleration": 0.5}, "specimen_acceleration"),
    ],
)
def test_new_interlocks_end_the_episode_with_their_reason(limits, reason):
    scenario = make_scenario("linear", {"fields": limits})
    simulation = Simulation(scenario, 2)
    simulation.start(range(2), [np.random.default_rng(i) for i in range(2)])
    for _ in range(200):
        result = simulation.step(np.array([0.0, 0.3]))  # 37.5 mA
        if result.terminated.any():
            break
    assert result.terminated.tolist() == [False, True]
    assert REASONS[result.outcome.broken[1] - 1] == reason


def test_soft_limits_cost_quadratically_between_share_and_limit():
    limits = Limits(table_displacement=0.1, table_velocity=1.0, soft_share=0.8, soft_weight=2.0)
    state = np.zeros((4, 8))
    state[:, 1] = [0.05, 0.08, -0.09, 0.1]
    found = limits.soft_cost(state, np.zeros((4, 5)))
    np.testing.assert_allclose(found, [0.0, 0.0, 2.0 * 0.25, 2.0], atol=1e-12)
    assert not Limits().soft_cost(state, np.zeros((4, 5))).any()
    with pytest.raises(ParameterError, match="soft_share"):
        Limits(soft_share=1.0)


def test_a_soft_limit_shows_in_reward_and_info():
    import gymnasium

    env = gymnasium.make("shake_env:ShakeTable-v0", fields={
        "limits.table_velocity": 0.2, "limits.soft_weight": 3.0, "limits.soft_share": 0.1,
    })  # fmt: skip
    env.reset(seed=0)
    for _ in range(5):
        _, reward, terminated, _, info = env.step(np.array([0.05], dtype=np.float32))
    assert info["soft_limit_cost"] > 0.0 and not terminated
    terms = ("acceleration_cost", "force_cost", "current_cost", "limit_cost", "soft_limit_cost")
    assert -reward == pytest.approx(sum(info[name] for name in terms))


def test_the_mean_motion_of_a_record_keeps_its_own_amplitude():
    motion = RecordedMotion(record=RECORD_NAMES[1], amplitude=0.7)
    assert motion.pick(np.random.default_rng(0)) is motion


def test_every_named_scenario_has_its_page():
    from pathlib import Path

    from shake_env import SCENARIO_NAMES

    folder = Path(__file__).parents[3] / "docs" / "scenarios"
    pages = {page.stem for page in folder.glob("*.md")} - {"README"}
    assert pages == set(SCENARIO_NAMES)
    index = (folder / "README.md").read_text(encoding="utf-8")
    assert all(f"[`{name}`]({name}.md)" in index for name in SCENARIO_NAMES)


def test_scenario_command_prints_every_field(capsys):
    import json

    from agents.__main__ import main

    assert (
        main(["show-scenario", "--scenario", "laboratory", "--set", "sensing.preview=0.2", "--json"])
        == 0
    )
    shown = json.loads(capsys.readouterr().out)
    assert shown["fields"]["nonlinearity.friction.coulomb"] == 150.0
    assert shown["fields"]["sensing.preview"] == 0.2
    assert len(shown["observation"]) == 4 + 5 + 200 + 1
    numbers = (path for path, value in shown["fields"].items() if isinstance(value, float))
    path = next(p for p in numbers if p.startswith("nonlinearity.friction"))
    again = make_scenario("laboratory", {"fields": {path: shown["fields"][path]}})
    assert again == make_scenario("laboratory")


def test_the_noise_of_a_limited_table_does_not_scale_its_records():
    from shake_env.rollout import record_amplitude, recorded_earthquakes

    laboratory, linear = make_scenario("laboratory"), make_scenario("linear", {"amplitude": 0.5})
    assert record_amplitude(laboratory) == 1.0 and record_amplitude(linear) == 0.5
    factors = [quake.motion.amplitude for quake in recorded_earthquakes(laboratory)]
    assert min(factors) < 0.7 and max(factors) <= 1.0


def test_validation_takes_the_linear_part_of_any_scenario():
    from agents.cli.studies.validate_transients import linear_part
    from baselines.lqr.sampled import lqr, sampled_lqr

    for name in ("laboratory", "unknown-specimen", "yielding"):
        part = linear_part(make_scenario(name))
        assert not part.nonlinearity.active and not part.uncertainty.active and part.delay == 0.0
        # The full state is shown: every entry of the observation acts as the gain says.
        gain = sampled_lqr(part.discrete, part.stage_cost).gain * part.plant.state_scale
        for entry in range(len(gain)):
            observation = np.zeros(part.observation.size)
            observation[entry] = 0.1 * part.current_limit / np.max(np.abs(gain))
            wanted = -gain[entry] * observation[entry] / part.current_limit
            assert lqr(part).predict(observation)[0] == pytest.approx(wanted, rel=1e-5, abs=1e-12)
        assert part.observation.size == len(gain)
    assert linear_part(make_scenario()) == make_scenario()


def test_compare_reports_how_often_a_supervisor_acted(tmp_path, capsys):
    import json

    from agents.__main__ import main

    arguments = ["compare", "--scenario", "laboratory", "--sensing", "full", "--delay", "2.5"]
    arguments += [
        "--controllers",
        "lqr",
        "none",
        "--num-noise-motions",
        "2",
        "--no-records",
        "--duration",
        "4",
    ]
    assert main([*arguments, "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert main([*arguments, "--safety-supervisor", "--json"]) == 0
    held = json.loads(capsys.readouterr().out)
    ended = [[row["broken_limit"] for row in found["episodes"]["lqr"]] for found in (alone, held)]
    assert None not in ended[0] and ended[1] == [None, None]  # LQR does not know of the delay
    assert held["interventions"]["lqr"] > 0.1 and held["interventions"]["none"] == 0.0
    assert alone["interventions"] == {}
