"""Commands do what was asked, or say what they do instead."""

import json
import re
from dataclasses import replace

import pytest

from agents.__main__ import main
from agents.evaluation.comparison import compare, repeated_motions
from agents.evaluation.results import cost_text
from agents.reporting.benchmark_tables import benchmark_markdown
from agents.reporting.comparison_tables import print_tables
from shake_env import make_scenario
from shake_env.errors import ScenarioError
from shake_env.motion.targets import RecordedMotion
from shake_env.records import load_record
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario_file import scenario_fields

SHORT = make_scenario("linear", {"duration": 0.4})


@pytest.mark.parametrize(
    "arguments",
    [["compare", "--controllers"], ["robustness", "--controllers"], ["evaluate"],
     ["benchmark", "--controllers"], ["benchmark", "--scenarios"]],
)  # fmt: skip
def test_an_empty_list_of_names_is_refused(arguments, capsys):
    assert main([*arguments, "--json"]) == 2
    assert "name at least one" in capsys.readouterr().err


def test_lqr_is_refused_where_signals_are_measured():
    scenario = make_scenario("laboratory", {"duration": 0.4})
    with pytest.raises(ScenarioError, match="needs the full state: use lqg"):
        compare(scenario, ["lqr"], noise=1, records=False)


def test_one_earthquake_has_no_interval(capsys):
    found = compare(SHORT, ["none"], noise=1, records=False)
    row = next(s for s in found.summaries if s.controller == "none")
    plain = next(s for s in found.to_json({})["summaries"] if s["controller"] == "none")
    assert plain["relative_cost_low"] is None and plain["relative_cost_high"] is None
    assert row.cost_text() == f"{row.relative_cost:.3f}" or "[" not in row.cost_text()
    many = compare(SHORT, ["none"], noise=3, records=False)
    assert "[" in next(s for s in many.summaries if s.controller == "none").cost_text()


def test_copies_of_a_record_are_one_and_named():
    record = load_record("napa2014_68150_hne")
    motions = [
        Earthquake(name, RecordedMotion(record=replace(record, name=name), duration=0.4))
        for name in "ab"
    ]
    found = compare(SHORT, ["none"], motions=motions, noise=0, records=False)
    row = next(s for s in found.summaries if s.controller == "none")
    assert "[" not in row.cost_text() and row.earthquakes == 2
    (note,) = found.warnings
    assert "of 2 recorded motions 1 are distinct (b repeats a)" in note
    assert not repeated_motions(
        [*motions[:1], Earthquake("c", replace(motions[1].motion, amplitude=2.0))]
    )


def test_costs_are_written_with_or_without_their_interval():
    assert cost_text(1.23456, 1.1, 1.3) == "1.235 [1.100, 1.300]"
    assert cost_text(18.6, 18.0, 19.0) == "18.6 [18.0, 19.0]"
    assert cost_text(18.6, None, None) == "18.6"
    assert cost_text(1.5, float("nan"), float("nan")) == "1.500"


@pytest.fixture
def bench(monkeypatch, tmp_path):
    monkeypatch.setattr("agents.evaluation.benchmark.make_scenario", lambda name: SHORT)

    def run(*arguments):
        fixed = [
            "benchmark",
            "--scenarios",
            "linear",
            "--controllers",
            "none",
            "--results",
            str(tmp_path),
        ]
        return main([*fixed, *arguments])

    return run


def test_bench_runs_as_many_earthquakes_as_asked_or_says_so(bench, capsys, tmp_path):
    assert bench("--earthquakes", "2") == 0
    assert "2 earthquakes" in capsys.readouterr().out
    assert bench("--earthquakes", "2") == 0
    assert "2 earthquakes" in capsys.readouterr().out.replace("\n", " ")
    assert bench("--earthquakes", "3") == 2
    err = capsys.readouterr().err
    assert "2 earthquakes" in err and re.search(r"\b3\b", err) and "--rerun" in err
    assert bench("--earthquakes", "3", "--rerun", "--json") == 0
    assert json.loads(capsys.readouterr().out)["linear"]["rows"][0]["earthquakes"] == 3
    file = tmp_path / "bench_linear.json"
    file.write_text(file.read_text()[:100])
    assert bench("--earthquakes", "3") == 2
    err = capsys.readouterr().err
    assert file.name in err and "JSON" in err


def test_bench_names_other_controllers_and_unknown_scenarios(bench, capsys):
    assert bench("--earthquakes", "2") == 0
    assert bench("--earthquakes", "2", "--controllers", "lqr") == 2
    err = capsys.readouterr().err
    assert "none" in err and "lqr" in err and "--rerun" in err
    assert main(["benchmark", "--scenarios", "linaer"]) == 2
    assert "did you mean 'linear'" in capsys.readouterr().err


def test_bench_takes_a_scenario_file_and_notices_that_it_changed(tmp_path, capsys):
    file = tmp_path / "mine.json"

    def bench(duration, *more):
        scenario = make_scenario("linear", {"duration": duration})
        file.write_text(json.dumps({"name": scenario.name, "fields": scenario_fields(scenario)}))
        words = ["benchmark", "--controllers", "none", "--earthquakes", "2", "--results", str(tmp_path)]
        return main([*words, "--scenarios", str(file), *more])

    assert bench(0.5, "--json") == 0
    result = json.loads(capsys.readouterr().out)[str(file)]
    assert result["scenario"] == "mine" and result["reference"] == "lqr"
    assert json.loads((tmp_path / "bench_mine.json").read_text()) == result
    assert bench(0.5) == 0
    assert "made before" in capsys.readouterr().out
    assert bench(0.6) == 2
    assert "another scenario that is called mine" in capsys.readouterr().err
    assert bench(0.5, str(tmp_path / "elsewhere" / "mine.json")) == 2
    assert "one name" in capsys.readouterr().err
    assert bench(0.5, str(tmp_path / "absent.json")) == 2
    assert "absent.json" in capsys.readouterr().err


def test_bench_writes_nothing_into_the_docs_unless_told(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("agents.evaluation.benchmark.make_scenario", lambda name: SHORT)
    arguments = ["benchmark", "--scenarios", "linear", "--controllers", "none", "--earthquakes", "2"]
    assert main(arguments) == 0
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_committed_results_are_still_tables():
    """Results of before there were controllers and values in them can be read and shown."""
    from pathlib import Path

    from agents.cli.benchmark import Benchmark
    from agents.evaluation.benchmark import (
        CONTROLLERS,
        SCENARIOS,
        difference_of_result,
        read_benchmarks,
    )

    command = Benchmark()  # whose defaults are literals, so that help loads nothing else
    assert (command.scenarios, command.controllers) == (SCENARIOS, CONTROLLERS)

    results = read_benchmarks(Path(__file__).parents[3] / "docs" / "results")
    assert len(results) == 5
    for result in results:
        assert "| controller |" in benchmark_markdown(result)
        number = result["rows"][0]["earthquakes"]
        assert difference_of_result(result, result["scenario"], number, CONTROLLERS, None) == ""
    assert "is of linear" in difference_of_result(results[0], "yielding", 200, CONTROLLERS, None)
    said = difference_of_result(results[0], "linear", 7, CONTROLLERS, None)
    assert re.findall(r"\b\d+\b", said) == [str(results[0]["rows"][0]["earthquakes"]), "7"]


def test_a_result_of_a_scenario_file_is_of_its_content(tmp_path):
    from agents.evaluation.benchmark import difference_of_result, result_file, run_benchmark

    file = tmp_path / "mine.toml"
    file.write_text('schema = 1\n[motion]\nduration = "0.5 s"\n')
    result = run_benchmark(str(file), 2, ["none"])
    assert result["scenario"] == "mine" and result_file("out", str(file)).name == "bench_mine.json"
    assert difference_of_result(result, str(file), 2, ["none"], None) == ""
    file.write_text('schema = 1\ndelay = 1\n[motion]\nduration = "0.5 s"\n')
    assert "another scenario that is called mine" in difference_of_result(
        result, str(file), 2, ["none"], None
    )


def test_the_table_says_where_values_come_from(capsys):
    from rich.console import Console

    found = compare(make_scenario("linear", {"duration": 0.4}), ["tvc"], noise=2, records=False)
    print_tables(found, Console(width=100))
    sources = next(
        line for line in capsys.readouterr().out.splitlines() if "lqr:" in line and "tvc:" in line
    )
    lqr, tvc = sources.split("lqr:")[1].split("tvc:")
    assert "tuned" not in lqr and "tuned" in tvc
