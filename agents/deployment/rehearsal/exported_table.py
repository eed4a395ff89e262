"""The exported table in a rehearsal: C in place of the simulated table, Python's target and noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agents.deployment.compiled import CompiledProgram
from agents.deployment.plant import SIGNALS, plant_program
from shake_env.errors import ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.transition import TableModel


class ExportedTable:
    """The nominal table of a scenario, as ``shake export table --to c`` writes it.

    Parameters
    ----------
    scenario
        Which table; it must show measured signals.
    simulation
        Of one table, whose target and noise are used.

    Raises
    ------
    ScenarioError
        If the scenario shows the full state, which the exported table does not give.
    """

    def __init__(self, scenario: Scenario, simulation: Simulation) -> None:
        if scenario.sensing.full_state:
            raise ScenarioError(
                "sensing", "full state", "an exported table gives readings: name sensors"
            )
        self._scenario, self._simulation = scenario, simulation
        self._model = TableModel.from_scenario(scenario)
        self._program = CompiledProgram(plant_program(scenario))
        self.begin()

    def begin(self) -> None:
        """Put the table to rest; the simulation has begun its episode."""
        self._memory = self._program.begin(1)
        self._sensors = self._model.measurement.rest(1)

    def step(self, current: float) -> tuple[FloatArray, list[float], str | None]:
        """Advance by one period under a current [A].

        Returns
        -------
        observation, signals, broken
            (n,) over its scales; displacement, velocity, acceleration, the target's, base shear, the
            reference's [SI]; the hard limit that broke at the period's end, or None.
        """
        action = current / self._scenario.current_limit
        ground, noise = self._simulation.advance_ground()
        outputs = self._program.step(self._memory, np.array([[action]]))[0]
        measurement = self._model.measurement
        count = measurement.layout.readings_count
        readings = (outputs[:, -count:] + noise) / measurement.scale
        self._sensors = replace(self._sensors, action=np.array([action]))
        shown, self._sensors = self._model.show(readings, ground, self._sensors)
        bounded = np.clip(shown[0], -OBSERVATION_BOUND, OBSERVATION_BOUND).astype(np.float32)
        place = {name: i for i, name in enumerate(SIGNALS)}
        row = outputs[0]
        signals = [
            *(float(row[place[name]]) for name in ("table_displacement", "table_velocity")),
            float(row[place["table_acceleration"]]), float(ground.target[0, -1]),
            float(row[place["base_shear"]]), float(ground.reference_shear[0, -1]),
        ]  # fmt: skip
        return bounded.astype(float), signals, self._broken(row, place)

    def _broken(self, row: FloatArray, place: dict[str, int]) -> str | None:
        limits = self._scenario.limits
        sizes = {name: abs(row[i]) for name, i in place.items() if hasattr(limits, name)}
        floors = row[len(SIGNALS) : len(SIGNALS) + self._scenario.specimen.stories]
        sizes["specimen_acceleration"] = np.abs(floors).max()
        for name, size in sizes.items():
            limit = getattr(limits, name)
            if limit is not None and size > limit:
                return name
        return None
