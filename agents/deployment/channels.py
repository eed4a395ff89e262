"""What an exported program reads and gives: names, units and SI sizes, as the scenario has them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class Channel:
    """One input or output of a program.

    A program works on ``value / scale``; `scale` is the SI size of 1.
    """

    name: str  # what it is, in words
    unit: str  # SI; "-" for a number without one
    scale: float

    @property
    def identifier(self) -> str:
        """The name as C and FMI take it."""
        return identifier(self.name)


def identifier(text: str) -> str:
    """Return a name of letters, digits and underscores that begins with a letter; a prime is a rate."""
    plain = re.sub(r"[^0-9A-Za-z]+", "_", text.replace("'", " rate")).strip("_")
    return plain if plain[:1].isalpha() else f"x_{plain}"


def named_channels(names: Iterable[str], scales: FloatArray) -> tuple[Channel, ...]:
    """Return channels of names such as ``"table velocity [m/s]"``; equal names are numbered."""
    made: list[Channel] = []
    taken: set[str] = set()
    for text, scale in zip(names, scales, strict=True):
        match = re.fullmatch(r"(.*?)\s*\[(.*)\]", text)
        name, unit = (match[1], match[2]) if match else (text, "-")
        base, number = name, 2
        while identifier(name) in taken:
            name, number = f"{base} {number}", number + 1
        taken.add(identifier(name))
        made.append(Channel(name, unit, float(scale)))
    return tuple(made)


def observation_channels(scenario: Scenario) -> tuple[Channel, ...]:
    """Return the entries of a scenario's observation, in order."""
    layout = scenario.observation
    scale = np.ones(layout.size)
    scale[: layout.head] = scenario.plant.state_scale[: layout.head]
    scale[layout.readings] = layout.reading_scale
    scale[layout.preview] = float(np.sqrt(scenario.plant.target_variance))
    if layout.sensing.history:
        entry = np.ones(layout.readings_count + layout.sensing.last_action)
        entry[: layout.readings_count] = layout.reading_scale
        scale[layout.history] = np.tile(entry, layout.sensing.history)
    return named_channels(layout.names, scale)


def current_channel(scenario: Scenario) -> Channel:
    """Return the current that a controller gives; 1 is the scenario's limit."""
    return Channel("current", scenario.input_unit, scenario.current_limit)
