"""Readings of the sensors, pure and against the array API."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import array_api_compat
import numpy as np

from shake_env.dynamics.linear import as_like
from shake_env.dynamics.low_pass import STATE_SIGNALS, first_low_pass
from shake_env.scenario.observation import ObservationLayout
from shake_env.scenario.scenario import Scenario

Array = Any  # a numpy array or a torch tensor


@dataclass(frozen=True)
class SensorMemory:
    """What the sensors of a table remember from one control period to the next."""

    bias: Array  # (..., s) offsets of this episode, SI
    gain: Array  # (..., s) gain errors of this episode [-]
    action: Array  # (...) last action, within [-1, 1]
    past: Array  # (..., history, s or s + 1) readings over their scale and last actions, newest first

    def to(self, array: Array) -> SensorMemory:
        """Return this memory in the library, precision and device of `array`."""
        return SensorMemory(*(as_like(getattr(self, f.name), array) for f in fields(self)))

    def arrays(self) -> dict[str, Array]:
        """Return copies of the parts by the names that a simulation's state has them under."""
        return {f"sensor_{f.name}": np.array(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_state(cls, state: Mapping[str, Array]) -> SensorMemory:
        """Return the memory that a simulation's state holds."""
        return cls(*(state[f"sensor_{f.name}"] for f in fields(cls)))


@dataclass(frozen=True)
class Measurement:
    """From the signals of a table to its readings."""

    layout: ObservationLayout
    places: Array  # (s,) where a reading lies in the table's state; -1: it is no entry of it
    resolution: Array  # (s,) SI; 1 where there is none
    rounded: Array  # (s,) 1 where readings are rounded, else 0
    scale: Array  # (s,) SI
    preview_scale: float  # [m/s^2]
    rms: Array  # (s,) of the white noise, SI
    offset: Array  # (s,) standard deviation of the constant offset that an episode draws, SI
    gain_error: Array  # (s,) [-] likewise of the relative gain error

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> Measurement:
        """Return the measurement of a scenario's observation."""
        layout = scenario.observation
        first = first_low_pass(scenario.plant, scenario.parts)
        behind = {each.signal: first + i for i, each in enumerate(layout.low_passes)}
        places = {**STATE_SIGNALS, **behind}
        resolution = layout.sensor_values("resolution")
        return cls(
            layout=layout,
            places=np.array([places.get(name, -1) for name in layout.reading_names], dtype=int),
            resolution=np.where(resolution > 0.0, resolution, 1.0),
            rounded=(resolution > 0.0).astype(float),
            scale=layout.reading_scale,
            preview_scale=float(np.sqrt(layout.plant.target_variance)),
            rms=layout.sensor_values("noise"),
            offset=layout.sensor_values("bias"),
            gain_error=layout.sensor_values("gain_error"),
        )

    def to(self, array: Array) -> Measurement:
        """Return this measurement in the library, precision and device of `array`."""
        names = ("resolution", "rounded", "scale", "rms", "offset", "gain_error")
        return replace(self, **{name: as_like(getattr(self, name), array) for name in names})

    def rest(self, lanes: int) -> SensorMemory:
        """Return the memory (lanes, ...) of sensors without offset on tables at rest."""
        s, shown = self.layout.readings_count, self.layout.sensing
        return SensorMemory(
            np.zeros((lanes, s)),
            np.zeros((lanes, s)),
            np.zeros(lanes),
            np.zeros((lanes, shown.history, s + shown.last_action)),
        )

    def signals(
        self, state: Array, table_acceleration: Array, base_shear: Array, floors: Array | None
    ) -> Array:
        """Return what the sensors sample, (..., s) in SI, behind the low-passes.

        Parameters
        ----------
        state
            (..., states) the table's state, x_A first.
        table_acceleration, base_shear
            (...) [m/s^2], [N] at the period's end.
        floors
            (..., stories) absolute accelerations of the floors [m/s^2]; needed where they are measured.
        """
        xp = array_api_compat.array_namespace(state)
        columns = []
        for name, place in zip(self.layout.reading_names, self.places.tolist(), strict=True):
            if place >= 0:
                columns.append(state[..., place])
            elif name == "table_acceleration":
                columns.append(table_acceleration)
            elif name == "base_shear":
                columns.append(base_shear)
            else:
                assert floors is not None  # the model computes them where a sensor asks
                columns.append(floors[..., int(name.rsplit("_", 1)[1]) - 1])
        return xp.stack(columns, axis=-1)

    def read(
        self, memory: SensorMemory, signals: Array, noise: Array, action: Array
    ) -> tuple[Array, SensorMemory]:
        """Take the readings at the end of a control period.

        Parameters
        ----------
        memory
            Of the period before.
        signals
            (..., s) in SI.
        noise
            (..., s) white noise of this sample, SI.
        action
            (...) of the period, within [-1, 1].

        Returns
        -------
        readings, memory
            (..., s) over their scale, and the memory without this period in its history: `remember`
            puts it there, once it has been shown.
        """
        xp = array_api_compat.array_namespace(signals)
        reading = signals + memory.gain * signals + memory.bias + noise
        error = self.rounded * (xp.round(reading / self.resolution) * self.resolution - reading)
        if hasattr(error, "detach"):
            # Rounding has no slope; learning through the plant takes it for an error that is given
            # (the straight-through estimator, Bengio et al. 2013).
            error = error.detach()
        scaled = (reading + error) / self.scale
        return scaled, replace(memory, action=action)

    def remember(self, memory: SensorMemory, readings: Array) -> SensorMemory:
        """Return the memory with `readings` (..., s), already shown, as the newest of the history."""
        shown = self.layout.sensing
        if not shown.history:
            return memory
        xp = array_api_compat.array_namespace(readings)
        newest = readings
        if shown.last_action:
            newest = xp.concat([readings, memory.action[..., None]], axis=-1)
        past = xp.concat([newest[..., None, :], memory.past[..., :-1, :]], axis=-2)
        return replace(memory, past=past)

    def observation(
        self, head: Array, readings: Array | None, preview: Array | None, memory: SensorMemory
    ) -> Array:
        """Return the whole observation (..., n).

        Parameters
        ----------
        head
            (..., head) full state or ground-filter state over its scale.
        readings
            (..., s) over their scale; None with the full state.
        preview
            (..., samples) target accelerations [m/s^2]; None without a preview.
        memory
            The sensors' memory, for the last action and the history.
        """
        xp = array_api_compat.array_namespace(head)
        shown, parts = self.layout.sensing, [head]
        if readings is not None:
            parts.append(readings)
        if preview is not None:
            parts.append(preview / self.preview_scale)
        if shown.last_action:
            parts.append(memory.action[..., None])
        if shown.history:
            parts.append(xp.reshape(memory.past, (*memory.past.shape[:-2], -1)))
        return xp.concat(parts, axis=-1) if len(parts) > 1 else head
