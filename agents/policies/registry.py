"""What a word of the command line stands for: a law, a policy that ships, a file, or an own class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path

from agents.policies.own_controller import is_own_controller, own_baseline
from agents.policies.policy_file import load_policy
from agents.run_directory import policy_of_run
from baselines.catalogue import BASELINES
from baselines.registry import ParameterValues, designed, parameter_values
from baselines.searched_lqg import FOUND, FREE, found_by_search
from baselines.tuned_values import TunedValues
from shake_env.controller import Controller
from shake_env.errors import ScenarioError, unknown
from shake_env.rollout import Earthquake
from shake_env.scenario.digest import known_name
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import Scenario


def named_controller(
    name: str,
    scenario: Scenario,
    earthquakes: Sequence[Earthquake] | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Controller:
    """Return a controller for a scenario.

    Parameters
    ----------
    name
        Of `baselines.catalogue`, ``free`` or ``free-force`` (`baselines.searched_lqg`), a family of
        policies that ship (`agents.policies.registry`), ``module:Class`` or ``file.py:Class``
        (`agents.policies.own_controller`), or the path of a policy file or run directory.
    scenario
        What it drives.
    earthquakes
        One a lane; needed by controllers that repeat their tests beforehand.
    parameters
        Values of its free parameters; None: see `values_for`.

    Raises
    ------
    ScenarioError
        If the name is unknown, or the controller does not suit the scenario.
    PolicyFileError
        If a policy cannot be read or does not fit the scenario.
    """
    if parameters is None and (values := values_for(name, scenario)) is not None:
        parameters = values.parameters
    if name in FOUND:
        return found_by_search(scenario, name, parameters)
    if has_parameters(name):
        baseline = BASELINES[name] if name in BASELINES else own_baseline(name)
        return designed(name, baseline, scenario, parameters or {}, earthquakes)
    require_controller(name)
    policy = load_policy(file_of(name, known_name(scenario)))
    policy.check(scenario)
    return policy


def has_parameters(name: str) -> bool:
    """Return whether a word names a design with parameters, not a policy."""
    return name in BASELINES or name in FOUND or is_own_controller(name)


def values_for(
    name: str, scenario: Scenario, tuned: TunedValues | None = None
) -> ParameterValues | None:
    """Return the parameter values of a controller's name and their source; None for a policy.

    See `baselines.registry.parameter_values`.
    """
    if not has_parameters(name):
        return None
    return parameter_values(FREE if name in FOUND else name, scenario, tuned)


def require_controller(name: str, *others: str) -> None:
    """Raise ScenarioError where a word is no controller's name, none of the `others` and no path."""
    known = [*BASELINES, *FOUND, *SHIPPED, *others]
    path = is_own_controller(name) or Path(name).exists() or "/" in name or "." in name
    if name not in known and not path:
        raise unknown(ScenarioError, "controller", name, known)


def file_of(name: str, scenario_name: str = "linear") -> Path:
    """Return the file of a policy that ships, as the scenario has it, or that a path stands for.

    A run directory stands for its policy; while it is not finished, for the best one so far.
    """
    if name in SHIPPED:
        return shipped_policy(name, scenario_name)
    path = Path(name)
    return policy_of_run(path) if path.is_dir() else path


# Families by their names for the commands, and the algorithms of their files: one of each a scenario.
SHIPPED: dict[str, tuple[str, ...]] = {
    "policy": ("ppo", "recurrent-ppo"),
    "analytic": ("analytic",),
    "off-policy": ("sac", "tqc", "td3"),
}


@lru_cache
def _trained_on(scenario_name: str) -> str:
    """Return the scenario that policies for a scenario are trained on."""
    return (NAMED[scenario_name]().train_on if scenario_name in NAMED else None) or scenario_name


def shipped_policy(name: str = "policy", scenario_name: str = "linear") -> Path:
    """Return the file of a policy that comes with the package.

    Parameters
    ----------
    name
        Of `SHIPPED`.
    scenario_name
        Whose policy is asked for. The records are driven by the laboratory's, for nothing is trained on
        them; a scenario without a policy of its own gets the linear table's, if it fits.
    """
    folder = Path(str(resources.files("agents").joinpath("pretrained")))
    trained = _trained_on(scenario_name)
    files = [folder / f"{of}-{by}.safetensors" for of in (trained, "linear") for by in SHIPPED[name]]
    return next(file for file in files if file.is_file())
