"""What an episode's plan needs: the true plant, and the signals that the table is to follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from baselines.planning.model import PlanningModel
from shake_env.controller import Controller, NoControl
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake, rollout, true_plants
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class Episode:
    """An earthquake on the plant that its episode draws, everything known."""

    earthquake: Earthquake
    model: PlanningModel
    target: FloatArray  # (T, k) y~ after each physics step of each control period [m/s^2]
    shear: FloatArray  # (T, k) f~_s [N]

    @property
    def periods(self) -> int:
        """Control periods T."""
        return len(self.target)


def episodes(scenario: Scenario, earthquakes: Sequence[Earthquake]) -> list[Episode]:
    """Return the episodes of some earthquakes; the table stands still while they are recorded."""
    k = scenario.substeps
    recorded = rollout(NoControl(), scenario, earthquakes, record=range(len(earthquakes)))[1]
    models: dict[int, PlanningModel] = {}
    found = []
    for i, (quake, plant) in enumerate(
        zip(earthquakes, true_plants(scenario, earthquakes), strict=True)
    ):
        # Without uncertainty every earthquake has the scenario itself for its plant.
        model = models.get(id(plant)) or PlanningModel.of(plant)
        models[id(plant)] = model
        signals = recorded[i]
        target = signals.target_acceleration.reshape(-1, k)
        found.append(Episode(quake, model, target, signals.reference_base_shear.reshape(-1, k)))
    return found


def driven(
    controller: Controller, scenario: Scenario, earthquakes: Sequence[Earthquake]
) -> tuple[list[FloatArray], list[float], list[bool]]:
    """Return the currents (T) [A], stage cost and whether a limit broke, of a controller's episodes."""
    metrics, runs = rollout(controller, scenario, earthquakes, record=range(len(earthquakes)))
    currents = [runs[i].current for i in range(len(earthquakes))]
    return currents, [m.cost for m in metrics], [m.broken_limit is not None for m in metrics]
