"""What an episode's plan needs: the true plant, and the signals that the table is to follow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from baselines.planning.model import PlanningModel
from shake_env.controller import Controller, NoControl
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake, rollout, sampled_plants
from shake_env.scenario.observation import Sensing
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


def episodes(
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    plant: Scenario | None = None,
    reference: Callable[[Scenario, FloatArray], FloatArray] | None = None,
) -> list[Episode]:
    """Return the episodes of some earthquakes; the table stands still while they are recorded.

    Parameters
    ----------
    plant
        Whose table is to follow; None: the plant that each earthquake's seed draws.
    reference
        Gives f~_s (T, k) [N] of that plant from the target (T, k); None: what the episode says.
    """
    k = scenario.substeps
    recorded = rollout(NoControl(), scenario, earthquakes, record=range(len(earthquakes)))[1]
    models: dict[int, PlanningModel] = {}
    made = []
    plants = sampled_plants(scenario, earthquakes) if plant is None else [plant] * len(earthquakes)
    for i, (quake, own) in enumerate(zip(earthquakes, plants, strict=True)):
        # Without uncertainty every earthquake has the scenario itself for its plant.
        # Without sensors, whose low-passes would be states that nothing feels.
        model = models.get(id(own)) or PlanningModel.of(replace(own, sensing=Sensing()))
        models[id(own)] = model
        signals = recorded[i]
        target = signals.target_acceleration.reshape(-1, k)
        shear = signals.reference_base_shear.reshape(-1, k)
        if reference is not None:
            shear = reference(own, target)
        made.append(Episode(quake, model, target, shear))
    return made


def driven(
    controller: Controller, scenario: Scenario, earthquakes: Sequence[Earthquake]
) -> tuple[list[FloatArray], list[float], list[bool]]:
    """Return the currents (T) [A], stage cost and whether a limit broke, of a controller's episodes."""
    metrics, runs = rollout(controller, scenario, earthquakes, record=range(len(earthquakes)))
    currents = [runs[i].current for i in range(len(earthquakes))]
    return currents, [m.cost for m in metrics], [m.broken_limit is not None for m in metrics]
