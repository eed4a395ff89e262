"""The scenarios that have a name; each has a page in the docs that says what is in it and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops, Yielding
from shake_env.model.parameters import GroundFilter, ModelEquations, Specimen
from shake_env.motion.processing import RATED_VELOCITY, SUPPLY_PRESSURE, TableCapacity, fit_amplitude
from shake_env.motion.targets import Envelope, FilteredNoise, MotionSet, RecordedMotion
from shake_env.records import RECORD_NAMES
from shake_env.scenario.limits import Limits
from shake_env.scenario.observation import Sensing, Sensor
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty, Uniform

LABORATORY_CURRENT = 0.040  # [A] 0.64 m/s of steady flow: above the records' 0.6 m/s, below the abort
# With the high-pass at 0.5 Hz and the envelope, the peak displacement of 1000 noise earthquakes has a
# median of 35 mm, 57 mm at 99 % and 65 mm at 99.9 %: within the soft stroke of 70 mm.
LABORATORY_AMPLITUDE = 0.22
# A third of the 4.3 mm that the elastic specimen's first storey reaches under these motions (median).
YIELD_DRIFT = 0.0015  # [m]
DELAY = 2.5  # [physics steps of 1 ms], half a control period
FIELD_LEAKAGE = 1e-12  # [m^3/(Pa s)] of worn seals and valve lands
FIELD_SAG = 5e10  # [Pa/m] 1 MPa at 20 um of spool, full flow


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
    """Return the paper's table in corrected equations: linear, full state, without limits."""
    return Scenario()


def as_printed() -> Scenario:
    """Return the paper's equations as published, for reproducing it only."""
    return Scenario(name="as-printed", equations=ModelEquations.as_printed())


def laboratory() -> Scenario:
    """Return a laboratory's table: friction, orifice, limits, noise, delay, preview."""
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
    """Return the linear table with laboratory signals under a specimen of unknown mass and stiffness."""
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
    """Return a linear table with full state and a preview, under a specimen whose storeys yield."""
    return Scenario(
        name="yielding",
        ground=_ground(),
        motion=laboratory_noise(),
        nonlinearity=Nonlinearity(yielding=Yielding(yield_drift=YIELD_DRIFT)),
        current_limit=LABORATORY_CURRENT,
        limits=Limits.laboratory(),
        sensing=Sensing(preview=0.1),
    )


def field() -> Scenario:
    """Return the laboratory's table with parameters drawn around the nominal ones.

    The nominal table is `laboratory` with a valve of second order, Stribeck friction and a supply that
    sags; it is what controllers are designed on. Each spread has its reason on the scenario's page.
    """
    table = laboratory()
    nominal, parts = table.actuator, table.nonlinearity
    friction = replace(parts.friction, static=1.4 * parts.friction.coulomb)
    valve = replace(parts.valve.with_pilot_stage(nominal.valve_time_constant), supply_sag=FIELD_SAG)
    frequency = valve.natural_frequency
    assert frequency is not None  # the pilot stage's
    sensors = tuple(_in_the_field(sensor) for sensor in table.sensing.sensors or ())
    specimen = table.specimen.uniform_values(nominal.table_mass)

    def around(value: float, share: float) -> Uniform:
        return Uniform((1.0 - share) * value, (1.0 + share) * value)

    return replace(
        table,
        name="field",
        nonlinearity=replace(parts, friction=friction, valve=valve),
        sensing=replace(table.sensing, sensors=sensors),
        uncertainty=Uncertainty(
            mass_ratio=around(specimen["mass_ratio"], 0.30),
            storey_frequency=around(specimen["storey_frequency"], 0.15),
            bulk_modulus=around(nominal.bulk_modulus, 0.20),
            leakage=Uniform(nominal.leakage, FIELD_LEAKAGE),
            valve_gain=around(nominal.valve_gain, 0.10),
            coulomb_friction=Uniform(50.0, 400.0),
            delay=Uniform(DELAY - 1.0, DELAY + 1.0),
            table_mass=around(nominal.table_mass, 0.02),
            supply_pressure=Uniform(17e6, 21e6),
            valve_natural_frequency=around(frequency, 0.10),
            storey_factor=Uniform(0.9, 1.1),
        ),
    )


def _in_the_field(sensor: Sensor) -> Sensor:
    """Return a sensor with the gain error and offset of one that is not calibrated for each test."""
    full_scale = sensor.noise / 1e-3  # see `Sensing.laboratory`
    return replace(sensor, gain_error=0.01, bias=max(sensor.bias, 5e-4 * full_scale))


def records() -> Scenario:
    """Return the laboratory's table under the embedded records, each scaled to the table."""
    table = laboratory()
    capacity = TableCapacity.from_actuator(table.actuator, table.specimen, velocity=RATED_VELOCITY)
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
    "field": field,
    "records": records,
}
