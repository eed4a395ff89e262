"""Classical controllers by name, with the values that were tuned for a scenario.

Values that `shake tune` has found for a named scenario stand in ``tuned.json`` and are taken unless
others are given.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources
from typing import Any

from baselines.catalogue import BASELINES
from shake_env.controller import Controller
from shake_env.errors import ScenarioError, unknown
from shake_env.rollout import Earthquake
from shake_env.scenario import Scenario


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
        Of `BASELINES`.
    scenario
        What it is to drive.
    parameters
        Its tunable parameters; None takes what was tuned for the scenario's name, and defaults else.
    earthquakes
        One a lane of the roll-out; needed by a controller that repeats its tests beforehand.

    Raises
    ------
    ScenarioError
        If there is none of that name, a parameter is unknown, the scenario does not suit it, or it needs
        earthquakes and none are given.
    """
    if name not in BASELINES:
        raise unknown(ScenarioError, "controller", name, BASELINES)
    baseline = BASELINES[name]
    chosen = tuned_parameters(name, scenario.name) if parameters is None else dict(parameters)
    for each in chosen:
        if each not in baseline.tunable:
            raise unknown(ScenarioError, f"parameter of {name}", each, baseline.tunable)
    values = {each: tunable.default for each, tunable in baseline.tunable.items()} | chosen
    if not baseline.repeats_tests:
        return baseline.make(scenario, **values)
    if earthquakes is None:
        raise ScenarioError("controller", name, "repeats its tests beforehand: use shake compare")
    return baseline.make(scenario, earthquakes, **values)


def tuned_parameters(name: str, scenario_name: str) -> dict[str, float]:
    """Return the tuned parameters of a controller for a named scenario; none where nothing was tuned.

    What was tuned for `laboratory` holds for `records`, whose table is the same: nothing is tuned on the
    records that controllers are judged by.
    """
    source = "laboratory" if scenario_name == "records" else scenario_name
    found = _tuned().get(source, {}).get(name, {}).get("parameters", {})
    return {each: float(value) for each, value in found.items()}


@lru_cache(maxsize=1)
def _tuned() -> dict[str, Any]:
    file = resources.files("baselines") / "tuned.json"
    if not file.is_file():
        return {}
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


def reference_name(scenario: Scenario) -> str:
    """Return the controller that costs are relative to.

    LQR where the state is shown and nothing else asks for more; with a preview or limits the LQR that
    sees the one and minds the other; with an estimator where signals are shown or the loop has a delay.
    """
    if not scenario.sensing.full_state or scenario.delay:
        return "lqg"
    limited = scenario.limits.table_displacement is not None and scenario.ground.states == 4
    return "preview-lqr" if scenario.sensing.preview or limited else "lqr"
