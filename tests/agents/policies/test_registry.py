"""What a word of the command line stands for."""

import shutil

import pytest

from agents.policies.policy_file import PolicyFile
from agents.policies.registry import (
    SHIPPED,
    find_controller,
    get_controller,
    policies_trained_for,
    policy_path,
    shipped_policy,
)
from baselines.searched_lqg import SEARCHED
from shake_env import make_scenario
from shake_env.errors import PolicyFileError, ScenarioError


@pytest.mark.parametrize("name", ["lqr", "none", *SEARCHED, "ppo", "apg", "sac"])
def test_a_name_is_a_controller(name):
    controller = get_controller(name, make_scenario("linear"))
    assert hasattr(controller, "predict")
    assert isinstance(controller, PolicyFile) == (name in SHIPPED)


def test_a_file_and_its_run_directory_are_the_same_policy(tmp_path):
    file = tmp_path / "policy.safetensors"
    shutil.copy(shipped_policy("apg"), file)
    assert policy_path(str(tmp_path)) == policy_path(str(file)) == file
    found = [get_controller(str(path), make_scenario("linear")) for path in (tmp_path, file)]
    assert found[0].card == found[1].card


def test_a_scenario_gets_the_policy_that_ships_for_it():
    assert policy_path("apg", "yielding").name == "yielding-apg.safetensors"
    assert policy_path("apg", "records").name == "laboratory-apg.safetensors"


def test_the_policies_of_a_scenario_are_those_trained_for_it():
    assert policies_trained_for("linear") == ("ppo", "apg", "sac")
    assert "sac" not in policies_trained_for("laboratory")  # the linear table's is handed out there
    assert policies_trained_for("records") == policies_trained_for("laboratory")


def test_a_renamed_scenario_gets_the_same_policy():
    renamed = make_scenario("laboratory", {"fields": {"name": "mytable"}})
    same = get_controller("apg", make_scenario("laboratory")).card
    assert get_controller("apg", renamed).card == same


def test_what_is_no_controller_is_refused():
    scenario = make_scenario("linear")
    with pytest.raises(ScenarioError, match="did you mean 'adaptive'"):
        get_controller("adaptve", scenario)
    with pytest.raises(ScenarioError, match="everyone"):
        find_controller("everything", "everyone")
    with pytest.raises(PolicyFileError, match="no such file"):
        get_controller("nowhere/policy.safetensors", scenario)
    with pytest.raises(ScenarioError, match="none ships for linear"):
        get_controller("dagger", scenario)
    with pytest.raises(PolicyFileError, match="observation size"):
        get_controller("sac", make_scenario("laboratory"))
