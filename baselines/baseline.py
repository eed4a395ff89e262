"""What the catalogue says of a controller: how it is made, what can be tuned, what it knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from baselines.information import Information, scenario_information
from shake_env.controller import Controller
from shake_env.errors import ParameterError
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class Tunable:
    """A free parameter of a controller, searched between `low` and `high`.

    At an end that is `natural` a part of the controller falls away, or what lies beyond is unfit for a
    reason that no mean cost shows, told beside it. A search that comes to another end asks for a wider
    range (a test holds what was tuned against it).

    Raises
    ------
    ParameterError
        Unless ``low <= default <= high``, above 0 where the search is logarithmic.
    """

    low: float
    high: float
    default: float
    logarithmic: bool = True
    natural: Literal["", "low", "high"] = ""

    def __post_init__(self) -> None:
        ordered = self.low <= self.default <= self.high and self.low < self.high
        if not ordered or (self.logarithmic and self.low <= 0.0):
            raise ParameterError("tunable range", self, "needs low <= default <= high, above 0 if log")


@dataclass(frozen=True)
class Baseline:
    """A classical controller that can be asked for by name."""

    make: Callable[..., Controller]  # of a scenario, and its tunable parameters by keyword
    summary: str
    tunable: Mapping[str, Tunable] = field(default_factory=dict)
    tests: int = 1  # of each earthquake that using it takes, the one that counts included
    knows_motion: bool = False  # whether the whole motion is known before the test
    check: Callable[[Scenario], object] | None = None  # raises where a scenario does not suit, at once
    uses_preview: bool = True  # whether it, or its estimator, uses the coming samples that are shown

    @property
    def class_name(self) -> Information:
        """Class of what it knows of the motion where the scenario shows a preview."""
        if self.tests > 1:
            return "repeated tests"
        if self.knows_motion:
            return "record known"
        return "preview" if self.uses_preview else "causal"

    def information(self, scenario: Scenario) -> Information:
        """Return the class of what it knows of the motion on a scenario."""
        own = self.class_name
        return scenario_information(scenario) if own == "preview" else own

    @property
    def takes_earthquakes(self) -> bool:
        """Whether `make` also takes the earthquakes: to repeat their tests, or to plan for them."""
        return self.tests > 1 or self.knows_motion
