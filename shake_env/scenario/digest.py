"""A digest of what a scenario is: scenarios of one digest are the same task for a controller."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from numbers import Real
from typing import Any

import numpy as np

from shake_env.motion.targets import FilteredNoise, MotionSet, RecordedMotion
from shake_env.scenario.observation import Sensor
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import Scenario

LEFT_OUT = ("name", "train_on", "table")  # fields of a scenario that do not change the task
VERSION = 1  # of the canonical form
# Fields that joined a part of a scenario after version 1: their path from the scenario, and the value at
# which nothing is other than it was before. At that value they are left out of the canonical form.
ADDED_FIELDS: Mapping[str, Any] = {
    "nonlinearity.valve.supply_sag": 0.0,
    "sensing.sensors.gain_error": 0.0,
}
# What distinguishes motions in the canonical form, whatever their classes are called.
_MOTION_KINDS = ((FilteredNoise, "filtered noise"), (RecordedMotion, "record"), (MotionSet, "set"))


def scenario_digest(scenario: Scenario) -> str:
    """Return the digest of a scenario, ``VERSION:HEX``.

    Plant (actuator, specimen, ground filter, equations, nonlinear parts, delay, uncertainty), sensing,
    limits, motion, objective, rates and the action's unit are in it. The name and the length of filtered
    noise are not: a longer test of the same kind asks for the same controller. The canonical form
    is JSON with sorted keys and without what is None, False or empty. Numbers are written with nine
    significant digits, so that the last bits of a derived value (a platform's own ``pow``) do not count,
    and a record counts by its samples. It depends on neither Python's version nor the platform.
    """
    parts = {f.name: getattr(scenario, f.name) for f in fields(scenario) if f.name not in LEFT_OUT}
    parts["sensing"] = replace(scenario.sensing, preview_spacing=_spacing(scenario))
    plain = {name: _canonical(value, name) for name, value in parts.items()}
    text = json.dumps(_without_empty(plain), sort_keys=True, separators=(",", ":"))
    return f"{VERSION}:{hashlib.sha256(text.encode()).hexdigest()[:32]}"


def _spacing(scenario: Scenario) -> float | None:
    """Return the spacing of the preview's samples [s]; None where it is the control period.

    So that the form says what is shown, and is that of before where that is the same: in version 1
    None stood for the control period.
    """
    samples, steps = scenario.sensing.preview_steps(scenario.physics_step)
    return steps * scenario.physics_step if samples and steps != scenario.substeps else None


def known_name(scenario: Scenario) -> str:
    """Return the name of the named scenario that a scenario is, whatever it is called; else its own."""
    if scenario.name in NAMED and scenario == NAMED[scenario.name]():
        return scenario.name
    digest = scenario_digest(scenario)
    return next((name for name in NAMED if named_digest(name) == digest), scenario.name)


@lru_cache(maxsize=len(NAMED))
def named_digest(name: str) -> str:
    """Return the digest of a named scenario."""
    return scenario_digest(NAMED[name]())


def _canonical(value: Any, path: str) -> Any:
    if path in ADDED_FIELDS and value == ADDED_FIELDS[path]:
        return None
    if isinstance(value, RecordedMotion):
        record = value.source
        samples = [_canonical(record.sampling_interval, path), record.digest.hex()]
        return _parts(value, path, "record") | {"record": samples}
    if isinstance(value, FilteredNoise):
        return _parts(value, path, "duration")
    if is_dataclass(value):
        return _parts(value, path)
    if isinstance(value, tuple | list | np.ndarray):
        return [_canonical(item, path) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, Real):
        return format(float(value) + 0.0, ".9g")  # the sum makes -0 a 0
    return value


def _parts(value: Any, path: str, *left_out: str) -> dict[str, Any]:
    names = [f.name for f in fields(value) if f.name not in left_out]
    plain = {name: _canonical(getattr(value, name), f"{path}.{name}") for name in names}
    if plain.get("lowpass_frequency") is not None and isinstance(value, Sensor):
        plain["lowpass"] = "analogue"  # in version 1 it was sampled at the control rate
    kinds = [kind for motion, kind in _MOTION_KINDS if isinstance(value, motion)]
    return _without_empty(plain) | ({"kind": kinds[0]} if kinds else {})


def _without_empty(plain: dict[str, Any]) -> dict[str, Any]:
    return {name: each for name, each in plain.items() if each not in (None, False, [], {})}
