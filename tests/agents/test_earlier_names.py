"""Names of version 0.1 go on working, each with a warning, and are hidden from help."""

import json
from dataclasses import fields
from importlib import import_module

import pytest

from agents.__main__ import main
from agents.cli.commands import COMMANDS, command_help
from agents.earlier_names import SECTIONS, present_command, present_config, present_words
from agents.policies.policy_file import load_policy
from agents.policies.registry import controllers, find_controller, policy_path
from agents.run_directory import CONFIG, write_json
from agents.training.config import TrainConfig, config_of, read_config
from baselines.catalogue import BASELINES
from baselines.registry import make_baseline
from baselines.searched_lqg import SEARCHED, searched_parameters
from baselines.tuned_values import parse_tuned
from shake_env import make_scenario, renamed
from shake_env.errors import ScenarioError

OLD_CONTROLLERS = """
policy analytic off-policy free free-force lqr-published lqg-accommodating feedforward robust
tvc-observer inverse inverse-feedback iteration learning clairvoyant
"""
OLD_COMMANDS = "bench campaign recipe-search card components results scenario watch validate"
OLD_OPTIONS = """
benchmark.again compare.noise compare.supervised robustness.again robustness.quantities
run-experiments.again run-experiments.only train.run tune.keep tune-training.keep tune-training.share
validate-transients.noise
"""
OLD_CONFIG = "analytic start total_steps horizon episode artificial mirrored hidden"
OLD_ALGORITHM = """
tables rollout_steps epochs base authority initial_log_std scale_free critic_first units warmup_steps
exploration target_noise quantiles critics dropped window warmup memory checkpoint
"""
OLD_TUNABLES = """
preview-lqr.position lqr-integral.position lqr-integral.integral lqg.position lqg.doubt lqg-dac.position
lqg-dac.doubt lqr-friction-ff.position lqr-friction-ff.doubt mpc.position mpc.doubt multi-model.position
multi-model.doubt h-infinity.position h-infinity.doubt adaptive.position lqg-searched.acceleration
lqg-searched.effort lqg-searched.mass lqg-searched.frequency lqg-searched.damping lqg-searched.position
lqg-searched.force lqg-searched.flow lqg-searched.time lqg-searched.accommodation lqg-searched.lateness
"""


def test_no_old_name_is_forgotten():
    """What worked in 0.1 works until 0.3."""
    assert set(renamed.CONTROLLERS) == set(OLD_CONTROLLERS.split())
    assert set(renamed.COMMANDS) == set(OLD_COMMANDS.split())
    options = {f"{command}.{old}" for command, table in renamed.OPTIONS.items() for old in table}
    assert options == set(OLD_OPTIONS.split())
    assert set(renamed.CONFIG) == set(OLD_CONFIG.split())
    assert set(renamed.ALGORITHM) == set(OLD_ALGORITHM.split())
    tunables = {f"{name}.{old}" for name, table in renamed.TUNABLES.items() for old in table}
    assert tunables >= set(OLD_TUNABLES.split())


@pytest.mark.parametrize(("old", "present"), renamed.CONTROLLERS.items())
def test_an_old_controller_is_the_present_one(old, present):
    assert old not in controllers()
    with pytest.warns(renamed.RenamedWarning, match=f"'{old}' is now called '{present}'"):
        assert find_controller(old) == controllers()[present]


def test_old_names_reach_designs_and_files():
    scenario = make_scenario("laboratory")
    with pytest.warns(renamed.RenamedWarning, match="lqg-dac"):
        old = make_baseline("lqg-accommodating", scenario, {"doubt": 0.5})
    new = make_baseline("lqg-dac", scenario, {"model_error_scale": 0.5})
    assert (old.law.row == new.law.row).all()
    with pytest.warns(renamed.RenamedWarning, match="apg"):
        assert policy_path("analytic", "laboratory") == policy_path("apg", "laboratory")
    with pytest.raises(ScenarioError, match="parameter of lqg"):
        make_baseline("lqg", scenario, {"dubt": 0.5})


def test_a_file_of_tuned_values_may_have_old_names():
    entry = {"controller": "free", "digest": "1:0", "scenario": "x", "parameters": {"effort": 2.0}}
    text = json.dumps({"format": "shake-tuned-1", "entries": [entry]})
    with pytest.warns(renamed.RenamedWarning):
        (read,) = parse_tuned(text, "mine.json").entries
    assert (read.controller, read.parameters) == ("lqg-searched", {"current_weight_scale": 2.0})


def test_present_names_are_parameters_of_their_controller():
    for name, table in renamed.TUNABLES.items():
        if name in SEARCHED:
            tunable = searched_parameters(make_scenario("laboratory"))
        else:
            tunable = BASELINES[name].tunable
        assert set(tunable) <= set(table.values()) | {"mass_uncertainty"}
        assert not set(tunable) & set(table)


def test_old_commands_are_hidden():
    listed = {line.split()[0] for line in command_help().splitlines() if line.startswith("  ")}
    assert listed == set(COMMANDS)
    assert not listed & set(renamed.COMMANDS) and set(renamed.COMMANDS.values()) <= listed


def test_every_present_option_is_one():
    for command, table in renamed.OPTIONS.items():
        names = {field.name.replace("_", "-") for field in fields(COMMANDS[command].load())}
        names |= {"run-dir"} if command == "train" else set()
        assert set(table.values()) <= names and not set(table) & names
    of_config = {field.name for field in fields(TrainConfig)}
    assert set(renamed.CONFIG.values()) <= of_config and not set(renamed.CONFIG) & of_config
    of_algorithms = {name for s in SECTIONS for name in vars(getattr(TrainConfig(), s))}
    assert set(renamed.ALGORITHM.values()) <= of_algorithms
    assert not set(renamed.ALGORITHM) & of_algorithms


@pytest.mark.parametrize(
    ("old", "present"),
    [
        ("bench --again", "benchmark --rerun"),
        ("campaign --only x/analytic-force", "run-experiments --experiments x/apg-force"),
        ("--json campaign", "--json run-experiments"),
        ("recipe-search x/analytic --share=0.5", "tune-training x/apg --step-fraction=0.5"),
        ("train --run x --config.hidden 8 8", "train --run-dir x --config.net-arch 8 8"),
        ("train --config.algorithm analytic", "train --config.algorithm apg"),
        ("train --config.ppo.base free", "train --config.ppo.base-controller lqg-searched"),
        ("train --config.analytic.scale-free", "train --config.apg.no-actor-bias"),
        ("train --config.ppo.no_scale_free", "train --config.ppo.actor-bias"),
        ("train --config.recurrent-ppo.units 9", "train --config.recurrent-ppo.lstm-hidden-size 9"),
        ("compare --set a_b=1 --num_noise_motions 3", "compare --set a_b=1 --num_noise_motions 3"),
        ("validate --noise 1", "validate-transients --num-noise-motions 1"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::shake_env.renamed.RenamedWarning")
def test_an_old_command_line_is_the_present_one(old, present):
    assert present_words(old.split()) == present.split()
    assert present_words(present.split()) == present.split()
    assert present_command(f"shake {old}") == f"shake {present}"


def test_an_old_name_is_told_in_one_line(capsys):
    assert main(["scenario", "--scenario", "linear", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["name"] == "linear"
    (line,) = (line for line in captured.err.splitlines() if "is now called" in line)
    assert line.startswith("shake: command 'scenario' is now called 'show-scenario'")
    assert main(["show-scenario", "--scenario", "linear", "--json", "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def old_config(config):
    """Return a configuration's plain values as version 0.1 wrote them."""
    top = {new: old for old, new in renamed.CONFIG.items()}
    options = {new: old for old, new in renamed.ALGORITHM.items()}
    values = config.to_json()
    for section in SECTIONS:
        values[section] = {options.get(name, name): each for name, each in values[section].items()}
        if "scale_free" in values[section]:
            values[section]["scale_free"] = not values[section]["scale_free"]
    return {top.get(name, name): value for name, value in values.items()}


def test_a_run_of_an_earlier_version_is_read(tmp_path):
    config = TrainConfig(algorithm="apg", net_arch=(8,), num_artificial_motions=3)
    values = old_config(config) | {"algorithm": "analytic", "start": "analytic"}
    values["ppo"]["base"] = "lqg-accommodating"
    write_json(tmp_path / CONFIG, values)
    with pytest.warns(renamed.RenamedWarning, match="hidden is now net_arch"):
        read = read_config(tmp_path)
    assert (read.algorithm, read.init_policy, read.net_arch) == ("apg", "apg", (8,))
    assert read.ppo.base_controller == "lqg-dac" and read.ppo.actor_bias is False
    assert read.apg == config.apg and present_config(read.to_json()) == read.to_json()


@pytest.mark.parametrize("name", ["ppo", "apg", "sac"])
def test_the_card_of_a_shipped_policy_has_present_names(name):
    card = load_policy(policy_path(name)).card
    assert config_of(card["config"]).algorithm == name
    assert card["command"].startswith(("shake train --run-dir", "shake run-experiments --experiments"))


@pytest.mark.parametrize("package", renamed.PYTHON)
def test_old_python_names_are_the_present_ones(package):
    module = import_module(package)
    for old, present in renamed.PYTHON[package].items():
        assert old not in module.__all__
        with pytest.warns(renamed.RenamedWarning, match=present):
            assert getattr(module, old) is getattr(module, present)


def test_an_option_that_is_gone_is_dropped_where_it_had_no_effect():
    plain = {"algorithm": "apg", "apg": {"step_check": False, "n_envs": 8}}
    assert present_config(plain)["apg"] == {"n_envs": 8}
    plain["apg"]["step_check"] = True
    assert "step_check" in present_config(plain)["apg"]  # refused by name where it is read
