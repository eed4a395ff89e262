"""What a controller knows of the motion: classes of information, each with more than the one before.

Costs are comparable within a class. A controller of a higher class knows what one of a lower class
cannot, so that a comparison across classes is no measure of a control law.
"""

from __future__ import annotations

from typing import Literal, get_args

from shake_env.scenario.scenario import Scenario

Information = Literal["causal", "preview", "record known", "repeated tests", "true plant"]

INFORMATION: tuple[Information, ...] = get_args(Information)
MEANINGS: dict[Information, str] = {
    "causal": "present and past signals, and the present target",
    "preview": "the target's coming samples that the scenario shows as well",
    "record known": "the whole target before the test",
    "repeated tests": "the whole target, and what earlier tests of it on the same table measured",
    "true plant": "the true plant and its full state, which no laboratory has",
}


def scenario_information(scenario: Scenario) -> Information:
    """Return the class of information that a scenario shows a controller."""
    return "preview" if scenario.sensing.preview > 0.0 else "causal"


def knows_no_more(one: str, other: str) -> bool:
    """Return whether a class of information knows no more than another."""
    return INFORMATION.index(one) <= INFORMATION.index(other)
