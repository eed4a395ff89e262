"""The controllers that a list of names stands for, with what a reader has to know about each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cloudpickle

from agents.evaluation.training_distance import training_warning
from agents.policies.policy_file import PolicyFile
from agents.policies.registry import find_controller, get_controller, values_for
from baselines.catalogue import BASELINES
from baselines.registry import ParameterValues, reference_name
from baselines.searched_lqg import SEARCHED
from baselines.tuned_values import TunedValues
from shake_env.controller import Controller
from shake_env.errors import ParameterError, PolicyFileError, ShakeError
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario import Scenario

ALL = "all"  # stands for every classical controller that suits the scenario


@dataclass
class ControllerSet:
    """Controllers by name, the reference first."""

    controllers: dict[str, Controller] = field(default_factory=dict)
    values: dict[str, ParameterValues] = field(default_factory=dict)  # of those that have parameters
    skipped: list[str] = field(default_factory=list)  # what was left out, and why
    warnings: list[str] = field(default_factory=list)  # policies far from what they were trained on
    oracle: bool = False  # whether the oracle was named, which runs on a scenario of its own


def get_controllers(
    names: Sequence[str],
    scenario: Scenario,
    earthquakes: Sequence[Earthquake] | None = None,
    tuned: TunedValues | None = None,
) -> ControllerSet:
    """Return the controllers that names stand for.

    Parameters
    ----------
    names
        As `find_controller` takes them; ``all`` for every law of `baselines.catalogue` that suits the
        scenario and what an independent search has found for it; ``oracle``. The reference, which
        costs are relative to, is always among them.
    scenario
        What they drive. What ``all`` or ``ppo`` stand for is left out where it does not suit; what is
        named raises.
    earthquakes
        One a lane; needed by controllers that repeat their tests beforehand.
    tuned
        Tuned values of a file that was named; see `baselines.registry.parameter_values`.

    Raises
    ------
    ScenarioError
        If a named controller does not suit the scenario.
    PolicyFileError
        If a named policy cannot be read or does not fit the scenario.
    """
    result = ControllerSet()

    def add(name: str) -> None:
        if name in result.controllers:
            return
        values = values_for(name, scenario, tuned)
        parameters = None if values is None else values.parameters
        controller = get_controller(name, scenario, earthquakes, parameters)
        result.controllers[name] = controller
        if values is not None:
            result.values[name] = values
        if isinstance(controller, PolicyFile) and (text := training_warning(controller, scenario)):
            result.warnings.append(f"{name} {text}")

    add(reference_name(scenario))
    for given in names:
        if given == ALL:
            for each in BASELINES:
                try:
                    add(each)
                except ShakeError as error:  # it does not suit the scenario, or its design fails there
                    result.skipped.append(f"{each} ({error})")
            for each in SEARCHED:
                values = values_for(each, scenario, tuned)
                if values is not None and values.source != "rule":
                    add(each)
            continue
        entry = find_controller(given, ALL)
        if entry.kind == "oracle":
            result.oracle = True
            continue
        try:
            add(entry.name)
        except PolicyFileError as error:
            if entry.kind != "shipped":
                raise
            result.skipped.append(f"the shipped {entry.name} ({error})")
    return result


class PortableController:
    """A controller that travels to another process: as it is, or made there again of what it is made of.

    Parameters
    ----------
    name, scenario, parameters
        As `get_controller` takes them; a solver's memory does not travel.
    """

    def __init__(
        self,
        controller: Controller,
        name: str,
        scenario: Scenario,
        parameters: Mapping[str, float] | None,
    ) -> None:
        self.controller = controller
        self._made_of = name, scenario, parameters

    def __reduce__(self) -> tuple[Any, ...]:
        try:
            content = cloudpickle.dumps(self.controller)
        except TypeError:
            content = None
        return _arrived, (content, *self._made_of)


def _arrived(
    content: bytes | None, name: str, scenario: Scenario, parameters: Mapping[str, float] | None
) -> PortableController:
    controller = (
        get_controller(name, scenario, None, parameters)
        if content is None
        else cloudpickle.loads(content)
    )
    return PortableController(controller, name, scenario, parameters)


def require_names(names: Sequence[str]) -> None:
    """Raise ParameterError where no controller is named."""
    if not names or not all(names):
        raise ParameterError("controllers", tuple(names), "name at least one, such as lqr, or all")


def describe_values(values: Mapping[str, Mapping[str, Any]]) -> str:
    """Return in a sentence where parameter values (as JSON) come from; empty: there are none."""
    by_source: dict[str, list[str]] = {}
    for name, each in values.items():
        by_source.setdefault(each["description"], []).append(name)
    parts = [f"{', '.join(names)}: {source}" for source, names in by_source.items()]
    return f"Parameter values: {'; '.join(parts)}." if parts else ""


def values_to_json(values: Mapping[str, ParameterValues]) -> dict[str, Any]:
    """Return controllers' parameter values and their sources as plain JSON values."""
    return {name: each.to_json() for name, each in values.items()}
