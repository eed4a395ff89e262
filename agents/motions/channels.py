"""The channels of a motion file: how it is read and prepared, and what a table needs to repeat each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from shake_env.errors import RecordError
from shake_env.motion.processing import TableCapacity, TableFit, fit_amplitude, fit_time, remove_baseline
from shake_env.motion.targets import RecordedMotion
from shake_env.records import Record, read_motion
from shake_env.rollout import Earthquake, record_amplitude
from shake_env.scenario.capacity import scenario_capacity
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class MotionOptions:
    """How a motion file is read and prepared."""

    units: str | None = None
    """Unit of a file that states none: g, %g, mg, m/s^2, cm/s^2 or gal, mm/s^2, in/s^2, ft/s^2; of
    counts: '4.2e-7 m/s^2'."""
    sampling_interval: float | None = None
    """Step of a file that states none [s]."""
    column: str | None = None
    """The one column to take: its title, or its number in the file from 1 on."""
    allow_large: bool = False
    """Accept a peak above 3 g where --units gave the unit."""
    sheet: str | None = None
    """Variable of a .mat file or sheet of a workbook, where it holds several."""
    allow_seismometers: bool = False
    """Read channels of seismometers (HHE, BHN, EHZ) whose samples are accelerations all the same."""
    remove_offset: bool = False
    """Take the mean off first, as K-NET's counts need."""
    highpass: float = 0.2
    """Lower end of the band that the table repeats [Hz]; 0 leaves it open."""
    lowpass: float = 25.0
    """Upper end [Hz]; 0 leaves it open, as does a record that is sampled too coarsely for it."""
    stroke: float | None = None
    """Displacement that the table has to either side [m]; this and the next three, unset: by the
    scenario's limits."""
    velocity: float | None = None
    """Velocity that the table has [m/s]."""
    acceleration: float | None = None
    """Acceleration that table and specimen may have [m/s^2]; inf: any."""
    pressure: float | None = None
    """Load pressure that the table has [Pa]."""

    def read(self, path: str | PathLike[str]) -> tuple[Record, ...]:
        """Return the records of a file, in SI.

        Raises
        ------
        RecordError
            If the file cannot be read, or a channel is all zeros.
        """
        path = Path(path)
        records = read_motion(
            path,
            units=self.units,
            sampling_interval=self.sampling_interval,
            column=self.column,
            allow_large=self.allow_large,
            table=self.sheet,
            allow_seismometers=self.allow_seismometers,
        )
        for record in records:
            if not np.any(record.acceleration):
                raise RecordError(record.name, "all zeros", "holds no motion: give a file with one")
        return tuple(remove_baseline(r, 0) for r in records) if self.remove_offset else records

    def motion(self, record: Record) -> RecordedMotion:
        """Return a record's band as a motion, unscaled."""
        coarse = self.lowpass * record.sampling_interval >= 0.5
        return RecordedMotion(
            record=record,
            highpass_frequency=None if self.highpass == 0.0 else self.highpass,
            lowpass_frequency=None if self.lowpass == 0.0 or coarse else self.lowpass,
        )

    def capacity(self, scenario: Scenario) -> TableCapacity:
        """Return what the scenario's table can do under its specimen, by its limits or those given.

        Raises
        ------
        ParameterError
            If one of those given is out of range.
        """
        pressure, area = self.pressure, scenario.actuator.piston_area
        given = {
            "displacement": self.stroke,
            "velocity": self.velocity,
            "acceleration": self.acceleration,
            "force": None if pressure is None else pressure * area,
        }
        changes = {name: value for name, value in given.items() if value is not None}
        return replace(scenario_capacity(scenario), **changes)


def how_a_file_was_read(record: Record) -> str:
    """Return the format of a record's file and, of a table, what each column was taken for."""
    attribution = dict(record.attribution)
    form = attribution.get("format", "embedded format")
    columns = attribution.get("columns read as")
    return f"{form} ({columns})" if columns else form


@dataclass(frozen=True)
class Channel:
    """A channel of a file, described."""

    record: Record
    by_amplitude: TableFit
    by_time: TableFit

    def to_json(self) -> dict[str, Any]:
        """Return its figures as plain values, SI; scales multiply amplitude and time."""
        from agents.motions.intensity import arias_intensity, significant_duration

        record, amplitude, time = self.record, self.by_amplitude, self.by_time
        return {
            "name": record.name,
            "points": len(record.acceleration),
            "sampling_interval": record.sampling_interval,
            "duration": record.duration,
            "peak_acceleration": float(np.max(np.abs(record.acceleration))),
            "offset": float(np.mean(record.acceleration)),
            "arias_intensity": arias_intensity(record),
            "significant_duration": significant_duration(record),
            "amplitude_scale": amplitude.factor,
            "amplitude_governed_by": amplitude.governed_by,
            "time_scale": time.factor,
            "time_compression": 1.0 / time.factor,
            "time_governed_by": time.governed_by,
            "time_scale_suffices": time.fits,
            "peaks": asdict(amplitude.before),
            "peaks_scaled_by_amplitude": asdict(amplitude.after),
            "peaks_scaled_by_time": asdict(time.after),
            "attribution": dict(record.attribution),
        }


def channels(path: str | PathLike[str], options: MotionOptions, scenario: Scenario) -> list[Channel]:
    """Return every channel of a motion's file, with the scales that the scenario's table needs."""
    path = Path(path)
    capacity = options.capacity(scenario)
    channel_list = []
    for record in options.read(path):
        motion = options.motion(record)
        step = scenario.physics_step
        channel_list.append(
            Channel(
                record,
                fit_amplitude(motion, capacity, physics_step=step),
                fit_time(motion, capacity, physics_step=step),
            )
        )
    return channel_list


def motion_earthquakes(
    paths: Sequence[Path], options: MotionOptions, scenario: Scenario, *, scale: bool, console: Console
) -> list[Earthquake]:
    """Return an earthquake for every channel of every file, scaled to the table unless told not to.

    The scale is printed, and multiplies the amplitude at which the scenario takes a record.
    """
    earthquakes: list[Earthquake] = []
    capacity, amplitude = options.capacity(scenario), record_amplitude(scenario)
    for path in paths:
        records = options.read(path)
        console.print(escape(f"{path.name}: {how_a_file_was_read(records[0])}"))
        for record in records:
            plain = options.motion(record)
            fit = fit_amplitude(plain, capacity, physics_step=scenario.physics_step)
            factor = amplitude * (fit.factor if scale else 1.0)
            why = f"as recorded; the table needs {fit.factor:.4g}"
            if scale:
                fitting = fit.governed_by == "nothing"
                why = "within the table" if fitting else f"for its {_beyond(fit)} of {fit.governed_by}"
            console.print(escape(f"motion {record.name}: amplitude x {factor:.4g} ({why})"))
            motion = RecordedMotion(
                record=record,
                amplitude=factor,
                highpass_frequency=plain.highpass_frequency,
                lowpass_frequency=plain.lowpass_frequency,
            )
            earthquakes.append(Earthquake(record.name, motion))
    return earthquakes


def _beyond(fit: TableFit) -> str:
    """Return the peak that governs a scale, in the unit of its limit."""
    before = fit.before
    return {
        "displacement": f"{1e3 * before.displacement:.3g} mm",
        "velocity": f"{before.velocity:.3g} m/s",
        "acceleration": f"{before.acceleration:.3g} m/s²",
        "force": f"{1e-3 * before.force:.3g} kN",
        "nothing": "-",
    }[fit.governed_by]
