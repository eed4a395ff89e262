"""Options that several commands share, as typed dataclasses; tyro makes the command line of them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal

import tyro

from shake_env.errors import ScenarioError
from shake_env.scenario.overrides import Overrides, make_scenario
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_file import (
    is_scenario_file,
    read_scenario,
    scenario_fields,
    scenario_of,
)

SCENARIO_HELP = (
    f"Name of the scenario ({', '.join(NAMED)}), or a file that shake show-scenario --write wrote."
)


@dataclass(frozen=True)
class ScenarioOptions:
    """The scenario, and what to change about it (unset: the scenario's own value)."""

    scenario: Annotated[str, tyro.conf.arg(help=SCENARIO_HELP)] = "linear"
    table: str | None = None
    """Name of another table (shake list tables); limits, amplitudes and sensors follow from it. Its
    friction, valve and limits are in the scenario laboratory."""
    stories: int | None = None
    """Number of storeys of the specimen."""
    mass_ratio: float | None = None
    """Specimen mass over table mass, mu [-]."""
    storey_frequency: float | None = None
    """Frequency sqrt(k/m) of one storey [Hz]."""
    damping_ratio: float | None = None
    """Damping ratio of one storey [-]."""
    equations: Literal["corrected", "as_printed"] | None = None
    """Form of the paper's equations."""
    control_rate: float | None = None
    """Control rate [Hz]; its period must be a whole number of physics steps."""
    physics_step: float | None = None
    """Physics step [s]."""
    acceleration_weight: float | None = None
    """Weight of acceleration tracking [-]."""
    force_weight: float | None = None
    """Weight of base-shear tracking [-]."""
    current_weight: float | None = None
    """Weight of the valve current [-]."""
    amplitude: float | None = None
    """Factor on the target motion [-]."""
    duration: float | None = None
    """Length of a filtered-noise earthquake [s]."""
    highpass_frequency: float | None = None
    """Clough-Penzien high-pass of the ground filter [Hz]."""
    current_limit: float | None = None
    """Current of action 1 [A]."""
    limits: Literal["off", "laboratory"] | None = None
    """Limits whose breaking ends an episode."""
    sensing: Literal["full", "laboratory"] | None = None
    """What a controller sees: the full state, or a laboratory's signals."""
    delay: float | None = None
    """Loop delay [physics steps]."""
    set: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Any other field as PATH=VALUE, in SI or with a unit: nonlinearity.friction.coulomb=300,
    "limits.table_displacement=70 mm", uncertainty.mass_ratio=[0.1,1]; may be given again."""
    values: tyro.conf.Suppress[dict[str, Any] | None] = None
    """Every field of a scenario that came from a file, in place of its name; see `without_file`."""

    def build(self) -> Scenario:
        """Return the scenario.

        Raises
        ------
        ScenarioError
            If a name, a path or its value is not understood, or a scenario file is none.
        """
        base = self.scenario if self.values is None else scenario_of(self.values)
        overrides = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name not in ("scenario", "set", "values") and getattr(self, field.name) is not None
        }
        overrides["fields"] = dict(assignment(text) for text in self.set)
        return make_scenario(base, Overrides(**overrides))  # type: ignore[typeddict-item]  # same names

    def without_file(self) -> ScenarioOptions:
        """Return these options with the contents of a scenario file in place of its path.

        What is kept for later, such as the configuration of a training run, must not depend on a file
        that may change or move.
        """
        if self.values is not None or not is_scenario_file(self.scenario):
            return self
        scenario = read_scenario(self.scenario)
        return replace(self, scenario=scenario.name, values=scenario_fields(scenario))


def assignment(text: str) -> tuple[str, Any]:
    """Return path and value of ``--set PATH=VALUE``; the value is JSON, or else a word.

    Raises
    ------
    ScenarioError
        If there is no equals sign.
    """
    path, separator, value = text.partition("=")
    if not separator or not path:
        raise ScenarioError("set", text, "must be PATH=VALUE, such as nonlinearity.friction.coulomb=300")
    if value.lower() in ("none", "inf"):
        return path, None if value.lower() == "none" else math.inf
    try:
        return path, json.loads(value)
    except json.JSONDecodeError:
        return path, value


def given_options(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those fields of scenario options, as values or as JSON, that say something; a zero does."""
    return {key: value for key, value in values.items() if value not in (None, (), [])}
