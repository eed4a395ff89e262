"""The log of one test: what was commanded and what was measured, in SI, with the scenario's file.

Sample j is taken at the end of control period j. The command of a sample is the one that was held over
the period that ends there. A log begins with the table and the specimen at rest.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from shake_env.errors import LogError, ShakeError
from shake_env.model.parameters import FloatArray
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_file import scenario_fields, scenario_of

TARGET, CURRENT = "target_acceleration", "current"
COMMANDED = (TARGET, CURRENT)
UNITS = {
    TARGET: "m/s^2",
    CURRENT: "A",
    "table_displacement": "m",
    "table_velocity": "m/s",
    "table_acceleration": "m/s^2",
    "load_pressure": "Pa",
    "spool_position": "m",
    "base_shear": "N",
}
MEANINGS = {
    TARGET: "acceleration that the table was asked to repeat",
    CURRENT: "command to the valve, held over the control period that ends at the sample",
    "table_displacement": "displacement of the table from the middle of its stroke",
    "table_velocity": "velocity of the table",
    "table_acceleration": "acceleration of the table",
    "load_pressure": "pressure difference over the piston",
    "spool_position": "position of the valve's spool",
    "base_shear": "shear force of the specimen on the table",
}
_FLOOR = re.compile(r"floor_acceleration_([1-9]\d{0,2})")
LEAST, MOST = 64, 20_000_000  # samples of a log
LARGEST = 1e15  # of any value in SI


def unit_of(channel: str) -> str:
    """Return the SI unit of a channel.

    Raises
    ------
    LogError
        If there is no channel of that name.
    """
    if channel in UNITS:
        return UNITS[channel]
    if _FLOOR.fullmatch(channel):
        return "m/s^2"
    known = ", ".join([*UNITS, "floor_acceleration_1"])
    raise LogError("channel", channel, f"is no channel of a log; known: {known}, and so on")


def meaning_of(channel: str) -> str:
    """Return what a channel measures."""
    floor = _FLOOR.fullmatch(channel)
    return f"absolute acceleration of floor {floor[1]}" if floor else MEANINGS[channel]


@dataclass(frozen=True)
class TestLog:
    """One test.

    Raises
    ------
    LogError
        If a channel is unknown, missing, empty, of another length or not finite, the step is not above
        zero, or the scenario's text contradicts its digest.
    """

    __test__ = False  # no test of pytest's

    name: str
    sampling_interval: float  # [s]
    channels: Mapping[str, FloatArray]  # (samples,) by name, SI
    scenario_text: str | None = None  # file of the scenario that it was driven with, JSON; None: unknown
    digest: str | None = None  # of that scenario
    source: str = ""  # file that it was read from, and its format
    input_unit: str = field(default="A")  # of `current`: A, or V on a table that is driven in volts

    def __post_init__(self) -> None:
        step = self.sampling_interval
        if not (isinstance(step, float | int) and math.isfinite(step) and step > 0.0):
            raise LogError("sampling_interval", step, "must be a number of seconds above 0")
        if self.input_unit not in ("A", "V"):
            raise LogError("input_unit", self.input_unit, "must be A or V")
        for name in COMMANDED:
            if name not in self.channels:
                raise LogError("channels", sorted(self.channels), f"must hold {name}")
        if len(self.channels) == len(COMMANDED):
            raise LogError("channels", sorted(self.channels), "must hold a measured channel, too")
        samples = len(self.channels[CURRENT])
        if not LEAST <= samples <= MOST:
            raise LogError("samples", samples, f"must be {LEAST} to {MOST}")
        for name, values in self.channels.items():
            unit = unit_of(name)
            if values.ndim != 1 or values.dtype != np.float64 or len(values) != samples:
                raise LogError(name, values.shape, f"must hold {samples} numbers, as {CURRENT} does")
            wrong = np.flatnonzero(~(np.abs(values) <= LARGEST))
            if len(wrong):
                at, value = int(wrong[0]), float(values[wrong[0]])
                raise LogError(
                    f"{name}, sample {at + 1}", value, f"must be finite, below {LARGEST:g} {unit}"
                )
        if self.scenario_text is not None:
            made = scenario_digest(self.scenario)
            if self.digest is not None and made != self.digest:
                raise LogError("digest", self.digest, f"is not that of the scenario's text, {made}")

    @property
    def samples(self) -> int:
        """Number of samples of each channel."""
        return len(self.channels[CURRENT])

    @property
    def duration(self) -> float:
        """Length of the test [s]."""
        return self.samples * self.sampling_interval

    @property
    def time(self) -> FloatArray:
        """Time of each sample (samples,) [s]; the table is at rest at time 0."""
        return self.sampling_interval * np.arange(1, self.samples + 1, dtype=np.float64)

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measured channels, in order."""
        return tuple(name for name in self.channels if name not in COMMANDED)

    @property
    def scenario(self) -> Scenario:
        """The scenario that the test was driven with.

        Raises
        ------
        LogError
            If the log holds none, or its text is no scenario.
        """
        if self.scenario_text is None:
            raise LogError("scenario", None, f"the log {self.name} holds none: give a scenario's file")
        return scenario_of_text(self.scenario_text)

    @property
    def sha256(self) -> str:
        """Digest of everything that the log holds but its name and source."""
        head = [self.sampling_interval.hex(), self.input_unit, self.scenario_text, self.digest]
        whole = hashlib.sha256(json.dumps(head).encode())
        for name in sorted(self.channels):
            whole.update(name.encode())
            whole.update(self.channels[name].astype("<f8").tobytes())
        return whole.hexdigest()


def text_of_scenario(scenario: Scenario) -> str:
    """Return the JSON file of a scenario, records included, that :func:`scenario_of_text` reads."""
    return json.dumps({"name": scenario.name, "fields": scenario_fields(scenario)})


def scenario_of_text(text: str) -> Scenario:
    """Return the scenario of :func:`text_of_scenario`.

    Raises
    ------
    LogError
        If the text is no scenario.
    """
    try:
        content: Any = json.loads(text)
        if not isinstance(content, dict) or not isinstance(content.get("fields"), dict):
            raise TypeError("the key 'fields' is missing or no object")
        return scenario_of(content["fields"])
    except ShakeError as error:
        raise LogError(f"scenario, {error.field}", error.value, error.remedy) from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        what = f"the key {error} is missing" if isinstance(error, KeyError) else str(error)[:200]
        remedy = "is no scenario that this program wrote: take the file from a copy, or write it anew"
        raise LogError("scenario", what, remedy) from None


SAME = (
    "control_rate", "physics_step", "current_limit", "actuator", "nonlinearity", "delay", "specimen",
    "sensing",
)  # fmt: skip


SHOWN = {"preview": 0.0, "preview_spacing": None, "last_action": False, "history": 0}


def require_same_test(
    given: Scenario, wanted: Scenario, name: str, *, but: tuple[str, ...] = ()
) -> None:
    """Raise LogError, naming the first field, where two scenarios differ in what a log depends on."""
    for field_name in SAME:
        ours, theirs = getattr(wanted, field_name), getattr(given, field_name)
        if field_name == "sensing":  # what a controller is shown beside its sensors is in no log
            ours, theirs = (replace(each, **SHOWN) for each in (ours, theirs))
        if field_name in but or ours == theirs:
            continue
        if field_name in ("actuator", "nonlinearity", "specimen", "sensing"):
            parts = [p for p in vars(ours) if getattr(ours, p) != getattr(theirs, p, None)]
            part = parts[0] if parts else ""
            ours, theirs = getattr(ours, part, ours), getattr(theirs, part, theirs)
            field_name = f"{field_name}.{part}"
        raise LogError(
            f"{name}, {field_name}", theirs, f"the log is of another table or test: expected {ours}"
        )
