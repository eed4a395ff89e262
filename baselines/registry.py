"""Classical controllers by name, and where the values of their free parameters come from.

Values that `shake tune` has found belong to the scenario that they were tuned on, told by a digest of
all that it is but its name. A scenario for which nothing was tuned gets the controller's written rule,
or the values of a file that is named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from baselines.baseline import Baseline
from baselines.catalogue import BASELINES
from baselines.searched_lqg import LQG_SEARCHED, SEARCHED, searched_baseline
from baselines.tuned_values import TunedEntry, TunedValues, packaged_values
from shake_env.controller import Controller
from shake_env.errors import ScenarioError, unknown
from shake_env.renamed import CONTROLLERS, TUNABLES, renamed, renamed_keys
from shake_env.rollout import Earthquake
from shake_env.scenario.digest import known_name, named_digest, scenario_digest
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class ParameterValues:
    """Values of a controller's free parameters, and where they come from."""

    parameters: Mapping[str, float]  # those that are not the written rule's
    source: Literal["tuned", "file", "rule"]  # with the package; of a file that was named; neither
    description: str  # the source in words

    def to_json(self) -> dict[str, Any]:
        """Return the values and their source as plain JSON values."""
        return {**vars(self), "parameters": dict(self.parameters)}


CLASSICAL = (*BASELINES, *SEARCHED)  # names of all controllers that are designed, not trained
WRITTEN_RULE = ParameterValues(parameters={}, source="rule", description="written rule")


def parameter_values(name: str, scenario: Scenario, tuned: TunedValues | None = None) -> ParameterValues:
    """Return the values that a controller gets on a scenario.

    In this order: those of `tuned` for exactly this scenario; those that come with the package for
    exactly this scenario; those of `tuned` for another scenario; the written rule.

    Parameters
    ----------
    name
        Of the controller.
    scenario
        What it is designed for; its name does not count.
    tuned
        Values of a file that was named; None: there is none.

    Raises
    ------
    ParameterError
        If only the third applies, and the file holds values for several other scenarios.
    """
    name = renamed("controller", name, CONTROLLERS)
    name = LQG_SEARCHED if name in SEARCHED else name  # one search serves all of them
    digest = scenario_digest(scenario)
    if tuned is not None and (entry := tuned.exact(name, digest)):
        return _of_file(entry, tuned, "this scenario")
    if entry := packaged_values().exact(name, digest):
        return _of_package(entry, "tuned on this scenario")
    # Nothing is tuned on what controllers are judged by: the values of the scenario to train on serve.
    if scenario.train_on and digest == named_digest(known_name(scenario)):
        entry = packaged_values().exact(name, named_digest(scenario.train_on))
        if entry is not None:
            return _of_package(entry, f"tuned on {scenario.train_on}, the same table")
    if tuned is not None and (entry := tuned.only(name)):
        return _of_file(entry, tuned, f"{entry.scenario}, not this scenario")
    return WRITTEN_RULE


def _of_package(entry: TunedEntry, description: str) -> ParameterValues:
    return ParameterValues(parameters=entry.parameters, source="tuned", description=description)


def _of_file(entry: TunedEntry, tuned: TunedValues, where: str) -> ParameterValues:
    description = f"{tuned.source}, tuned on {where}"
    return ParameterValues(parameters=entry.parameters, source="file", description=description)


def tuned_parameters(name: str, scenario: Scenario) -> dict[str, float]:
    """Return the package's tuned values of a controller on exactly this scenario; {}: none."""
    return dict(parameter_values(name, scenario).parameters)


def make_baseline(
    name: str,
    scenario: Scenario,
    parameters: Mapping[str, float] | None = None,
    earthquakes: Sequence[Earthquake] | None = None,
) -> Controller:
    """Return the controller called `name`, designed on a scenario's nominal model.

    Parameters
    ----------
    name
        Of `CLASSICAL`.
    scenario
        What it is to drive.
    parameters
        Its free parameters, the written rule for those that are left out; None takes what was tuned for
        exactly this scenario (`parameter_values`), and the written rule else.
    earthquakes
        One a lane of the roll-out; needed by a controller that repeats its tests beforehand.

    Raises
    ------
    ScenarioError
        If there is none of that name, a parameter is unknown, the scenario does not suit it, or it needs
        earthquakes and none are given.
    """
    name = renamed("controller", name, CONTROLLERS)
    baseline = baseline_of(name, scenario)
    chosen = parameter_values(name, scenario).parameters if parameters is None else parameters
    return designed_controller(name, baseline, scenario, chosen, earthquakes)


def baseline_of(name: str, scenario: Scenario) -> Baseline:
    """Return the entry of a controller of `CLASSICAL`.

    Raises
    ------
    ScenarioError
        If there is none of that name.
    """
    if name in SEARCHED:
        return searched_baseline(scenario, name)
    if name not in BASELINES:
        raise unknown(ScenarioError, "controller", name, CLASSICAL)
    return BASELINES[name]


def designed_controller(
    name: str,
    baseline: Baseline,
    scenario: Scenario,
    parameters: Mapping[str, float],
    earthquakes: Sequence[Earthquake] | None = None,
) -> Controller:
    """Return a controller of a catalogue's entry; see `make_baseline`."""
    parameters = renamed_keys(f"parameter of {name}", parameters, TUNABLES.get(name, {}))
    for each in parameters:
        if each not in baseline.tunable:
            raise unknown(ScenarioError, f"parameter of {name}", each, baseline.tunable)
    values = {each: tunable.default for each, tunable in baseline.tunable.items()} | dict(parameters)
    if not baseline.takes_earthquakes:
        return baseline.make(scenario, **values)
    if baseline.check is not None:
        baseline.check(scenario)
    if earthquakes is None:
        why = "repeats its tests" if baseline.tests > 1 else "plans its motion"
        raise ScenarioError("controller", name, f"{why} beforehand: use shake compare")
    return baseline.make(scenario, earthquakes, **values)


def reference_name(scenario: Scenario) -> str:
    """Return the controller that costs are relative to.

    LQR where the state is shown and nothing else asks for more; with a preview or limits the LQR with
    preview and displacement weight; with an estimator where signals are shown or the loop has a delay.
    """
    if not scenario.sensing.full_state or scenario.delay:
        return "lqg"
    limited = scenario.limits.table_displacement is not None and scenario.ground.states == 4
    return "preview-lqr" if scenario.sensing.preview or limited else "lqr"
