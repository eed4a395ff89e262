"""What a controller is shown: full state or measured signals, preview, history, last action.

Values and the layout of the observation. How signals are taken is :mod:`shake_env.simulation.sensors`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shake_env.dynamics.low_pass import STATE_SIGNALS as STATE_SIGNALS
from shake_env.dynamics.low_pass import LowPass
from shake_env.errors import ParameterError, unknown
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import CoupledPlant
from shake_env.model.ranges import check_ranges

FLOOR_ACCELERATIONS = "floor_accelerations"
UNITS = {
    "load_pressure": "Pa",
    "table_displacement": "m",
    "table_velocity": "m/s",
    "spool_position": "m",
    "table_acceleration": "m/s^2",
    "base_shear": "N",
    FLOOR_ACCELERATIONS: "m/s^2",
}


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """One measured signal, sampled at the end of each control period.

    The reading is the signal through an analogue first-order low-pass, sampled, times 1 plus a gain
    error, plus a bias, both constant over an episode, plus white noise, rounded to the resolution. The
    low-pass is stepped with the table: it feels the signal between the samples. Noise, bias and
    resolution are in the signal's unit. ``floor_accelerations`` are the absolute accelerations of all
    floors, one reading each.

    Raises
    ------
    ParameterError
        If the signal is unknown, or a value negative (the low-pass: not above zero).
    """

    signal: str  # what is measured, one of `SIGNALS`
    noise: float = 0.0  # rms of the white noise
    bias: float = 0.0  # standard deviation of the constant offset that an episode draws
    resolution: float = 0.0  # quantisation step; 0: none
    lowpass_frequency: float | None = None  # [Hz]; None: none
    gain_error: float = 0.0  # [-] standard deviation of the relative gain error that an episode draws

    def __post_init__(self) -> None:
        if self.signal not in UNITS:
            raise unknown(ParameterError, "signal", str(self.signal), UNITS)
        check_ranges(self)


@dataclass(frozen=True, kw_only=True)
class Sensing:
    """What an observation holds; the default is the full state and nothing else.

    Raises
    ------
    ParameterError
        If there is no sensor or one twice, a length is negative or no whole number of samples, or a
        history is asked for where the full state is shown.
    """

    sensors: tuple[Sensor, ...] | None = None  # None: the full state, without noise
    preview: float = 0.0  # [s] how far ahead the target acceleration is known
    preview_spacing: float | None = None  # [s] between its samples; None: the physics step
    last_action: bool = False  # whether the action of the last control period is shown
    history: int = 0  # earlier control periods whose readings (and last actions) are shown

    def __post_init__(self) -> None:
        check_ranges(self)
        if not isinstance(self.last_action, bool | np.bool_):
            raise ParameterError("last_action", self.last_action, "must be True or False")
        if self.sensors is None:
            if self.history:
                raise ParameterError(
                    "history", self.history, "the full state needs none: name sensors, or ask for 0"
                )
            return
        object.__setattr__(self, "sensors", tuple(self.sensors))
        for sensor in self.sensors:
            if not isinstance(sensor, Sensor):
                raise ParameterError("sensors", sensor, "must be Sensor values: Sensor(signal=...)")
        signals = [sensor.signal for sensor in self.sensors]
        if not signals or len(set(signals)) != len(signals):
            raise ParameterError("sensors", signals, "name at least one signal, and each once")

    @classmethod
    def laboratory(
        cls,
        *,
        displacement: float = 0.076,
        velocity: float = 0.65,
        pressure: float = 21e6,
        spool: float = 2e-5,
        acceleration: float = 49.0,
    ) -> Sensing:
        """Return a laboratory's signals: noise 0.1 % of full scale, 16 bits, 0.1 s of preview.

        The accelerometer has an anti-alias filter at 80 Hz and an offset of 0.01 m/s^2 rms.

        Parameters
        ----------
        displacement, velocity, pressure, spool, acceleration
            Full scales [m, m/s, Pa, m, m/s^2].
        """
        full = {
            "table_displacement": displacement, "table_velocity": velocity, "load_pressure": pressure,
            "spool_position": spool, "table_acceleration": acceleration,
        }  # fmt: skip
        accelerometer = {"bias": 0.01, "lowpass_frequency": 80.0}
        return cls(
            sensors=tuple(
                Sensor(
                    signal=name,
                    noise=1e-3 * scale,
                    resolution=scale / 2**15,
                    bias=accelerometer["bias"] if name == "table_acceleration" else 0.0,
                    lowpass_frequency=(
                        accelerometer["lowpass_frequency"] if name == "table_acceleration" else None
                    ),
                )
                for name, scale in full.items()
            ),
            preview=0.1,
            last_action=True,
        )

    @classmethod
    def named(cls, name: str) -> Sensing:
        """Return the sensing called `name`: ``"full"`` or ``"laboratory"``."""
        known: dict[str, Callable[[], Sensing]] = {"full": cls, "laboratory": cls.laboratory}
        if name not in known:
            raise unknown(ParameterError, "sensing", name, known)
        return known[name]()

    @property
    def full_state(self) -> bool:
        """Whether the full state is shown."""
        return self.sensors is None

    @property
    def plain(self) -> bool:
        """Whether an observation is the full state and nothing else."""
        return self.full_state and self.preview == 0.0 and not self.last_action

    def preview_steps(self, physics_step: float) -> tuple[int, int]:
        """Return the number of previewed samples and the physics steps between them.

        Raises
        ------
        ParameterError
            If the spacing is no whole number of physics steps, or the preview none of spacings.
        """
        spacing = physics_step if self.preview_spacing is None else self.preview_spacing
        steps = _whole("preview_spacing", spacing, physics_step, "physics steps")
        return _whole("preview", self.preview, spacing, "spacings"), steps


def _whole(field: str, value: float, unit: float, what: str) -> int:
    ratio = value / unit
    nearest = max(round(ratio), 0 if field == "preview" else 1)
    if not math.isclose(ratio, nearest, rel_tol=1e-9, abs_tol=1e-9):
        raise ParameterError(
            field,
            value,
            f"must be a whole number of {what} of {unit:.6g} s: try {nearest * unit:.6g}",
        )
    return nearest


@dataclass(frozen=True)
class ObservationLayout:
    """Where each part of an observation lies, and what it is divided by.

    In order: the full state, or the ground filter's state and the readings; the previewed target
    accelerations, nearest first; the last action; the history, newest first, each entry the readings
    and the action before them.
    """

    sensing: Sensing
    plant: CoupledPlant
    preview_samples: int
    preview_spacing: int  # [physics steps]

    @property
    def head(self) -> int:
        """Length of the full state, or of the ground filter's state."""
        layout = self.plant.layout
        return layout.order if self.sensing.full_state else layout.filter_states

    @property
    def readings_count(self) -> int:
        """Number of readings s (0 with the full state)."""
        return len(self.reading_names)

    @property
    def readings(self) -> slice:
        """Readings of the sensors."""
        return slice(self.head, self.head + self.readings_count)

    @property
    def preview(self) -> slice:
        """Target acceleration at the coming samples."""
        return slice(self.readings.stop, self.readings.stop + self.preview_samples)

    @property
    def last_action(self) -> slice:
        """Action of the last control period."""
        return slice(self.preview.stop, self.preview.stop + self.sensing.last_action)

    @property
    def history(self) -> slice:
        """Readings and actions of earlier control periods."""
        entry = self.readings_count + self.sensing.last_action
        return slice(self.last_action.stop, self.last_action.stop + self.sensing.history * entry)

    @property
    def size(self) -> int:
        """Length of the observation."""
        return int(self.history.stop)

    @cached_property
    def reading_names(self) -> tuple[str, ...]:
        """Signal of each reading; floors are numbered from the table."""
        names: list[str] = []
        for sensor in self.sensing.sensors or ():
            if sensor.signal == FLOOR_ACCELERATIONS:
                floors = range(1, self.plant.specimen.stories + 1)
                names += [f"floor_acceleration_{floor}" for floor in floors]
            else:
                names.append(sensor.signal)
        return tuple(names)

    def sensor_values(self, field: str) -> FloatArray:
        """Return a numeric field of each reading's sensor, (s,); infinite where it is None."""
        by_signal = {}
        for sensor in self.sensing.sensors or ():
            value = getattr(sensor, field)
            by_signal[sensor.signal] = math.inf if value is None else float(value)
        floors = by_signal.get(FLOOR_ACCELERATIONS, 0.0)
        return np.asarray([by_signal.get(name, floors) for name in self.reading_names], dtype=float)

    @cached_property
    def reading_scale(self) -> FloatArray:
        """Size of each reading (s,) [SI], which observations are divided by.

        Signals of the state have the state's scale; accelerations the unit target's rms; the base shear
        the specimen's mass times that.
        """
        acceleration = float(np.sqrt(self.plant.target_variance))
        actuator = self.plant.state_scale[self.plant.layout.actuator]
        sizes = {name: float(actuator[place]) for name, place in STATE_SIGNALS.items()}
        sizes["base_shear"] = self.plant.specimen.mass * acceleration
        return np.asarray([sizes.get(name, acceleration) for name in self.reading_names])

    @cached_property
    def low_passes(self) -> tuple[LowPass, ...]:
        """The readings that pass through a low-pass, in order."""
        cutoff = self.sensor_values("lowpass_frequency")  # infinite: no low-pass
        rows = zip(self.reading_names, cutoff.tolist(), self.reading_scale.tolist(), strict=True)
        return tuple(LowPass(*row) for row in rows if math.isfinite(row[1]))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each entry with its unit, in order."""
        states = self.plant.layout.names[: self.head]
        readings = tuple(f"measured {name} [{_unit(name)}]" for name in self.reading_names)
        preview = tuple(
            f"target acceleration {(i + 1) * self.preview_spacing} physics steps ahead [m/s^2]"
            for i in range(self.preview_samples)
        )
        action = ("last action [-]",) * self.sensing.last_action
        history = tuple(
            f"{name.split(' [')[0]}, {back} periods ago [{name.split(' [')[1]}"
            for back in range(1, self.sensing.history + 1)
            for name in (*readings, *action)
        )
        return (*states, *readings, *preview, *action, *history)


def _unit(reading: str) -> str:
    return "m/s^2" if reading.startswith("floor") else UNITS[reading]
