"""A table by name: its facts, each with a source or as an assumption, and the parameters they give.

One TOML file a table. A fact has a value, a unit, and either the source that it was read in or the
reason why it is assumed; ``[published]`` holds figures that follow from the facts and that a test
compares.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

from shake_env.errors import ScenarioError, unknown
from shake_env.model.motor import NOMINAL_FLOW_GAIN, electric_actuator
from shake_env.model.nonlinearity import Friction, ServoValve
from shake_env.model.parameters import Actuator

DEFAULT_TABLE = "gavin-hoagg-2009"
TABLE_NAMES = (DEFAULT_TABLE, "lnec-uniaxial", "quanser-shake-table-ii", "lhpost")

_COMMON = (
    "table_mass", "table_damping", "table_stiffness", "stroke", "velocity", "acceleration_abort",
    "input_limit", "coulomb_friction", "payload", "control_rate", "physics_step", "loop_delay",
)  # fmt: skip
_HYDRAULIC = (
    "piston_area", "oil_volume", "bulk_modulus", "leakage", "valve_time_constant", "supply_pressure",
)  # fmt: skip
_ELECTRIC = (
    "screw_lead", "winding_resistance", "winding_inductance", "torque_constant", "back_emf_constant",
    "amplifier_lag", "current_limit",
)  # fmt: skip
_OPTIONAL = ("flow_gain", "valve_gain", "flow_per_input", "velocity_abort")
_RPM = 2.0 * math.pi / 60.0  # [rad/s]


@dataclass(frozen=True, kw_only=True)
class Fact:
    """A number of a table: where it comes from, or why it is assumed.

    Raises
    ------
    ScenarioError
        Unless it has either a source or an assumption.
    """

    value: float
    unit: str
    source: str = ""  # key of the table's references
    assumption: str = ""  # reason, where nothing was published
    note: str = ""

    def __post_init__(self) -> None:
        if bool(self.source) == bool(self.assumption):
            raise ScenarioError("fact", self, "give its source, or the reason for an assumption")


@dataclass(frozen=True, kw_only=True)
class Published:
    """A figure that follows from a table's facts, as published."""

    value: float
    unit: str
    source: str
    tolerance: float  # [-] relative; 0: context that the model does not give
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Table:
    """A shake table: actuator and platen, their nonlinear parts, and what they can do."""

    name: str
    title: str
    drive: Literal["hydraulic", "electric"]
    input_unit: Literal["A", "V"]  # of the action
    references: Mapping[str, str]
    facts: Mapping[str, Fact]
    published: Mapping[str, Published]

    def __post_init__(self) -> None:
        needed = (*_COMMON, *(_ELECTRIC if self.drive == "electric" else _HYDRAULIC))
        for name in needed:
            if name not in self.facts:
                raise ScenarioError(f"facts of table {self.name}", name, "is missing")
        for name in self.facts:
            if name not in (*needed, *_OPTIONAL):
                raise unknown(ScenarioError, f"fact of table {self.name}", name, (*needed, *_OPTIONAL))
        sources = [each.source for each in self.facts.values() if each.source]
        for source in (*sources, *(each.source for each in self.published.values())):
            if source not in self.references:
                raise unknown(ScenarioError, f"source in {self.name}", source, self.references)

    def __getitem__(self, fact: str) -> float:
        """Return a fact's value in its unit."""
        return self.facts[fact].value

    @property
    def actuator(self) -> Actuator:
        """Parameters of the coupled plant."""
        common = {name: self[name] for name in ("table_mass", "table_damping", "table_stiffness")}
        if self.drive == "electric":
            motor = {name: self[name] for name in _ELECTRIC if name != "current_limit"}
            if self.facts["back_emf_constant"].unit == "V/rpm":
                motor["back_emf_constant"] /= _RPM
            return electric_actuator(**common, **motor)
        oil = {name: self[name] for name in _HYDRAULIC if name != "supply_pressure"}
        flow_gain = self["flow_gain"] if "flow_gain" in self.facts else NOMINAL_FLOW_GAIN
        if "valve_gain" in self.facts:
            valve_gain = self["valve_gain"]
        else:
            valve_gain = self["flow_per_input"] / flow_gain
        return Actuator(**common, **oil, flow_gain=flow_gain, valve_gain=valve_gain)

    @property
    def friction(self) -> Friction:
        """Friction of seals, bearings or screw."""
        return Friction(coulomb=self["coulomb_friction"])

    @property
    def valve(self) -> ServoValve:
        """What limits the drive: orifice and spool, or the amplifier's voltage."""
        supply = math.inf if self.drive == "electric" else self["supply_pressure"]
        return ServoValve(supply_pressure=supply, spool_limit=self["input_limit"] * self._valve_gain)

    @property
    def _valve_gain(self) -> float:
        return self.actuator.valve_gain

    @property
    def force(self) -> float:
        """Largest force of the drive [N]: supply pressure on the piston, or the current limit's."""
        return self.load_pressure * self.actuator.piston_area

    @property
    def load_pressure(self) -> float:
        """The load pressure [Pa] of that force."""
        if self.drive == "hydraulic":
            return self["supply_pressure"]
        torque = self["torque_constant"] * self["current_limit"]
        return torque * 2.0 * math.pi / self["screw_lead"] / self.actuator.piston_area

    @property
    def velocity_abort(self) -> float:
        """Velocity that ends a test [m/s]; a twelfth above the rated one where nothing is said."""
        if "velocity_abort" in self.facts:
            return self["velocity_abort"]
        return self["velocity"] * 13.0 / 12.0


def table_from(text: str, name: str) -> Table:
    """Return the table that a TOML text holds.

    Raises
    ------
    ScenarioError
        If it is no TOML, or an entry is missing, unknown or has another name.
    """
    try:
        plain = tomllib.loads(text)
        facts = {key: Fact(**each) for key, each in plain.pop("facts").items()}
        published = {key: Published(**each) for key, each in plain.pop("published", {}).items()}
        table = Table(facts=facts, published=published, **plain)
    except (tomllib.TOMLDecodeError, TypeError, KeyError, AttributeError) as error:
        raise ScenarioError(f"table {name}", str(error), "is no table file") from None
    if table.name != name:
        raise ScenarioError(f"name of table {name}", table.name, "must be that of its file")
    return table


@cache
def named_table(name: Any = DEFAULT_TABLE) -> Table:
    """Return a table by its name, of `TABLE_NAMES`.

    Raises
    ------
    ScenarioError
        If there is none of that name.
    """
    if name not in TABLE_NAMES:
        raise unknown(ScenarioError, "table", name, TABLE_NAMES)
    file = resources.files(__package__).joinpath(f"{name}.toml")
    return table_from(file.read_text(encoding="utf-8"), name)
