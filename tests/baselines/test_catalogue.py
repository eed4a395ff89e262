"""Every controller by its name: it suits a scenario or says why not; the bench's tables."""

import json
import math
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from agents.__main__ import main
from agents.evaluation.comparison import compare
from agents.reporting.benchmark_tables import benchmark_markdown, put_tables
from agents.reporting.comparison_tables import print_tables
from baselines.catalogue import BASELINES
from baselines.lqr.sampled import sampled_lqr, stationary_performance
from baselines.registry import make_baseline, reference_name, tuned_parameters
from shake_env import SCENARIO_NAMES, make_scenario
from shake_env.errors import NumericalError, ParameterError, ScenarioError
from shake_env.rollout import noise_earthquakes, rollout

ROOT = Path(__file__).parents[2]
SHORT = {
    name: make_scenario(name, {"duration": 0.6})
    for name in ("linear", "laboratory", "unknown-specimen", "yielding")
}
# What each scenario cannot take, with the reason in its error.
REFUSED = {
    ("laboratory", "lqr"): "full state",
    ("unknown-specimen", "lqr"): "full state",
    ("laboratory", "lqr-continuous"): "full state",
    ("unknown-specimen", "lqr-continuous"): "full state",
    ("laboratory", "preview-lqr"): "full state",
    ("unknown-specimen", "preview-lqr"): "full state",
    ("linear", "lqr-friction-ff"): "nothing to feed forward",
    ("unknown-specimen", "lqr-friction-ff"): "nothing to feed forward",
    ("yielding", "lqr-friction-ff"): "nothing to feed forward",
    ("linear", "mpc"): "without limits",
    ("linear", "nmpc"): "preview-lqr",
    **{
        (scenario, name): "nothing to estimate"
        for scenario in ("linear", "yielding")
        for name in ("lqg", "lqg-dac")
    },
    **{
        (scenario, name): "uncertainty"
        for scenario in ("linear", "laboratory", "yielding")
        for name in ("multi-model", "adaptive", "nmpc-adaptive")
    },
}


# Made for other plants or equations: with their written rules these cost more than an idle table.
WORSE_THAN_NONE = {("linear", "lqr-continuous"), ("linear", "mcs"), ("yielding", "lqr-continuous")}
REFERENCES = {
    "linear": "lqr", "as-printed": "lqr", "yielding": "preview-lqr",
    "laboratory": "lqg", "unknown-specimen": "lqg", "records": "lqg", "field": "lqg",
}  # fmt: skip


@cache
def idle_rows(scenario_name):
    scenario = SHORT[scenario_name]
    quakes = noise_earthquakes(scenario, 2, seed=1)
    return rollout(make_baseline("none", scenario), scenario, quakes)[0]


@pytest.mark.parametrize("name", BASELINES)
def test_every_controller_drives_what_suits_it(name):
    for scenario_name, scenario in SHORT.items():
        quakes = noise_earthquakes(scenario, 2, seed=1)
        if (scenario_name, name) in REFUSED:
            with pytest.raises(ScenarioError, match=REFUSED[scenario_name, name]):
                make_baseline(name, scenario, {}, quakes)
            continue
        rows, _ = rollout(make_baseline(name, scenario, {}, quakes), scenario, quakes)
        costs, idle = ([row.cost for row in each] for each in (rows, idle_rows(scenario_name)))
        assert np.all(np.isfinite(costs)), scenario_name
        if name == "none":
            assert costs == idle
        elif scenario_name in ("linear", "yielding"):
            assert (sum(costs) < sum(idle)) == ((scenario_name, name) not in WORSE_THAN_NONE), (
                scenario_name
            )
        else:
            # The start of a test is too weak to overcome the friction well: no controller need win it.
            assert np.all(np.not_equal(costs, idle)), scenario_name
            assert [row.broken_limit for row in rows] == [None, None], scenario_name


def test_a_controller_that_repeats_its_tests_needs_them():
    with pytest.raises(ScenarioError, match="repeats its tests"):
        make_baseline("ilc", SHORT["linear"])


def test_the_reference_always_suits():
    for name in SCENARIO_NAMES:
        scenario = make_scenario(name)
        assert reference_name(scenario) == REFERENCES[name]
        controller = make_baseline(REFERENCES[name], scenario)
        observation = np.full(scenario.observation.size, 1e-3, dtype=np.float32)
        action, _ = controller.predict(observation, None, np.array([True]))
        assert action.shape == (1,) and 0.0 < abs(action[0]) <= 1.0, name


def test_nothing_is_tuned_on_the_records():
    for name in BASELINES:
        records, laboratory = make_scenario("records"), make_scenario("laboratory")
        assert tuned_parameters(name, records) == tuned_parameters(name, laboratory)


def test_no_tuned_value_is_at_an_end_that_the_range_alone_sets():
    """A search that comes to such an end would have gone further: its controller is not the best."""
    for scenario in SCENARIO_NAMES:
        for name, baseline in BASELINES.items():
            for each, value in tuned_parameters(name, make_scenario(scenario)).items():
                tunable = baseline.tunable[each]
                low, high, at = tunable.low, tunable.high, value
                if tunable.logarithmic:
                    low, high, at = math.log(low), math.log(high), math.log(value)
                share = (at - low) / (high - low)
                assert 0.0 <= share <= 1.0, (scenario, name, each)
                assert share > 0.02 or tunable.natural == "low", (scenario, name, each, value)
                assert share < 0.98 or tunable.natural == "high", (scenario, name, each, value)


def test_the_page_names_every_controller():
    page = (ROOT / "docs" / "controllers.md").read_text(encoding="utf-8")
    for name in BASELINES:
        assert f"`{name}`" in page, name


def test_bench_writes_results_and_renews_a_page(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("agents.evaluation.benchmark.make_scenario", lambda name: SHORT[name])
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- bench yielding -->\nold\n<!-- end yielding -->\nafter\n")
    kept = {name: BASELINES[name] for name in ("none", "preview-lqr", "pid")}
    monkeypatch.setattr("agents.evaluation.controller_set.BASELINES", kept)
    arguments = ["benchmark", "--scenarios", "yielding", "--earthquakes", "2"]
    assert main([*arguments, "--results", str(tmp_path), "--page", str(page)]) == 0
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    names = re.findall(r"^\| ([\w-]+) \|", text, re.MULTILINE)
    assert names[:2] == ["controller", "oracle"]
    assert set(names) >= {"oracle", "preview-lqr", "pid", "none"}
    assert names[-1] == "none"
    capsys.readouterr()
    (file,) = tmp_path.glob("*.json")
    before = file.stat().st_mtime_ns
    monkeypatch.setattr("agents.evaluation.benchmark.compare", None)  # done before: read, not run
    assert main([*arguments, "--results", str(tmp_path), "--json"]) == 0
    read = json.loads(capsys.readouterr().out)["yielding"]
    assert read == json.loads(file.read_text()) and file.stat().st_mtime_ns == before


def test_a_page_without_markers_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("nothing\n")
    row = {
        "controller": "x", "relative_cost": 1.0, "relative_cost_low": 1.0, "relative_cost_high": 1.0,
        "acceleration_rms_error": 0.1, "acceleration_peak_error": 0.1, "base_shear_rms_error": 0.1,
        "base_shear_peak_error": 0.1, "delay": None, "spectral_error": 0.1, "arias_ratio": 1.0,
        "drift_ratio": 1.0, "energy_ratio": 1.0, "broken_limits": 0, "decision_time": None,
        "earthquakes": 2, "tests": 8, "damage": 6.04, "information": "record known", "mean_cost": 2.0,
        "bound_cost": 2.0, "bound_cost_low": 2.0, "bound_cost_high": 2.0, "regret_closed": 0.5,
    }  # fmt: skip
    result = {
        "scenario": "linear", "rows": [row], "seed": 1, "version": "0", "machine": "m", "reference": "x",
        "information": "causal", "causal_bound": {"exact": False, "text": "", "cost": None},
        "bound": {"costs": [1.0, 1.0], "disagreements": [0.0, 0.01], "reason": "", "below": []},
    }  # fmt: skip
    text = benchmark_markdown(result)
    assert "| x | record known \u2020 | 2.000 [2.000, 2.000] | 1.000 [1.000, 1.000] | 50 |" in text
    assert "knows more than the scenario shows" in text and "agree within" in text
    assert "`x` takes 8 tests" in benchmark_markdown(
        result
    ) and "6.0 times the energy" in benchmark_markdown(result)
    with pytest.raises(ParameterError, match="put the lines"):
        put_tables(page, [result])


def test_controllers_come_without_the_extras(monkeypatch):
    """The catalogue imports without OSQP; only MPC asks for it, and says what to install."""
    import subprocess
    import sys

    from shake_env.errors import ShakeError

    code = (
        "import sys; sys.modules['osqp'] = None; import baselines.registry; "
        "assert not {'numba', 'torch', 'optuna'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(ShakeError, match=r"pip install '\.\[classical\]'"):
        make_baseline("mpc", SHORT["yielding"], {})


def test_lqr_as_published_needs_a_rate_of_kilohertz():
    """Poles near 2500 rad/s: no hold of 1 ms keeps them, and as it shortens the law becomes optimal."""
    above = {}
    for rate in (1000.0, 2000.0, 20_000.0):
        scenario = make_scenario("linear", {"control_rate": rate, "physics_step": 1.0 / rate})
        row = make_baseline("lqr-continuous", scenario).row[: scenario.plant.layout.order]
        gain = -row * scenario.current_limit / scenario.plant.state_scale
        if rate == 1000.0:
            with pytest.raises(NumericalError, match="unstable"):
                stationary_performance(scenario.discrete, scenario.stage_cost, gain)
            continue
        held = stationary_performance(scenario.discrete, scenario.stage_cost, gain).cost
        above[rate] = held / sampled_lqr(scenario.discrete, scenario.stage_cost).analytic_cost - 1.0
    assert above[2000.0] > 0.1
    assert 0.0 < above[20_000.0] < 0.01


def test_what_repeats_took_is_told():
    scenario = make_scenario("yielding", {"duration": 4.0})
    found = compare(scenario, ("tf-iteration", "ilc"), noise=2, records=False)
    rows = {row.controller: row for row in found.summaries}
    assert math.isnan(rows["preview-lqr"].damage) and rows["preview-lqr"].tests == 1
    assert rows["tf-iteration"].tests == 10 and rows["ilc"].tests == 8
    # six repeats near a perfect test each, the first of them less; and the identification before
    assert 4.0 < rows["ilc"].damage < 7.0
    assert rows["tf-iteration"].damage > 4.0
    console = Console(record=True, width=120)
    print_tables(found, console)
    assert "times the energy of a perfect" in console.export_text()
