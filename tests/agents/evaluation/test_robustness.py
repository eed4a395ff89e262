"""Controllers on tables that they were not made for, against theory and against the other commands."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from agents.__main__ import main
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
    DEFAULT_BASELINES,
    Grid,
    controllers_with_sources,
    default_controllers,
    evaluate_perturbations,
    failed,
    robustness,
    without_nominal,
)
from agents.policies.policy_file import load_policy
from agents.policies.registry import shipped_policy
from agents.reporting.model_card import write_card
from agents.reporting.robustness_figures import draw_robustness
from agents.reporting.robustness_tables import (
    point_at,
    range_in_words,
    read_robustness,
    robustness_findings,
    robustness_markdown,
    robustness_section,
    write_robustness,
)
from agents.scenario_options import ScenarioOptions
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
    result = robustness(scenario, names, grid=Grid.of(scenario, ("amplitude",)), earthquakes=3)
    unchanged = point_at(result)
    for name, rows in compared.episodes.items():
        # Side by side with seven other amplitudes a matrix product rounds otherwise.
        assert unchanged["cost"][name] == pytest.approx(np.mean([r.cost for r in rows]), rel=1e-4)


def test_a_cost_does_not_depend_on_what_else_is_swept():
    scenario = make_scenario("linear", {"duration": 0.4})
    few = robustness(scenario, ("apg",), grid=Grid.of(scenario, ("delay",)), earthquakes=2)
    more = Grid.of(scenario, ("delay", "noise", "amplitude"))
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
        grid = Grid.of(scenario)
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
    grid = Grid.of(scenario)
    assert set(QUANTITIES) - set(grid.sweeps) == {"coulomb_friction", "delay"}
    quantities = ("mass_ratio", "damping_ratio")
    found = robustness(scenario, ("none",), grid=Grid.of(scenario, quantities, False), earthquakes=1)
    assert {name for point in found["points"] for name in point["changes"]} == set(quantities)
    with pytest.raises(ScenarioError, match="needs equations"):
        robustness(scenario, ("none",), grid=Grid.of(scenario, ("delay",), False), earthquakes=1)


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


def test_who_is_compared_unless_told_otherwise():
    for name, baselines in DEFAULT_BASELINES.items():
        assert set(default_controllers(make_scenario(name))) >= set(baselines)
    assert "apg" in default_controllers(make_scenario("laboratory"))
    chosen, sources = controllers_with_sources((), make_scenario("linear"))
    assert next(iter(chosen.controllers)) == "lqr"
    renamed = make_scenario("laboratory", {"fields": {"name": "mytable"}})
    assert default_controllers(renamed) == default_controllers(make_scenario("laboratory"))
    assert "lqr" not in sources
    assert len(sources["apg"]["sha256"]) == 64


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--controllers", "oracle"], "knows what is changed"),
        (["--controllers", "tf-iteration"], "repeats its tests"),
        (["--perturb", "mas_ratio"], "mass_ratio"),
        (["--earthquakes", "0"], "at least 1"),
        (["--all", "--perturb", "delay"], "contradicts --all"),
    ],
)
def test_mistakes_name_value_and_remedy(words, message, capsys):
    assert main(["robustness", *words]) == 2
    assert message in capsys.readouterr().err
    with pytest.raises(ScenarioError):
        Grid.of(make_scenario("linear"), ("weight",))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The command's result with a policy of a scenario that is too short to mean anything."""
    folder = tmp_path_factory.mktemp("robustness")
    words = ["robustness", "--controllers", "apg", "h-infinity", "--earthquakes", "2"]
    words += ["--duration", "0.6", "--perturb", "coulomb_friction", "delay", "--output", str(folder)]
    assert main(words) == 0
    return folder, read_robustness(folder / "robustness_linear.json")


def test_the_command_writes_result_and_figures(small):
    folder, result = small
    assert result["earthquakes"] == ["noise 5000000", "noise 5000001"]
    assert result["reference"] == "lqr"
    for name in ("robustness_linear", "robustness_linear_maps"):
        assert (folder / f"{name}.png").stat().st_size > 5000
        assert (folder / f"{name}.svg").exists()
    assert point_at(result, delay=1.0, coulomb_friction=300.0)["changes"] == {
        "coulomb_friction": 300.0,
        "delay": 1.0,
    }
    with pytest.raises(ParameterError, match="not in the result"):
        point_at(result, delay=1.23)
    again = folder / "copy.json"
    write_robustness(result, again)
    assert read_robustness(again) == result
    (folder / "other.json").write_text("{}")
    with pytest.raises(ParameterError, match="no result of shake robustness"):
        read_robustness(folder / "other.json")
    assert len(draw_robustness(result, folder / "png", svg=False)) == 2


def made_up(failures, cost):
    """A result of a sweep over three delays; failures and cost by controller."""
    points = [
        {
            "changes": {"delay": delay} if delay else {},
            "cost": {name: values[i] for name, values in cost.items()},
            "relative_cost": {name: values[i] / cost["lqr"][i] for name, values in cost.items()},
            "failures": {name: values[i] for name, values in failures.items()},
        }
        for i, delay in enumerate((0.0, 1.0, 2.0))
    ]
    delay = {"name": "delay", "title": "loop delay", "unit": "ms", "nominal": 0.0, "trained": None}
    return {
        "scenario": "linear", "reference": "lqr", "seed": 1, "version": "0", "code": None,
        "machine": "m",
        "controllers": [{"name": "lqr", "source": None}, {"name": "mine", "source": {"sha256": "1"}}],
        "earthquakes": ["a", "b"], "quantities": [{**delay, "values": [0.0, 1.0, 2.0]}], "maps": [],
        "points": points,
    }  # fmt: skip


def test_what_is_said_follows_from_the_numbers():
    result = made_up(
        {"lqr": [0, 0, 0], "mine": [0, 0, 2]}, {"lqr": [1.0, 1.0, 2.0], "mine": [0.9, 1.3, 99.0]}
    )
    failures, dearer = robustness_findings(result, "mine")
    assert re.findall(r"[\d.]*\d", failures) == ["2", "6", "2", "2"] and "loop delay" in failures
    assert re.findall(r"[\d.]*\d", dearer) == ["1", "1.30", "1"] and "loop delay" in dearer
    assert "lqr" in dearer
    assert "| loop delay, 0 to 2 ms | 0 ms | 1.00 | 0.90 to 1.30; lost at 2 ms |" in robustness_markdown(
        result
    )
    good = made_up(
        {"lqr": [0, 0, 1], "mine": [0, 0, 0]}, {"lqr": [1.0, 1.0, 9.0], "mine": [0.9, 0.8, 0.7]}
    )
    failures, dearer = robustness_findings(good, "mine")
    assert re.findall(r"[\d.]*\d", failures) == ["6"] and "none" in failures  # of the tests
    assert re.findall(r"[\d.]*\d", dearer) == ["2"] and "delay" not in dearer  # 2 %: nowhere


def test_values_in_words():
    values = [1.0, 2.0, 3.0, 4.0, 5.0]
    for chosen, words in (
        ("11111", "at every value"),
        ("11000", "up to 2 ms"),
        ("00011", "from 4 ms"),
        ("10000", "at 1 ms"),
        ("01110", "from 2 to 4 ms"),
        ("01001", "at 2 and at 5 ms"),
        ("00000", "nowhere"),
    ):
        assert range_in_words(values, [c == "1" for c in chosen], "ms") == words


def test_a_section_shows_the_table_and_what_was_found(small):
    _, result = small
    text = robustness_section(result)
    assert text.count("**apg.**") == 1 and robustness_markdown(result) in text


def test_a_card_says_where_its_policy_fails(small, tmp_path):
    folder, result = small
    file = tmp_path / "mine.safetensors"
    file.write_bytes(shipped_policy("apg").read_bytes())
    write_card(file, robustness=folder / "robustness_linear.json")
    text = file.with_suffix(".md").read_text()
    for sentence in robustness_findings(result, "apg"):
        assert f"- {sentence}" in text
    other = tmp_path / "other.safetensors"
    other.write_bytes(shipped_policy("ppo").read_bytes())
    with pytest.raises(ParameterError, match="does not hold this policy"):
        write_card(other, robustness=folder / "robustness_linear.json")
    assert load_policy(other).card  # and is a policy all the same


def test_a_report_shows_it(small, tmp_path, capsys):
    folder, result = small
    words = [
        "compare",
        "--controllers",
        "none",
        "--num-noise-motions",
        "2",
        "--no-records",
        "--duration",
        "5",
    ]
    file = str(folder / "robustness_linear.json")
    assert main([*words, "--report", str(tmp_path / "page"), "--json", "--robustness", file]) == 0
    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    assert page.count('<img src="data:image/png;base64,') == 2
    assert robustness_findings(result, "apg")[0].replace("'", "&#x27;") in page
    capsys.readouterr()
    other = ["--robustness", file, "--scenario", "laboratory"]
    for more, message in (
        (["--robustness", file], "give --report"),
        ([*other, "--report", str(tmp_path / "two")], "is of linear"),
    ):
        assert main([*words, *more]) == 2
        assert message in capsys.readouterr().err


def test_all_runs_what_does_not_hold_any_more(tmp_path, monkeypatch, capsys):
    """One scenario of one quantity, run, left alone, and run again when a cost is not what it was."""
    monkeypatch.chdir(tmp_path)
    assert main(["robustness", "--all"]) == 2
    assert "run --all in the project's folder" in capsys.readouterr().err
    monkeypatch.setattr("agents.cli.robustness.SHOWN", ("linear",))
    build = ScenarioOptions.build
    monkeypatch.setattr(ScenarioOptions, "build", lambda options: build(replace(options, duration=0.4)))
    monkeypatch.setattr("agents.evaluation.robustness.DEFAULT_BASELINES", {})
    monkeypatch.setattr("agents.evaluation.robustness.policies_trained_for", lambda _: ())
    page, file = tmp_path / "docs" / "robustness.md", tmp_path / "docs/results/robustness_linear.json"
    page.parent.mkdir()
    page.write_text("<!-- robustness linear -->\n<!-- end linear -->\n")
    one = {"damping_ratio": replace(QUANTITIES["damping_ratio"], values=(0.5, 1.0))}
    monkeypatch.setattr("agents.evaluation.robustness.QUANTITIES", one)
    words = ["robustness", "--all", "--no-maps", "--earthquakes", "1"]
    assert main(words) == 0
    assert "as before" not in capsys.readouterr().out
    assert "changed at a time](figures/robustness_linear.png)" in page.read_text()
    made = read_robustness(file)
    assert main(words) == 0
    assert "as before" in capsys.readouterr().out
    made["points"][0]["cost"]["lqr"] *= 1.01  # as under another random stream
    write_robustness(made, file)
    assert main(words) == 0
    assert "as before" not in capsys.readouterr().out


def test_one_json_object_on_standard_output(capsys):
    words = ["robustness", "--controllers", "none", "--earthquakes", "1", "--duration", "1"]
    assert main([*words, "--perturb", "damping_ratio", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    # A table that stands still has the error of the target itself, whatever the specimen.
    assert all(each["failures"]["none"] == 0 for each in found["points"])
