"""The scenarios that have a name; each has a page in the docs that says what is in it and why."""

from __future__ import annotations

from collections.abc import Callable

from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops, Yielding
from shake_env.model.parameters import GroundFilter, ModelEquations, Specimen
from shake_env.motion.processing import RATED_VELOCITY, SUPPLY_PRESSURE, TableCapacity, fit_amplitude
from shake_env.motion.targets import Envelope, FilteredNoise, MotionSet, RecordedMotion
from shake_env.records import RECORD_NAMES
from shake_env.scenario.limits import Limits
from shake_env.scenario.observation import Sensing
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty, Uniform

LABORATORY_CURRENT = 0.040  # [A] 0.64 m/s of steady flow: above the records' 0.6 m/s, below the abort
# With the high-pass at 0.5 Hz and the envelope, the peak displacement of 1000 noise earthquakes has a
# median of 35 mm, 57 mm at 99 % and 65 mm at 99.9 %: within the soft stroke of 70 mm.
LABORATORY_AMPLITUDE = 0.22
# A third of the 4.3 mm that the elastic specimen's first storey reaches under these motions (median).
YIELD_DRIFT = 0.0015  # [m]
DELAY = 2.5  # [physics steps of 1 ms], half a control period


def _ground() -> GroundFilter:
    return GroundFilter(highpass_frequency=0.5)


def laboratory_noise() -> FilteredNoise:
    """Return the filtered noise of the laboratory's scenarios, within its stroke."""
    return FilteredNoise(duration=15.0, amplitude=LABORATORY_AMPLITUDE, envelope=Envelope())


def _table() -> Nonlinearity:
    return Nonlinearity(
        friction=Friction(coulomb=150.0),
        valve=ServoValve(supply_pressure=SUPPLY_PRESSURE, spool_limit=2e-5),
        stops=StrokeStops(gap=0.076),
    )


def linear() -> Scenario:
    """Return the paper's table in corrected equations: linear, fully seen, without limits."""
    return Scenario()


def as_printed() -> Scenario:
    """Return the paper's equations as published, for reproducing it only."""
    return Scenario(name="as-printed", equations=ModelEquations.as_printed())


def laboratory() -> Scenario:
    """Return a table as a laboratory has it: friction, orifice, limits, noise, delay, preview."""
    return Scenario(
        name="laboratory",
        ground=_ground(),
        motion=laboratory_noise(),
        nonlinearity=_table(),
        delay=DELAY,
        current_limit=LABORATORY_CURRENT,
        limits=Limits.laboratory(),
        sensing=Sensing.laboratory(),
    )


def unknown_specimen() -> Scenario:
    """Return the linear table with laboratory signals under a specimen that nobody has weighed."""
    return Scenario(
        name="unknown-specimen",
        specimen=Specimen.uniform(mass_ratio=0.55, storey_frequency=7.0),
        ground=_ground(),
        motion=laboratory_noise(),
        delay=DELAY,
        current_limit=LABORATORY_CURRENT,
        limits=Limits.laboratory(),
        sensing=Sensing.laboratory(),
        uncertainty=Uncertainty(mass_ratio=Uniform(0.1, 1.0), storey_frequency=Uniform(5.0, 9.0)),
    )


def yielding() -> Scenario:
    """Return a linear table, fully seen with a preview, under a specimen that the test damages."""
    return Scenario(
        name="yielding",
        ground=_ground(),
        motion=laboratory_noise(),
        nonlinearity=Nonlinearity(yielding=Yielding(yield_drift=YIELD_DRIFT)),
        current_limit=LABORATORY_CURRENT,
        limits=Limits.laboratory(),
        sensing=Sensing(preview=0.1),
    )


def records() -> Scenario:
    """Return the laboratory's table under the embedded records, each scaled until it can be repeated."""
    table = laboratory()
    capacity = TableCapacity.of(table.actuator, table.specimen, velocity=RATED_VELOCITY)
    motions = (
        RecordedMotion(record=name, highpass_frequency=0.2, lowpass_frequency=25.0)
        for name in RECORD_NAMES
    )
    return Scenario(
        name="records",
        ground=table.ground,
        motion=MotionSet(tuple(fit_amplitude(motion, capacity).motion for motion in motions)),
        nonlinearity=table.nonlinearity,
        delay=table.delay,
        current_limit=table.current_limit,
        limits=table.limits,
        sensing=table.sensing,
        train_on=table.name,
    )


NAMED: dict[str, Callable[[], Scenario]] = {
    "linear": linear,
    "as-printed": as_printed,
    "laboratory": laboratory,
    "unknown-specimen": unknown_specimen,
    "yielding": yielding,
    "records": records,
}
