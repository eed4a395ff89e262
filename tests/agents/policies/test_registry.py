"""What a word of the command line stands for."""

import shutil

import pytest

from agents.policies.policy_file import PolicyFile
from agents.policies.registry import (
    SHIPPED,
    file_of,
    named_controller,
    require_controller,
    shipped_policy,
)
from baselines.searched_lqg import FOUND
from shake_env import make_scenario
from shake_env.errors import PolicyFileError, ScenarioError


@pytest.mark.parametrize("name", ["lqr", "none", *FOUND, *SHIPPED])
def test_a_name_is_a_controller(name):
    controller = named_controller(name, make_scenario("linear"))
    assert hasattr(controller, "predict")
    assert isinstance(controller, PolicyFile) == (name in SHIPPED)


def test_a_file_and_its_run_directory_are_the_same_policy(tmp_path):
    file = tmp_path / "policy.safetensors"
    shutil.copy(shipped_policy("analytic"), file)
    assert file_of(str(tmp_path)) == file_of(str(file)) == file
    found = [named_controller(str(path), make_scenario("linear")) for path in (tmp_path, file)]
    assert found[0].card == found[1].card


def test_a_scenario_gets_the_policy_that_ships_for_it():
    assert file_of("analytic", "yielding").name == "yielding-analytic.safetensors"
    assert file_of("analytic", "records").name == "laboratory-analytic.safetensors"


def test_a_renamed_scenario_gets_the_same_policy():
    renamed = make_scenario("laboratory", {"fields": {"name": "mytable"}})
    same = named_controller("analytic", make_scenario("laboratory")).card
    assert named_controller("analytic", renamed).card == same


def test_what_is_no_controller_is_refused():
    scenario = make_scenario("linear")
    with pytest.raises(ScenarioError, match=r"anlytic.*analytic"):
        named_controller("anlytic", scenario)
    with pytest.raises(ScenarioError, match="everyone"):
        require_controller("everything", "everyone")
    require_controller("everyone", "everyone")
    with pytest.raises(PolicyFileError, match="no such file"):
        named_controller("nowhere/policy.safetensors", scenario)
    with pytest.raises(PolicyFileError, match="observation size"):
        named_controller("off-policy", make_scenario("laboratory"))
