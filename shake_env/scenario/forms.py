"""Other forms in which a file gives a part than by its fields: a constructor each, by its name.

To add one, write a function with typed keyword parameters and a numpy docstring, add it to `FORMS` and
name the ranges of its parameters in `field_table`. Reader, schema and reference page take it from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shake_env.errors import ParameterError, RecordError
from shake_env.model.parameters import Actuator, Specimen
from shake_env.model.specimens import specimen_from_matrices, specimen_from_modes
from shake_env.motion.processing import fit_amplitude, remove_baseline
from shake_env.motion.targets import RecordedMotion
from shake_env.records import read_motion, read_specimen
from shake_env.scenario.capacity import scenario_capacity
from shake_env.scenario.plants.samples import read_samples
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty


@dataclass(frozen=True)
class FormContext:
    """What a form may need beside its own fields."""

    folder: Path  # of the file that gives the part; paths in it are relative to this
    actuator: Actuator  # of the same scenario
    scenario: Scenario | None  # with every part but its motion; None for what is made before that


def equal_storeys(
    *,
    stories: int,
    mass_ratio: float,
    storey_frequency: float,
    damping_ratio: float,
    _context: FormContext,
) -> Specimen:
    """Return equal storeys by the rules of Table I, on the scenario's own table; see `Specimen.uniform`.

    Parameters
    ----------
    stories
        Number of storeys n_m.
    mass_ratio
        Specimen mass over the table's mass, mu [-].
    storey_frequency
        Frequency f_1 = sqrt(k/m) / (2 pi) of one storey [Hz]; not the first mode of the building.
    damping_ratio
        Damping ratio zeta_1 of one storey [-].
    """
    return Specimen.uniform(
        stories=stories,
        mass_ratio=mass_ratio,
        storey_frequency=storey_frequency,
        damping_ratio=damping_ratio,
        table_mass=_context.actuator.table_mass,
    )


def structure_matrices(
    *,
    mass: tuple[float | tuple[float, ...], ...],
    stiffness: tuple[tuple[float, ...], ...],
    damping: tuple[tuple[float, ...], ...] | None = None,
    damping_ratio: float | tuple[float, ...] | None = None,
    rayleigh_frequencies: tuple[float, ...] | None = None,
    rayleigh_damping_ratios: tuple[float, ...] | None = None,
    _context: FormContext,
) -> Specimen:
    """Return the structure of its matrices; see `specimen_from_matrices`.

    Parameters
    ----------
    mass
        M, a list for each row, or the list of a diagonal [kg].
    stiffness
        K, a list for each row [N/m].
    damping
        C, a list for each row [N s/m]; none: damping ratios, or Rayleigh damping.
    damping_ratio
        Damping ratio of every mode, or a list with each mode's, by rising frequency [-].
    rayleigh_frequencies
        Two frequencies [Hz] at which Rayleigh damping has `rayleigh_damping_ratios`.
    rayleigh_damping_ratios
        Damping ratios at these two frequencies [-].
    """
    rayleigh = _rayleigh(rayleigh_frequencies, rayleigh_damping_ratios)
    return specimen_from_matrices(
        mass, stiffness, damping, damping_ratio=damping_ratio, rayleigh=rayleigh
    )


def structure_file(
    *,
    path: str,
    damping_ratio: float | tuple[float, ...] | None = None,
    rayleigh_frequencies: tuple[float, ...] | None = None,
    rayleigh_damping_ratios: tuple[float, ...] | None = None,
    _context: FormContext,
) -> Specimen:
    """Return the structure of a MAT or CSV file of its matrices; see `read_specimen`.

    Parameters
    ----------
    path
        The file with M, K and perhaps C, relative to the file that names it.
    damping_ratio
        Of a file without C: damping ratio of every mode, or a list with each mode's [-].
    rayleigh_frequencies
        Of a file without C: two frequencies [Hz] of Rayleigh damping.
    rayleigh_damping_ratios
        Damping ratios at these two frequencies [-].
    """
    rayleigh = _rayleigh(rayleigh_frequencies, rayleigh_damping_ratios)
    return read_specimen(_context.folder / path, damping_ratio=damping_ratio, rayleigh=rayleigh)


def measured_modes(
    *,
    masses: tuple[float, ...],
    frequencies: tuple[float, ...],
    damping_ratios: tuple[float, ...],
    shapes: tuple[tuple[float, ...], ...],
    _context: FormContext,
) -> Specimen:
    """Return a structure with measured modes; see `specimen_from_modes`.

    Parameters
    ----------
    masses
        Mass of each floor [kg].
    frequencies
        Frequency of each measured mode, rising [Hz].
    damping_ratios
        Damping ratio of each measured mode [-].
    shapes
        Mode shapes, a list for each floor with a number for each mode [-].
    """
    return specimen_from_modes(masses, frequencies, damping_ratios, shapes)


def _rayleigh(
    frequencies: tuple[float, ...] | None, ratios: tuple[float, ...] | None
) -> tuple[tuple[float, float], ...] | None:
    if frequencies is None and ratios is None:
        return None
    pairs = (frequencies or (), ratios or ())
    if [len(each) for each in pairs] != [2, 2]:
        name = "rayleigh_frequencies" if frequencies is not None else "rayleigh_damping_ratios"
        remedy = "give two rayleigh_frequencies and two rayleigh_damping_ratios"
        raise ParameterError(name, frequencies if frequencies is not None else ratios, remedy)
    return tuple(zip(*pairs, strict=True))


def recorded_file(
    *,
    path: str,
    name: str | None = None,
    column: str | int | None = None,
    units: str | None = None,
    sampling_interval: float | None = None,
    table: str | None = None,
    allow_large: bool = False,
    allow_seismometers: bool = False,
    remove_offset: bool = False,
    highpass_frequency: float | None = 0.2,
    lowpass_frequency: float | None = 25.0,
    time_compression: float = 1.0,
    duration: float | None = None,
    amplitude: float = 1.0,
    scale_to_table: bool = True,
    _context: FormContext,
) -> RecordedMotion:
    """Return the motion of one channel of a file of recorded acceleration; see `read_motion`.

    Parameters
    ----------
    path
        The file, relative to the file that names it.
    name
        Name of the record in results; none: that of the file.
    column
        The one channel or column to take: its title, or its number from 1 on; none: the only one.
    units
        Unit of a file that states none: g, %g, mg, m/s^2, cm/s^2, gal, mm/s^2, in/s^2 or ft/s^2; of
        counts with their sensitivity: '4.2e-7 m/s^2'.
    sampling_interval
        Step of a file that states none [s].
    table
        Variable of a .mat file or sheet of a workbook, where it holds several.
    allow_large
        Whether a peak above 3 g is accepted where `units` gave the unit.
    allow_seismometers
        Whether channels of seismometers are read.
    remove_offset
        Whether the mean is taken off first.
    highpass_frequency
        Lower end of the band that the table repeats [Hz], in the record's own time; none: open.
    lowpass_frequency
        Upper end of the band [Hz]; none, or above what the record's step resolves: open.
    time_compression
        Factor of time [-]; 2 plays the record in half its time.
    duration
        Part of the motion to keep [s] of table time; none: all.
    amplitude
        Factor on the recorded acceleration [-].
    scale_to_table
        Whether the amplitude is reduced until the motion is within the table's capacity.
    """
    file = _context.folder / path
    records = read_motion(
        file,
        units=units,
        sampling_interval=sampling_interval,
        column=column,
        table=table,
        allow_large=allow_large,
        allow_seismometers=allow_seismometers,
    )
    if len(records) != 1:
        names = ", ".join(repr(record.name.removeprefix(file.stem).strip()) for record in records)
        raise RecordError("column", None, f"the file holds {len(records)} channels: name one of {names}")
    record = remove_baseline(records[0], 0) if remove_offset else records[0]
    if name is not None:
        record = replace(record, name=name)
    coarse = lowpass_frequency is not None and lowpass_frequency * record.sampling_interval >= 0.5
    motion = RecordedMotion(
        record=record,
        amplitude=amplitude,
        time_compression=time_compression,
        highpass_frequency=highpass_frequency,
        duration=duration,
        lowpass_frequency=None if coarse else lowpass_frequency,
    )
    scenario = _context.scenario
    if not scale_to_table or scenario is None:
        return motion
    return fit_amplitude(motion, scenario_capacity(scenario), physics_step=scenario.physics_step).motion


def posterior_file(*, path: str, _context: FormContext) -> Uncertainty:
    """Return the samples of a posterior that `shake identify` wrote; see `read_samples`.

    Parameters
    ----------
    path
        The file, relative to the file that names it.
    """
    return read_samples(_context.folder / path)


FORMS: dict[type, Mapping[str, Callable[..., Any]]] = {
    Specimen: {
        "uniform": equal_storeys,
        "matrices": structure_matrices,
        "file": structure_file,
        "modes": measured_modes,
    },
    RecordedMotion: {"file": recorded_file},
    Uncertainty: {"posterior": posterior_file},
}
"""Part, to the name of a form, to its constructor."""
