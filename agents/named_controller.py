"""What a word of the command line stands for: a law by its name, a policy that ships, or a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from agents.free_design import FOUND, found_by_search
from agents.policy_file import load_policy
from agents.run_directory import policy_of_run
from agents.shipped import SHIPPED, shipped_policy
from baselines.registry import BASELINES, make_baseline
from shake_env.controller import Controller
from shake_env.errors import ScenarioError, unknown
from shake_env.rollout import Earthquake
from shake_env.scenario import Scenario


def named_controller(
    name: str, scenario: Scenario, earthquakes: Sequence[Earthquake] | None = None
) -> Controller:
    """Return a controller for a scenario.

    Parameters
    ----------
    name
        Of `baselines.catalogue`, ``free`` or ``free-force`` (`agents.free_design`), a family of policies
        that ship (`agents.shipped`), or the path of a policy file or run directory.
    scenario
        What it drives.
    earthquakes
        One a lane; needed by controllers that repeat their tests beforehand.

    Raises
    ------
    ScenarioError
        If the name is unknown, or the controller does not suit the scenario.
    PolicyFileError
        If a policy cannot be read or does not fit the scenario.
    """
    if name in BASELINES:
        return make_baseline(name, scenario, None, earthquakes)
    if name in FOUND:
        return found_by_search(scenario, name)
    require_controller(name)
    policy = load_policy(file_of(name, scenario.name))
    policy.check(scenario)
    return policy


def require_controller(name: str, *others: str) -> None:
    """Raise ScenarioError where a word is no controller's name, none of the `others` and no path."""
    known = [*BASELINES, *FOUND, *SHIPPED, *others]
    if name not in known and not (Path(name).exists() or "/" in name or "." in name):
        raise unknown(ScenarioError, "controller", name, known)


def file_of(name: str, scenario_name: str = "linear") -> Path:
    """Return the file of a policy that ships, as the scenario has it, or that a path stands for.

    A run directory stands for its policy; while it is not finished, for the best one so far.
    """
    if name in SHIPPED:
        return shipped_policy(name, scenario_name)
    path = Path(name)
    return policy_of_run(path) if path.is_dir() else path
