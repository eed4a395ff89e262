"""Files and options of a sequence: stopped tests, damaged files, interruptions, wrong numbers."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from made_logs import laboratory_log
from rich.console import Console
from small_sequence import begun, laboratory_test

from agents.cli.commands import parse
from agents.laboratory.forecasting.coverage import share_within
from agents.laboratory.identification.identify import identify, read_prior
from agents.laboratory.identification.parameters import default_prior
from agents.laboratory.identification.posterior import read_posterior
from agents.laboratory.logs.log_file import write_log
from agents.laboratory.sequence.rehearsal import hidden_truth, simulate_shake
from agents.laboratory.sequence.state import read_sequence
from agents.laboratory.sequence.steps import designed_on, next_shake, plan_sequence
from shake_env.errors import FileError, ParameterError, ScenarioError
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.scenario_file import read_scenario


def test_a_shake_that_was_stopped_updates_the_belief_and_is_not_held_against_the_forecast(tmp_path):
    begun(tmp_path / "one")
    sequence, _ = next_shake(read_sequence(tmp_path / "one"), page=False)
    truth = hidden_truth(laboratory_test(), np.random.default_rng(3), wider=False)
    log, _, _ = simulate_shake(designed_on(sequence), truth, "lqg", 1)
    half = replace(log, channels={k: v[: len(v) // 2].copy() for k, v in log.channels.items()})
    write_log(half, tmp_path / "half.csv")
    line = f"sequence close --folder {tmp_path / 'one'} --log {tmp_path / 'half.csv'}"
    console = Console(record=True, width=300)
    state = parse(line.split()).run(console)
    words = console.export_text()
    assert words.count("covers 1.50 of 3.00 s of the motion") == 2  # of the action, and of the status
    assert "not compared" in words
    assert state["calibration"] is None and state["shakes"][0]["inside"] == {}
    closed = read_sequence(tmp_path / "one")
    assert closed.number == 1 and closed.shakes[0].covered == (1.5, 3.0)
    assert closed.posterior.logs == ((half.name, half.sha256),)
    described = parse(
        f"identify {tmp_path / 'half.csv'} --samples 4 --output {tmp_path / 'out'}".split()
    ).run(console)
    assert described["covered"] == [(1.5, 3.0)]
    assert "the log covers 1.50 of 3.00 s of its motion" in console.export_text()


@pytest.mark.parametrize(
    "missing",
    ["format", "scenario", "controllers", "required_probability", "samples", "seed", "shakes"],
)
def test_a_state_without_a_key_names_the_key_and_what_to_do(tmp_path, missing):
    begun(tmp_path / "one")
    file = tmp_path / "one" / "sequence.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    for value, words in ((None, f"the key '{missing}' is missing"), ({"a": 1}, missing)):
        if value is None:
            del content[missing]
        else:
            content[missing] = value
        file.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(FileError, match=f"(?s)sequence.json.*{words}.*restore the file") as caught:
            read_sequence(tmp_path / "one")
        assert "Error" not in str(caught.value)  # no name of a Python exception


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("calibrate --samples 0", "samples = 0: must be at least 2"),
        ("calibrate --samples -1", "samples = -1"),
        ("calibrate --data-sets 0", "data_sets = 0"),
        ("calibrate --sampler-moves 0", "sampler_moves = 0: must be 20 to 5000"),
        ("calibrate --sampler-moves -1", "sampler_moves = -1"),
        ("calibrate --shakes -1", "shakes = -1"),
        ("calibrate --seed -1", "seed = -1"),
        ("calibrate --amplitude 0", "amplitude = 0.0: must be above 0"),
        ("calibrate --without table_aceleration", "did you mean 'table_acceleration'"),
        ("identify LOG --samples 0", "samples = 0"),
        ("identify LOG --samples -1", "samples = -1"),
        ("identify LOG --seed -1", "seed = -1"),
        ("identify LOG --sampler-seconds -1", "sampler_seconds = -1"),
        ("identify LOG --sampler-seconds inf", "sampler_seconds = inf"),
        ("forecast unknown-specimen --samples 0", "samples = 0"),
        ("forecast unknown-specimen --samples -1", "samples = -1"),
        ("forecast unknown-specimen --seed -1", "seed = -1"),
        ("sequence rehearse --truths 0", "truths = 0"),
        ("sequence rehearse --truths -1", "truths = -1"),
        ("sequence rehearse --samples 0", "samples = 0"),
        ("sequence rehearse --seed -1", "seed = -1"),
        ("sequence plan --samples 0", "samples = 0"),
        ("sequence plan --samples -1", "samples = -1"),
        ("sequence plan --seed -1", "seed = -1"),
    ],
)
def test_numbers_that_mean_nothing_are_refused_at_once(tmp_path, monkeypatch, line, words):
    monkeypatch.chdir(tmp_path)
    write_log(laboratory_log(), tmp_path / "log.h5")
    with pytest.raises(ParameterError, match=words):
        parse(line.replace("LOG", "log.h5").split()).run(Console(quiet=True))


def edited(file, **changes):
    content = json.loads(file.read_text(encoding="utf-8"))
    for key, value in changes.items():
        if value is None:
            del content[key]
        else:
            content[key] = value
    file.write_text(json.dumps(content), encoding="utf-8")
    return content


def test_an_unknown_parameter_of_a_posterior_is_named_with_the_known_ones(tmp_path):
    begun(tmp_path / "one")
    file = tmp_path / "one" / "posterior_0.json"
    names = json.loads(file.read_text(encoding="utf-8"))["names"]
    (tmp_path / "test.toml").write_text(
        'schema = 1\nbase = "laboratory"\n[uncertainty.posterior]\npath = "one/posterior_0.json"\n'
    )
    assert read_scenario(tmp_path / "test.toml").uncertainty.names == tuple(names)
    wrong = ["bulk_modulos" if name == "bulk_modulus" else name for name in names]
    edited(file, names=wrong)
    words = "parameter = 'bulk_modulos'.*did you mean 'bulk_modulus'.*known: .*leakage"
    with pytest.raises(FileError, match=words):
        read_posterior(file)
    with pytest.raises(FileError, match=words):
        next_shake(read_sequence(tmp_path / "one"))
    with pytest.raises(FileError, match=words):
        read_prior(file, laboratory_test())
    with pytest.raises(ScenarioError, match=words.removeprefix("parameter = ")):
        read_scenario(tmp_path / "test.toml")
    edited(file, names=["storey_stiffness_7" if n == "leakage" else n for n in names])
    with pytest.raises(FileError, match="storey_stiffness_7"):  # a storey that the specimen has not
        read_posterior(file)


def test_a_prior_of_another_specimen_is_refused(tmp_path):
    file = tmp_path / "prior.toml"
    three, log = make_scenario("laboratory", {"stories": 3}), laboratory_log()
    file.write_text("[storey_stiffness_3]\nmedian = 1e5\nfactor = 1.2\n")
    read_prior(file, three)
    with pytest.raises(ParameterError, match=r"storey_stiffness_3.*known"):
        read_prior(file, log.scenario)
    with pytest.raises(ParameterError, match=r"storey_stiffness_3.*known"):
        identify([log], log.scenario, prior=default_prior(three))
    with pytest.raises(ParameterError, match=r"storey_stiffness_3.*known"):
        plan_sequence(tmp_path / "one", laboratory_test(), prior=default_prior(three))
    assert not (tmp_path / "one").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"method": None}, "the key 'method' is missing"),
        ({"logs": None}, "the key 'logs' is missing"),
        ({"scenario": None}, "the key 'scenario' is missing"),
        ({"scenario": {}}, "'fields'"),
        ({"shares": None}, "the key 'shares' is missing"),
        ({"seed": "x"}, "'seed' must be a whole number"),
        ({"logs": [["a"]]}, "'logs' must be pairs"),
        ({"shares": {"table_velocity": -1.0}}, "'shares' must be numbers of at least 0"),
        ({"r_hat": [1.0]}, "'r_hat' must be null or"),
        ({"samples": [[1.0, 2.0]]}, "'samples' must be rows of"),
        ({"digest": "1:0"}, "was edited"),
    ],
)
def test_a_damaged_posterior_names_file_key_and_remedy(tmp_path, changes, words):
    begun(tmp_path / "one")
    file = tmp_path / "one" / "posterior_0.json"
    read_posterior(file)
    edited(file, **changes)
    with pytest.raises(FileError, match=rf"posterior_0\.json.*{words}.*restore the file") as caught:
        read_posterior(file)
    assert "Error" not in str(caught.value)


def test_values_of_a_posterior_that_no_plant_has_are_refused(tmp_path):
    begun(tmp_path / "one")
    file = tmp_path / "one" / "posterior_0.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    content["samples"][3][content["names"].index("leakage")] *= -1.0
    edited(file, samples=content["samples"])
    with pytest.raises(FileError, match="samples of 'leakage' must be finite, and above 0"):
        read_posterior(file)


def test_a_killed_forecast_goes_on(tmp_path):
    """SIGKILL before each of the files that `next` writes: the command then gives the same state."""
    for name in ("whole", "killed"):
        begun(tmp_path / name)
    next_shake(read_sequence(tmp_path / "whole"))
    program = (
        "import os, signal, sys\nfrom pathlib import Path\n"
        "from agents.laboratory.sequence import state, steps\n"
        "from shake_env import files\n"
        "replace = Path.replace\n"
        "def killing(self, target):\n"
        "    if Path(target).name == sys.argv[2]: os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return replace(self, target)\n"
        "Path.replace = killing\n"
        "steps.next_shake(state.read_sequence(sys.argv[1]))\n"
    )
    for file in ("forecast.html", "test.toml", "sequence.json"):
        call = [sys.executable, "-c", program, str(tmp_path / "killed"), file]
        run = subprocess.run(
            call, timeout=600, check=False, env={**os.environ, "PYTHONPATH": os.getcwd()}
        )
        assert run.returncode == -signal.SIGKILL, file
        assert read_sequence(tmp_path / "killed").next.forecast is None
    next_shake(read_sequence(tmp_path / "killed"))
    for part in ("sequence.json", "shake_1/test.toml"):
        whole, killed = ((tmp_path / name / part).read_bytes() for name in ("whole", "killed"))
        assert killed == whole, part


def test_an_end_of_an_interval_with_a_mass_counts_by_its_part():
    """10 % of a bounded quantity lie at its bound: 90 % of outcomes are to be within, not 95 %."""
    rng = np.random.default_rng(0)
    belief, outcome = (np.minimum(rng.random(n), 0.9) for n in (40_000, 100_000))
    low, high = np.quantile(belief, [0.05, 0.95])
    assert high == 0.9
    assert np.mean((outcome >= low) & (outcome <= high)) == pytest.approx(0.95, abs=0.004)
    assert share_within(belief, outcome, 0.05) == pytest.approx(0.9, abs=0.004)
    assert share_within(-belief, -outcome, 0.05) == pytest.approx(0.9, abs=0.004)
    smooth, tested = rng.standard_normal(4000), rng.standard_normal(1000)
    low, high = np.quantile(smooth, [0.05, 0.95])
    assert share_within(smooth, tested, 0.05) == np.mean((tested >= low) & (tested <= high))
    assert share_within(np.ones(50), np.ones(20), 0.05) == pytest.approx(0.9)
