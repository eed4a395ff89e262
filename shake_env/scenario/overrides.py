"""Scenarios by name, and a scenario with some of its parts changed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypedDict

from shake_env.errors import ScenarioError, unknown
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import ModelEquations, Specimen
from shake_env.motion.processing import fit_amplitude
from shake_env.motion.targets import FilteredNoise, Motion, MotionSet, RecordedMotion
from shake_env.scenario.builder import with_fields
from shake_env.scenario.capacity import scenario_capacity
from shake_env.scenario.limits import Limits
from shake_env.scenario.objective import Objective
from shake_env.scenario.observation import Sensing
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import UNIFORM, Scenario
from shake_env.scenario.scenario_file import is_scenario_file, read_scenario
from shake_env.scenario.tables.on_table import on_table
from shake_env.scenario.tables.table import named_table
from shake_env.scenario.uncertainty import Uncertainty

# Names of results that stand for another scenario with something changed.
HINTS = {
    "friction": "that is linear with --set nonlinearity.friction.coulomb=300; ",
    "friction-coarse": (
        "that is linear with --set nonlinearity.friction.coulomb=300 --physics-step 0.005; "
    ),
}


class Overrides(TypedDict, total=False):
    """What can be changed about a scenario by a word; anything else by its path in ``fields``."""

    table: str
    stories: int
    mass_ratio: float
    storey_frequency: float
    damping_ratio: float
    specimen: Specimen
    equations: str | ModelEquations
    physics_step: float
    control_rate: float
    acceleration_weight: float
    force_weight: float
    current_weight: float
    objective: Objective
    motion: Motion
    record: str
    amplitude: float
    duration: float
    time_compression: float
    highpass_frequency: float
    current_limit: float
    limits: str | Limits
    nonlinearity: Nonlinearity
    delay: float
    uncertainty: Uncertainty
    sensing: str | Sensing
    fields: Mapping[str, Any]


_WEIGHTS = ("acceleration_weight", "force_weight", "current_weight")
_MOTION = ("amplitude", "duration", "time_compression")
_DIRECT = (
    "specimen", "objective", "motion", "physics_step", "control_rate", "current_limit", "nonlinearity",
    "delay", "uncertainty",
)  # fmt: skip


def make_scenario(
    scenario: str | os.PathLike[str] | Scenario = "linear", overrides: Overrides | None = None
) -> Scenario:
    """Return a scenario by its name, from its file or as given, with some of its parts changed.

    Parameters
    ----------
    scenario
        A name (``"linear"``, ``"as-printed"``, ``"laboratory"``, ``"unknown-specimen"``,
        ``"yielding"``, ``"field"``, ``"records"``), the path of a scenario file (it ends in ``.toml`` or
        ``.json``, or is an ``os.PathLike``; see `read_scenario`), or a scenario.
    overrides
        ``table``: the name of another table (`shake_env.scenario.tables.TABLE_NAMES`), with limits,
        amplitudes and sensors that follow from it (`on_table`), before everything else;
        ``stories``, ``mass_ratio``, ``storey_frequency`` [Hz], ``damping_ratio`` (equal storeys) or
        ``specimen``; ``equations`` ("corrected", "as_printed" or a value); ``physics_step`` [s],
        ``control_rate`` [Hz]; ``acceleration_weight``, ``force_weight``, ``current_weight`` or
        ``objective``; ``motion``, or ``record`` (its name), ``amplitude``, ``duration`` [s],
        ``time_compression``; ``highpass_frequency`` [Hz] of the ground filter; ``current_limit`` [A];
        ``limits`` ("off", "laboratory" or a value); ``nonlinearity``, ``delay`` [physics steps],
        ``uncertainty``; ``sensing`` ("full", "laboratory" or a value). ``fields`` changes any field by
        its path, after the others: ``{"nonlinearity.friction.coulomb": 300.0}`` (see `with_fields`).
        A record for a table with a limited stroke is scaled to it, unless ``amplitude`` is given.

    Raises
    ------
    ScenarioError
        If the name or an override is unknown, two of them contradict each other, or the file is no
        scenario (see `read_scenario`).
    ParameterError
        If a value is outside its range.
    """
    if isinstance(scenario, str | os.PathLike) and is_scenario_file(scenario):
        scenario = read_scenario(scenario)
    elif isinstance(scenario, str):
        if scenario not in NAMED:
            error = unknown(ScenarioError, "scenario", scenario, [*NAMED, "FILE.toml"])
            raise ScenarioError("scenario", scenario, HINTS.get(scenario, "") + error.remedy)
        scenario = NAMED[scenario]()
    if not isinstance(scenario, Scenario):
        raise ScenarioError("scenario", scenario, "must be a Scenario or the name of one")
    given: dict[str, Any] = dict(overrides or {})
    for name in given:
        if name not in Overrides.__annotations__:
            raise unknown(ScenarioError, "scenario option", name, Overrides.__annotations__)
    if "table" in given:
        scenario = on_table(scenario, named_table(given["table"]))
    changes: dict[str, Any] = {name: given[name] for name in _DIRECT if name in given}
    _exclusive(given, "specimen", UNIFORM)
    _exclusive(given, "objective", _WEIGHTS)
    _exclusive(given, "motion", (*_MOTION, "record"))
    if any(name in given for name in UNIFORM):
        now = scenario.specimen.uniform_values(scenario.actuator.table_mass)
        now.update({name: given[name] for name in UNIFORM if name in given})
        changes["specimen"] = Specimen.uniform(**now, table_mass=scenario.actuator.table_mass)
    if any(name in given for name in _WEIGHTS):
        weights = {name: given[name] for name in _WEIGHTS if name in given}
        changes["objective"] = replace(scenario.objective, **weights)
    if "highpass_frequency" in given:
        changes["ground"] = replace(scenario.ground, highpass_frequency=given["highpass_frequency"])
    if "equations" in given:
        form = given["equations"]
        changes["equations"] = form if isinstance(form, ModelEquations) else ModelEquations.named(form)
    if "limits" in given:
        limits = given["limits"]
        changes["limits"] = limits if isinstance(limits, Limits) else Limits.named(str(limits))
    if "sensing" in given:
        sensing = given["sensing"]
        changes["sensing"] = sensing if isinstance(sensing, Sensing) else Sensing.named(str(sensing))
    changed = replace(scenario, **changes)
    if "record" in given or any(name in given for name in _MOTION):
        changed = replace(changed, motion=_changed_motion(changed, given))
    fields = given.get("fields", {})
    if fields.get("table", changed.table) != changed.table:
        remedy = "as a field is a name alone: give --table NAME, in Python the option table"
        raise ScenarioError("table", fields["table"], remedy)
    final: Scenario = with_fields(changed, fields)
    return final


def _exclusive(given: dict[str, Any], whole: str, parts: tuple[str, ...]) -> None:
    clash = [name for name in parts if name in given]
    if whole in given and clash:
        raise ScenarioError(
            whole, given[whole], f"contradicts {', '.join(clash)}: give one or the other"
        )


def _changed_motion(scenario: Scenario, given: dict[str, Any]) -> Motion:
    motion, changes = scenario.motion, {name: given[name] for name in _MOTION if name in given}
    if "record" in given:
        return _record(scenario, given["record"], changes)
    if isinstance(motion, MotionSet):
        each = {name: value for name, value in changes.items() if name != "amplitude"}
        motions = tuple(replace(member, **each) for member in motion.motions)
        return MotionSet(motions, amplitude=changes.get("amplitude", motion.amplitude))
    if isinstance(motion, FilteredNoise) and "time_compression" in changes:
        raise ScenarioError(
            "time_compression", changes["time_compression"], "compresses a record: name one by record="
        )
    return replace(motion, **changes)


def _record(scenario: Scenario, record: Any, changes: dict[str, Any]) -> RecordedMotion:
    if "amplitude" in changes:
        return RecordedMotion(record=record, **changes)
    if scenario.limits.table_displacement is None:
        return RecordedMotion(record=record, amplitude=scenario.motion.amplitude, **changes)
    motion = RecordedMotion(record=record, **changes)
    return fit_amplitude(motion, scenario_capacity(scenario), physics_step=scenario.physics_step).motion
