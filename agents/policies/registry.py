"""The one registry of controllers: what a name, a path or MODULE:CLASS stands for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Literal

from agents.policies.own_controller import is_own_controller, own_baseline
from agents.policies.policy_file import load_policy
from agents.run_directory import policy_of_run
from baselines.catalogue import BASELINES
from baselines.information import Information, scenario_information
from baselines.lqr.oracle import oracle_controller
from baselines.registry import (
    CLASSICAL,
    ParameterValues,
    baseline_of,
    designed_controller,
    parameter_values,
)
from baselines.searched_lqg import SUMMARIES
from baselines.tuned_values import TunedValues
from shake_env.controller import Controller
from shake_env.errors import ScenarioError, unknown
from shake_env.renamed import CONTROLLERS, renamed
from shake_env.rollout import Earthquake
from shake_env.scenario.digest import known_name
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import Scenario

ORACLE = "oracle"  # a full-state law for the true plants, see `baselines.lqr.oracle`
# Policies that come with the package, by algorithm; dagger-apg is dagger's continued by gradients, and
# dagger-apg-long that one's by more of them.
SHIPPED = ("ppo", "apg", "dagger", "dagger-apg", "dagger-apg-long", "sac")


@dataclass(frozen=True)
class ControllerEntry:
    """What a name stands for.

    ``classical`` is designed from the model (`baselines.registry.CLASSICAL`), ``oracle`` likewise for
    the true plants; ``shipped`` is a policy that comes with the package; ``own`` a class of the user's
    (`agents.policies.own_controller`); ``file`` a policy file or run directory.
    """

    name: str
    kind: Literal["classical", "oracle", "shipped", "own", "file"]
    summary: str = ""
    tests: int = 1  # of each earthquake that using it takes, the one that counts included
    knows_motion: bool = False  # whether it is planned for a motion before the test

    @property
    def is_designed(self) -> bool:
        """Whether it has parameters with values of `values_for`."""
        return self.kind in ("classical", "own")

    @property
    def needs_earthquakes(self) -> bool:
        """Whether it is made for given earthquakes, not for any."""
        return self.kind == "oracle" or self.tests > 1 or self.knows_motion


@lru_cache
def controllers() -> dict[str, ControllerEntry]:
    """Return every controller that has a name, classical ones first."""
    entries = [
        ControllerEntry(name, "classical", each.summary, each.tests, each.knows_motion)
        for name, each in BASELINES.items()
    ]
    entries += [ControllerEntry(name, "classical", summary) for name, summary in SUMMARIES.items()]
    entries.append(
        ControllerEntry(ORACLE, "oracle", "linear law for the true plant: full state, 0.5 s of preview")
    )
    for name in SHIPPED:
        shipped = (_shipped_file(name, scenario) for scenario in NAMED)
        files = dict.fromkeys(file.stem for file in shipped if file is not None)
        summary = f"learned; by scenario: {', '.join(files)}"
        entries.append(ControllerEntry(name, "shipped", summary))
    return {entry.name: entry for entry in entries}


def find_controller(name: str, *others: str) -> ControllerEntry:
    """Return what a name stands for.

    Parameters
    ----------
    name
        Of `controllers`, ``module:Class`` or ``file.py:Class``, or the path of a policy file or run
        directory.
    others
        Further words that an error lists as known.

    Raises
    ------
    ScenarioError
        If it is none of these.
    """
    name = renamed("controller", name, CONTROLLERS)
    known = controllers()
    if name in known:
        return known[name]
    if is_own_controller(name):
        return ControllerEntry(name, "own")
    if Path(name).exists() or "/" in name or "." in name:
        return ControllerEntry(name, "file")
    raise unknown(ScenarioError, "controller", name, [*known, *others])


def get_controller(
    name: str,
    scenario: Scenario,
    earthquakes: Sequence[Earthquake] | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Controller:
    """Return a controller for a scenario.

    Parameters
    ----------
    name
        As `find_controller` takes it; not the oracle, which has a scenario of its own (`get_driven`).
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
    entry = find_controller(name)
    if entry.kind == "oracle":
        raise ScenarioError("controller", name, "is made for given earthquakes: use shake compare")
    if entry.is_designed:
        classical = entry.kind == "classical"
        baseline = baseline_of(entry.name, scenario) if classical else own_baseline(entry.name)
        if parameters is None:
            parameters = parameter_values(entry.name, scenario).parameters
        return designed_controller(entry.name, baseline, scenario, parameters, earthquakes)
    return load_policy(policy_path(entry.name, known_name(scenario))).reading(scenario)


def get_driven(
    name: str,
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    parameters: Mapping[str, float] | None = None,
) -> tuple[Scenario, Controller]:
    """Return the scenario that a controller is run on, and the controller; see `get_controller`.

    The scenario differs for the oracle alone: it observes the full state and a preview.
    """
    if find_controller(name).kind == "oracle":
        return oracle_controller(scenario, earthquakes)
    return scenario, get_controller(name, scenario, earthquakes, parameters)


def information_of(name: str, scenario: Scenario) -> Information:
    """Return the class of what a controller, named as for `find_controller`, knows on a scenario.

    A policy or a controller of one's own is taken to use all that the scenario shows.
    """
    entry = find_controller(name)
    if entry.kind == "oracle":
        return "true plant"
    if entry.kind == "classical":
        return baseline_of(entry.name, scenario).information(scenario)
    return scenario_information(scenario)


def values_for(
    name: str, scenario: Scenario, tuned: TunedValues | None = None
) -> ParameterValues | None:
    """Return a controller's parameter values and their source; None for a policy and the oracle.

    See `baselines.registry.parameter_values`.
    """
    entry = find_controller(name)
    return parameter_values(entry.name, scenario, tuned) if entry.is_designed else None


def policy_path(name: str, scenario_name: str = "linear") -> Path:
    """Return the path of a policy file: one that ships, as the scenario has it, or that of a path.

    A run directory stands for its policy; while it is not finished, for the best one so far.
    """
    name = renamed("controller", name, CONTROLLERS)
    if name in SHIPPED:
        return shipped_policy(name, scenario_name)
    path = Path(name)
    return policy_of_run(path) if path.is_dir() else path


@lru_cache
def _trained_on(scenario_name: str) -> str:
    """Return the scenario that policies for a scenario are trained on."""
    return (NAMED[scenario_name]().train_on if scenario_name in NAMED else None) or scenario_name


def shipped_policy(algorithm: str = "ppo", scenario_name: str = "linear") -> Path:
    """Return the file of a policy that comes with the package.

    Parameters
    ----------
    algorithm
        Of `SHIPPED`.
    scenario_name
        Whose policy is asked for. The records are driven by the laboratory's, for nothing is trained on
        them; a scenario without a policy of its own gets the linear table's, if it fits.

    Raises
    ------
    ScenarioError
        If no policy of that algorithm comes with the package, or none for such a scenario.
    """
    algorithm = renamed("controller", algorithm, CONTROLLERS)
    if algorithm not in SHIPPED:
        raise unknown(ScenarioError, "shipped policy", algorithm, SHIPPED)
    file = _shipped_file(algorithm, scenario_name)
    if file is None:
        remedy = f"none ships for {scenario_name}: shake list policies names those that do"
        raise ScenarioError("shipped policy", algorithm, remedy)
    return file


def _shipped_file(algorithm: str, scenario_name: str) -> Path | None:
    folder = Path(str(resources.files("agents").joinpath("pretrained")))
    for stem in (_trained_on(scenario_name), "linear"):
        file = folder / f"{stem}-{algorithm}.safetensors"
        if file.is_file():
            return file
    return None


def policies_trained_for(scenario_name: str) -> tuple[str, ...]:
    """Return the algorithms, in the order of `SHIPPED`, whose policy was trained for a scenario."""
    stem = _trained_on(scenario_name)
    files = {name: _shipped_file(name, scenario_name) for name in SHIPPED}
    return tuple(name for name, file in files.items() if file and file.stem == f"{stem}-{name}")


__all__ = [
    "CLASSICAL",
    "ORACLE",
    "SHIPPED",
    "ControllerEntry",
    "controllers",
    "find_controller",
    "get_controller",
    "get_driven",
    "information_of",
    "policy_path",
    "shipped_policy",
    "values_for",
]
