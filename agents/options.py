"""Options that several commands share, as typed dataclasses; tyro makes the command line of them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

from shake_env.scenario import Overrides, Scenario, make_scenario


@dataclass(frozen=True)
class ScenarioOptions:
    """The scenario, and what to change about it (unset: the scenario's own value)."""

    scenario: str = "linear"
    """Name of the scenario: linear, as-printed."""
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

    def build(self) -> Scenario:
        """Return the scenario."""
        overrides = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name != "scenario" and getattr(self, field.name) is not None
        }
        return make_scenario(self.scenario, Overrides(**overrides))  # type: ignore[typeddict-item]
