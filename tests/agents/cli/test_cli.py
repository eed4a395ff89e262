"""The command line, as a shell user and a program meet it."""

import csv
import json
import subprocess
import sys

import pytest

from agents.__main__ import main
from baselines.lqr.sampled import sampled_lqr
from shake_env import make_scenario


def test_design_prints_one_json_object(capsys):
    arguments = "design --stories 4 --mass-ratio 0.3 --control-rate 200 --acceleration-weight 1"
    assert main([*arguments.split(), "--force-weight", "1", "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert err == ""
    scenario = make_scenario("linear", {"stories": 4, "mass_ratio": 0.3})
    expected = sampled_lqr(scenario.discrete, scenario.stage_cost)
    assert found["analytic_cost"] == expected.analytic_cost
    assert found["acceleration_rms_ratio"] == expected.performance.acceleration_rms_ratio
    assert found["base_shear_rms_ratio"] == expected.performance.base_shear_rms_ratio
    assert found["current_rms"] == expected.performance.current_rms
    assert len(found["natural_frequencies"]) == 5
    assert len(found["gain"]) == len(found["states"]) == 22


def test_design_for_a_person_names_states_with_units(capsys):
    assert main(["design"]) == 0
    out = capsys.readouterr().out
    for expected in ("0.208513", "table velocity [m/s]", "44.13 %", "7.27 %", "35.247"):
        assert expected in out


def test_compare_writes_what_it_prints(tmp_path, capsys):
    output = tmp_path / "out"
    arguments = [
        "compare",
        "--no-records",
        "--num-noise-motions",
        "3",
        "--duration",
        "3",
        "--output",
        str(output),
    ]
    assert main([*arguments, "--json"]) == 0
    out, _ = capsys.readouterr()
    found = json.loads(out)
    assert json.loads((output / "comparison.json").read_text()) == found
    by_name = {row["controller"]: row for row in found["summaries"]}
    assert set(by_name) == {"lqr", "none", "ppo", "apg", "sac"}
    assert by_name["lqr"]["relative_cost"] == 1.0
    none, policy = by_name["none"], by_name["ppo"]
    assert none["acceleration_rms_error"] == pytest.approx(1.0, abs=1e-12)
    assert none["base_shear_rms_error"] == pytest.approx(1.0, abs=1e-12)
    assert none["relative_cost_low"] <= none["relative_cost"] <= none["relative_cost_high"]
    assert 1.0 < policy["relative_cost"] < 1.5
    with (output / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 15
    cost = {
        name: sum(float(row["cost"]) for row in rows if row["controller"] == name) for name in by_name
    }
    assert cost["none"] / cost["lqr"] == pytest.approx(none["relative_cost"])
    for name in ("comparison.png", "comparison.svg", "summary.csv"):
        assert (output / name).stat().st_size > 200


def test_compare_leaves_the_shipped_policy_out_where_it_does_not_fit(tmp_path, capsys):
    arguments = [
        "compare",
        "--no-records",
        "--num-noise-motions",
        "2",
        "--duration",
        "1",
        "--stories",
        "3",
    ]
    assert main([*arguments, "--output", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "Left out: the shipped ppo" in out
    assert "18" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("design --mass-ratio -1", "mass_ratio = -1.0: must be"),
        ("design --control-rate 300", "control_rate = 300.0: its period is 3.33333 physics steps"),
        ("design --scenario laboratry", "scenario = 'laboratry'"),
        ("compare --controllers absent.safetensors", "there is no such file"),
        ("compare --no-records --num-noise-motions 0", "noise = 0: ask for at least one earthquake"),
        ("compare --num-noise-motions -3", "num_noise_motions = -3"),
    ],
)
def test_a_mistake_is_one_line_on_standard_error_and_exit_code_2(arguments, message, capsys):
    assert main(arguments.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err.splitlines()[-1]


def test_unknown_options_exit_with_2_and_say_so():
    result = subprocess.run(
        [sys.executable, "-m", "agents", "design", "--storeys", "2"], capture_output=True, text=True
    )
    assert result.returncode == 2
    assert "--storeys" in result.stderr


@pytest.mark.parametrize(
    "command",
    [
        "run-experiments", "model-card", "compare", "design", "evaluate", "export", "motion",
        "reproduce", "update-docs", "train", "validate-transients",
    ],
)  # fmt: skip
def test_help_teaches_by_example(command, capsys):
    with pytest.raises(SystemExit) as exit_info:
        main([command, "--help"])
    assert exit_info.value.code == 0
    out = capsys.readouterr().out
    assert "Try:" in out
    assert out.count(f"shake {command}") >= 3  # the usage line and two examples
