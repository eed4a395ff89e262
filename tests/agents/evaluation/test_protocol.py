"""The protocol: against `shake compare`'s figures, against J*, and what a result file holds."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from agents.__main__ import main
from agents.evaluation.bound import optimal_cost
from agents.evaluation.comparison import compare
from agents.evaluation.entries import Entry, find_entry, policy_files
from agents.evaluation.protocol import can_supervise, evaluate
from agents.evaluation.result_files import read_results, write_result
from agents.evaluation.scores import below_bound, cost_figures
from agents.policies.policy_file import file_digest, load_policy
from agents.policies.registry import shipped_policy
from agents.reporting.evaluation_tables import evaluation_markdown, put_tables
from agents.seeds import (
    COMPARISON_SEED,
    COVERAGE_SEED,
    EVALUATION_SEED,
    FORECAST_SEED,
    MOST_RUNS,
    ROBUSTNESS_SEED,
    RUN_SEEDS,
    TEST_SEED,
    VALIDATION_SEED,
)
from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import sampled_lqr
from shake_env import make_scenario
from shake_env.errors import ParameterError, PolicyFileError, ScenarioError


@pytest.fixture(scope="module")
def scenario():
    return make_scenario("linear", {"duration": 2.0})


@pytest.fixture(scope="module")
def two_seeds(tmp_path_factory):
    """A folder of two runs, as a campaign leaves it."""
    folder = tmp_path_factory.mktemp("runs") / "mine"
    for seed, name in ((0, "ppo"), (1, "apg")):
        (folder / str(seed)).mkdir(parents=True)
        shutil.copy(shipped_policy(name), folder / str(seed) / "policy.safetensors")
    return folder


@pytest.fixture(scope="module")
def result(scenario, two_seeds):
    rows = [find_entry(str(two_seeds), scenario), find_entry("none", scenario)]
    return evaluate(scenario, rows, earthquakes=70, resamples=200)


def test_costs_are_those_of_compare(scenario, result):
    found = compare(scenario, ["ppo", "apg", "none"], noise=70, records=False, seed=TEST_SEED).episodes
    for name, runs in {"mine": ("ppo", "apg"), "lqr": ("lqr",), "none": ("none",)}.items():
        expected = [[m.cost for m in found[run]] for run in runs]
        # Batches of another width round otherwise.
        np.testing.assert_allclose(result["episodes"][name]["cost"], expected, rtol=1e-5)
    row = next(row for row in result["rows"] if row["controller"] == "mine")
    lqr = np.sum([m.cost for m in found["lqr"]])
    each = [np.sum([m.cost for m in found[run]]) for run in ("ppo", "apg")]
    assert row["reference_cost"]["value"] == pytest.approx(np.mean(each) / lqr, rel=1e-5)
    bound = np.sum(result["bound"]["costs"])
    assert row["run_costs"] == pytest.approx(each / bound, rel=1e-5)
    assert row["relative_cost"]["value"] == pytest.approx(np.mean(each) / bound, rel=1e-5)
    assert (row["runs"], row["episodes"], row["failures"]) == (2, 140, 0)


def test_a_linear_table_has_the_bound_and_the_causal_optimum(scenario, result):
    assert result["optimal_cost"] == sampled_lqr(scenario.discrete, scenario.stage_cost).analytic_cost
    assert (result["normaliser"], result["reference"]) == ("bound", "lqr")
    assert result["causal_bound"]["cost"] == result["optimal_cost"] and result["bound"]["below"] == []
    by_name = {row["controller"]: row for row in result["rows"]}
    assert by_name["lqr"]["reference_cost"] == {"value": 1.0, "low": 1.0, "high": 1.0}
    assert by_name["lqr"]["relative_cost"]["low"] > 4.0  # causal, against everything known
    assert by_name["lqr"]["regret_closed"] is None
    # Tables begin at rest: two seconds cost a little less than stationary ones.
    assert 0.9 < by_name["lqr"]["optimality"]["value"] < 1.05
    assert by_name["none"]["probability_of_improvement"]["value"] == 0.0
    mine = by_name["mine"]["reference_cost"]
    assert mine["low"] < mine["value"] < mine["high"]
    assert 1.0 < mine["value"] < 1.1
    text = evaluation_markdown(result)
    assert "cost / bound" in text and "cost / lqr" in text and "J* = " in text
    assert "No controller costs less than the bound" in text


def test_a_result_says_what_it_was_made_of(result, two_seeds):
    assert result["seed"] == TEST_SEED
    assert result["earthquakes"][0] == f"noise {TEST_SEED}"
    by_name = {row["controller"]: row for row in result["rows"]}
    sources = by_name["mine"]["sources"]
    assert [s["sha256"] for s in sources] == [file_digest(f) for f in policy_files(two_seeds)]
    assert [s["algorithm"] for s in sources] == ["ppo", "apg"]
    assert by_name["lqr"]["sources"] == []
    assert 1e-6 < by_name["mine"]["decision_time"] < 1e-2


def test_an_evaluation_is_repeated_exactly(scenario, two_seeds, result):
    again = evaluate(
        scenario,
        [find_entry(str(two_seeds), scenario), find_entry("none", scenario)],
        earthquakes=70,
        resamples=200,
    )
    timed = [
        {**each, "rows": [{**row, "decision_time": None} for row in each["rows"]]}
        for each in (again, result)
    ]
    assert timed[0] == timed[1]


def test_test_earthquakes_are_nobody_elses():
    starts = [
        0, EVALUATION_SEED, COMPARISON_SEED, VALIDATION_SEED, TEST_SEED, ROBUSTNESS_SEED, FORECAST_SEED,
        COVERAGE_SEED,
    ]  # fmt: skip
    assert MOST_RUNS * RUN_SEEDS <= EVALUATION_SEED
    assert starts == sorted(starts)
    assert min(np.diff(starts)) >= 1_000_000


def test_an_unknown_specimen_is_measured_by_the_bound(monkeypatch):
    monkeypatch.setattr("agents.evaluation.protocol.MOST_BOUNDS", 2)
    unknown = {"uncertainty.mass_ratio": [0.3, 0.7]}
    scenario = make_scenario("laboratory", {"duration": 2.0, "fields": unknown})
    rows = [Entry("none"), Entry("oracle")]
    result = evaluate(scenario, rows, earthquakes=3, repeats=False, resamples=50)
    assert (result["normaliser"], result["reference"], result["optimal_cost"]) == (
        "bound", "lqg", None,
    )  # fmt: skip
    by_name = {row["controller"]: row for row in result["rows"]}
    # The bound is of the first two alone; what is relative to it is of these.
    cost = {name: np.mean(e["cost"][0][:2]) for name, e in result["episodes"].items()}
    bound = np.mean(result["bound"]["costs"])
    assert len(result["bound"]["costs"]) == 2 and "of the first 2 earthquakes" in evaluation_markdown(
        result
    )
    for name in ("lqg", "none", "oracle"):
        expected = (cost["lqg"] - cost[name]) / (cost["lqg"] - bound)
        # A file's numbers have seven digits, and none's share is hundreds of times the regret.
        closed = by_name[name]["regret_closed"]["value"]
        assert closed == pytest.approx(expected, abs=1e-5, rel=1e-5)
        relative = by_name[name]["relative_cost"]["value"]
        assert relative == pytest.approx(cost[name] / bound, rel=1e-5) and relative > 1.0
    assert by_name["oracle"]["decision_time"] is None
    assert by_name["none"]["drift_error"] is None
    classes = {name: row["information"] for name, row in by_name.items()}
    assert classes == {"lqg": "preview", "none": "causal", "oracle": "true plant"}
    assert "| true plant \u2020 |" in evaluation_markdown(
        result
    ) and "best attained" in evaluation_markdown(result)


def test_policies_have_a_row_within_the_supervisor_where_it_applies(result, scenario):
    realistic = make_scenario("laboratory", {"duration": 3.0})
    # Full current for a whole test: the supervisor has to act, and keeps the table.
    entry = find_entry("dagger-apg", realistic)
    wild = replace(entry.policies[0], biases=(*entry.policies[0].biases[:-1], np.array([400.0])))
    rows = [
        Entry("none"),
        replace(entry, name="mine"),
        Entry("wild", (replace(wild, authority=1.0),), entry.sources),
    ]
    evaluated = evaluate(realistic, rows, earthquakes=2, repeats=False, resamples=20)
    by_name = {row["controller"]: row for row in evaluated["rows"]}
    mine, lost = by_name["mine"], by_name["wild"]
    same = compare(
        realistic, ["dagger-apg"], noise=2, records=False, seed=TEST_SEED, supervised=True
    ).episodes["dagger-apg"]
    bound = np.mean(evaluated["bound"]["costs"])
    cost = mine["supervised"]["relative_cost"]["value"]
    assert cost == pytest.approx(np.mean([each.cost for each in same]) / bound, rel=1e-6)
    assert lost["failures"] == 2 and lost["supervised"]["failures"] == 0
    assert mine["supervised"]["acted"] < 0.01 < lost["supervised"]["acted"]
    text = evaluation_markdown(evaluated)
    assert "supervised: cost, failures, changed %" in text and ", 0 of 2, " in text
    # A row that is kept keeps them as long as the bounds are the same.
    for code, kept in ((evaluated["bound"]["code"], True), ("of another search", False)):
        known = evaluated | {"bound": evaluated["bound"] | {"code": code}}
        options = {"earthquakes": 2, "repeats": False, "resamples": 20, "known": known}
        later = evaluate(realistic, [], **options)
        assert [("supervised" in row) for row in later["rows"] if row["controller"] == "mine"] == [kept]
    # The linear table has no limits to keep.
    assert "supervised" not in evaluation_markdown(result) and not can_supervise(scenario)


def test_without_a_bound_the_reference_is_the_normaliser():
    scenario = make_scenario("as-printed", {"duration": 0.5})
    result = evaluate(scenario, [Entry("none")], earthquakes=2, repeats=False, resamples=20)
    assert (result["normaliser"], result["bound"]["costs"]) == ("lqr", [])
    assert "corrected equations" in result["bound"]["reason"]
    assert "Bound: none" in evaluation_markdown(result) and "cost / lqr" in evaluation_markdown(result)


def test_a_cost_below_the_bound_is_reported_unless_the_starts_explain_it():
    cost = [[0.9, 1.0, 2.0, 5.0], [1.1, 0.995, 1.9, 5.0]]
    below = below_bound(cost, [1.0, 1.0, 2.0], [0.02, 0.02, 0.0])
    assert [(each["run"], each["earthquake"]) for each in below] == [(0, 0), (1, 2)]
    assert [each["ratio"] for each in below] == pytest.approx([0.9, 0.95])
    # Starts that disagree widely do not hide that their bound fails.
    below = below_bound([[0.98, 0.995, 0.5]], [1.0, 1.0, 1.0], [0.1, 0.1, np.inf])
    assert [each["earthquake"] for each in below] == [0, 2]


def test_no_regret_is_told_where_there_is_none():
    cheap, dear = np.full((1, 4), 1.0), np.full((1, 4), 2.0)
    own = np.full((1, 4), 1.5)
    figures = cost_figures(own, normaliser=dear, reference=cheap, optimum=None, resamples=10)
    assert figures["regret_closed"] is None
    figures = cost_figures(own, normaliser=cheap, reference=dear, optimum=None, resamples=10)
    assert figures["regret_closed"]["value"] == pytest.approx(0.5)


def test_the_optimum_with_preview_and_amplitude():
    scenario = make_scenario("linear", {"amplitude": 0.5, "fields": {"sensing.preview": 0.1}})
    design = preview_lqr(scenario.discrete, scenario.stage_cost, 0.1)
    assert optimal_cost(scenario) == pytest.approx(0.25 * design.analytic_cost)
    for change in ({"delay": 2.5}, {"sensing": "laboratory"}, {"limits": "laboratory"}):
        assert optimal_cost(make_scenario("linear", change)) is None
    friction = {"fields": {"nonlinearity.friction.coulomb": 300.0}}
    assert optimal_cost(make_scenario("linear", friction)) is None


def test_tables_stand_between_markers_and_come_from_files(result, tmp_path):
    write_result(result, tmp_path / "evaluation_linear.json")
    read = read_results(tmp_path)
    assert read == {"linear": json.loads(json.dumps(result))}
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- evaluation linear -->\nold\n<!-- end linear -->\nafter\n")
    assert put_tables(page, read | {"other": result}) == ["other"]
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    table = [line for line in evaluation_markdown(read["linear"]).splitlines() if line.startswith("|")]
    assert all(line in text for line in table)
    assert len({line.count("|") for line in table}) == 1
    put_tables(page, read)
    assert page.read_text() == text
    page.write_text("<!-- evaluation linear -->\n")
    with pytest.raises(ParameterError, match="<!-- evaluation linear --> and <!-- end linear -->"):
        put_tables(page, read)


def test_entries_are_named_grouped_and_refused(scenario, two_seeds, tmp_path):
    paths = ",".join(str(two_seeds / seed) for seed in "01")
    found = find_entry(f"both={paths}", scenario)
    assert (found.name, len(found.policies)) == ("both", 2)
    assert find_entry("ppo", scenario).policies[0].card == load_policy(shipped_policy()).card
    with pytest.raises(ScenarioError, match="did you mean 'ppo'"):
        find_entry("ppoo", scenario)
    with pytest.raises(PolicyFileError, match=r"holds no policy\.safetensors or best"):
        find_entry(str(tmp_path), scenario)
    with pytest.raises(PolicyFileError, match="observation size"):
        find_entry(str(two_seeds), make_scenario("laboratory"))
    with pytest.raises(ParameterError, match="two rows have one name"):
        evaluate(scenario, [Entry("none"), Entry("none")], earthquakes=2)
    with pytest.raises(ParameterError, match="earthquakes = 1"):
        evaluate(scenario, [], earthquakes=1)


def test_the_command_writes_what_it_prints(tmp_path, capsys):
    file = tmp_path / "out" / "result.json"
    words = ["evaluate", "ppo", "--earthquakes", "3", "--duration", "1", "--no-fidelity"]
    assert main([*words, "--output", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert json.loads(file.read_text()) == found
    assert found["scenario_options"] == {"scenario": "linear", "duration": 1.0}
    assert main([*words, "--output", str(file)]) == 0
    assert re.search(r"\| ppo \| causal \| 1 \| \d+\.", capsys.readouterr().out)
