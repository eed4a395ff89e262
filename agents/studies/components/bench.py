"""The nonlinear parts in separate simulated tests: laws and kernel under simple inputs.

A storey is cycled through drift, the table is driven by a sinusoidal current, the valve is read off
over load pressure. Laws come from `shake_env.model.nonlinearity`, steps from
`shake_env.dynamics.nonlinear`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from shake_env import make_scenario
from shake_env.dynamics.nonlinear import NonlinearDynamics, specimen_with_slip
from shake_env.dynamics.yielding_reference import YieldingReference
from shake_env.errors import ParameterError
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, Yielding
from shake_env.model.parameters import FloatArray, require_positive
from shake_env.model.plant import LOAD_PRESSURE, TABLE_DISPLACEMENT, TABLE_VELOCITY, CoupledPlant
from shake_env.motion.targets import RecordedMotion, target_history

SAMPLES = 200  # drift samples from one turning point to the next
EXPONENTS = (1.0, 4.0, 20.0)  # as soft as the law goes, its default, nearly elastoplastic
LEVELS = (0.0, 150.0, 300.0, 600.0)  # [N] Coulomb friction: none, and small to stiff seals


@dataclass(frozen=True, kw_only=True)
class ComponentSetup:
    """The parts that are shown, at values a laboratory would recognise.

    Raises
    ------
    ParameterError
        If storeys don't yield, supply or spool have no limit, or a drive is not above zero.
    """

    plant: CoupledPlant = field(default_factory=lambda: make_scenario().plant)
    # 0.8 % of a storey 0.5 m high: yielding begins ahead of the 1 % at which drift counts as rated.
    yielding: Yielding = field(default_factory=partial(Yielding, yield_drift=0.004))
    # Seals of a small table. The viscous part adds a fifth to the table's own 1000 N s/m.
    friction: Friction = field(
        default_factory=partial(Friction, coulomb=150.0, static=220.0, viscous=200.0)
    )
    # The dead band, 4 % of the travel, is an overlap that a worn or cheap valve has.
    valve: ServoValve = field(
        default_factory=partial(ServoValve, supply_pressure=21e6, spool_limit=1.25e-5, dead_band=5e-7)
    )
    ductilities: tuple[float, ...] = (
        0.5,
        1.0,
        2.0,
        3.0,
        4.0,
        5.0,
    )  # [-] drift over yield drift, a cycle each
    frequency: float = 1.0  # [Hz] of the sinusoidal current
    current: float = 0.010  # [A] its amplitude: 25 mm and 0.16 m/s
    record: str = "napa2014_68150_hne"
    amplitude: float = 1.0  # [-] of the record
    duration: float = 16.0  # [s] of the record: what comes after is elastic

    def __post_init__(self) -> None:
        require_positive(self, "frequency", "current", "amplitude", "duration")
        if not self.yielding.active:
            raise ParameterError("yield_drift", self.yielding.yield_drift, "must be finite to be drawn")
        for name in ("supply_pressure", "spool_limit"):
            if not math.isfinite(getattr(self.valve, name)):
                raise ParameterError(name, getattr(self.valve, name), "must be finite to be drawn")
        if not self.ductilities or min(self.ductilities) <= 0.0:
            raise ParameterError("ductilities", self.ductilities, "give at least one, each above 0")

    @property
    def stiffness(self) -> float:
        """Stiffness k of the first storey [N/m]."""
        return self.plant.specimen.stiffnesses[0]

    @property
    def yield_force(self) -> float:
        """Yield force F_y = k z_y [N]."""
        return self.stiffness * self.yielding.yield_drift


def drift_path(turning_points: Sequence[float], samples: int = SAMPLES) -> FloatArray:
    """Return drift from zero through turning points, straight between them.

    Parameters
    ----------
    turning_points
        Drift at each reversal [m]; the last one ends the path.
    samples
        Steps from each to the next.

    Returns
    -------
    (1 + samples len(turning_points),) [m]. The law knows no rate, so that a straight path and a
    sinusoidal one give the same loop.
    """
    legs = [np.zeros(1)]
    for start, end in zip([0.0, *turning_points[:-1]], turning_points, strict=True):
        legs.append(np.linspace(start, end, samples + 1)[1:])
    return np.concatenate(legs)


def slip_history(yielding: Yielding, drift: FloatArray) -> FloatArray:
    """Return the slip (samples, ...) [m] of storeys that are led through drift (samples, ...) [m].

    The scheme of the table's kernel, which for a slip alone is Heun's.
    """
    slip = np.zeros_like(drift)
    for j, change in enumerate(np.diff(drift, axis=0)):
        rate = yielding.slip_rate(drift[j], change, slip[j])
        following = yielding.slip_rate(drift[j + 1], change, slip[j] + rate)
        slip[j + 1] = slip[j] + 0.5 * (rate + following)
    return slip


def storey_force(
    plant: CoupledPlant, yielding: Yielding, drift: FloatArray, slip: FloatArray
) -> FloatArray:
    """Return the first storey's force (samples, ...) [N], without its damper's share."""
    row, n = specimen_with_slip(plant, yielding).C[0], plant.specimen.stories
    force: FloatArray = row[0] * drift + row[2 * n] * slip
    return force


def loop_area(force: FloatArray, path: FloatArray) -> FloatArray:
    """Return the integral of force (samples, ...) [N] over path (samples, ...) [m], in J."""
    return np.asarray(np.trapezoid(force, path, axis=0))


@dataclass(frozen=True)
class StoreyLoop:
    """A storey's force over drift under cycles that grow."""

    drift: FloatArray  # (samples,) [m]
    force: FloatArray  # (samples,) [N]
    amplitudes: FloatArray  # (cycles,) [m]
    cycle_energy: FloatArray  # (cycles,) [J] dissipated from one zero of the drift to its next but one


def growing_cycles(bench: ComponentSetup, yielding: Yielding | None = None) -> StoreyLoop:
    """Cycle the storey once through each of the bench's ductilities."""
    law = bench.yielding if yielding is None else yielding
    amplitudes = law.yield_drift * np.asarray(bench.ductilities)
    turns = [turn for a in amplitudes for turn in (a, -a, 0.0)]
    drift = drift_path(turns)
    slip = slip_history(law, drift)
    hysteretic = drift - slip
    # What slips is lost; the elastic energy of z comes back and is no part of it.
    lost = bench.stiffness * (1.0 - law.stiffness_ratio) * hysteretic
    cycles = np.reshape(np.arange(3 * SAMPLES * len(amplitudes)), (len(amplitudes), -1))
    energy = [float(loop_area(lost[[*c, c[-1] + 1]], slip[[*c, c[-1] + 1]])) for c in cycles]
    return StoreyLoop(drift, storey_force(bench.plant, law, drift, slip), amplitudes, np.asarray(energy))


def steady_loop(
    bench: ComponentSetup, yielding: Yielding, amplitudes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Cycle storeys at constant amplitudes until their loops repeat.

    Parameters
    ----------
    bench
        Whose storey.
    yielding
        Its law.
    amplitudes
        (loops,) [m].

    Returns
    -------
    drift, force, energy
        (samples, loops) [m] and (samples, loops) [N] of the last cycle, and (loops,) [J] a cycle.
    """
    # A half-cycle leaves 1 - (z / z_y)^n of the distance to the steady loop: eight cycles are enough but
    # for sharp knees below yielding, whose loops have next to no area.
    drift = drift_path([1.0, -1.0] * 8 + [1.0])[:, None] * amplitudes
    force = storey_force(bench.plant, yielding, drift, slip_history(yielding, drift))
    cycle = slice(-2 * SAMPLES - 1, None)
    return drift[cycle], force[cycle], loop_area(force[cycle], drift[cycle])


def elastoplastic_energy(
    bench: ComponentSetup, yielding: Yielding, amplitudes: FloatArray
) -> FloatArray:
    """Return ``4 (1 - alpha) F_y (d - d_y)`` [J], what a cycle takes as the exponent grows, (loops,)."""
    excess = np.maximum(amplitudes - yielding.yield_drift, 0.0)
    force = bench.stiffness * yielding.yield_drift
    return 4.0 * (1.0 - yielding.stiffness_ratio) * force * excess


def shaken_storey(bench: ComponentSetup, step: float = 1e-3) -> tuple[FloatArray, FloatArray]:
    """Return first drift [m] and base shear [N] of the bench's building under its record, (samples,).

    By the kernel that steps the yielding reference specimen; base shear holds the damper's share.
    """
    motion = RecordedMotion(record=bench.record, amplitude=bench.amplitude, duration=bench.duration)
    target = target_history(motion, step).acceleration
    kernel = YieldingReference.from_plant(bench.plant, bench.yielding, step)
    _, states, shear = kernel.run(np.zeros((1, 3 * kernel.stories)), target[:, None])
    return states[:, 0, 0], shear[:, 0]


@dataclass(frozen=True)
class TablePeriod:
    """One period of tables under a sinusoidal valve current, one table for each friction level."""

    time: FloatArray  # (samples,) [s] from the start of the period
    displacement: FloatArray  # (samples, tables) [m]
    velocity: FloatArray  # (samples, tables) [m/s]
    acceleration: FloatArray  # (samples, tables) [m/s^2]
    friction: FloatArray  # (samples, tables) [N] found from the other signals by Newton's law
    reversal: FloatArray  # (tables,) [s] where the velocity crosses zero downwards

    @property
    def energy(self) -> FloatArray:
        """What friction takes in the period, (tables,) [J]."""
        return -loop_area(self.friction, self.displacement)


def sinusoidal_table(
    bench: ComponentSetup, friction: Friction, levels: Sequence[float] | None = None, step: float = 5e-4
) -> TablePeriod:
    """Drive tables by a sinusoidal current until they repeat, and return the last period.

    Open loop and with the linear valve, so that friction is all that is not linear.

    Parameters
    ----------
    bench
        Whose plant and drive.
    friction
        The law.
    levels
        (tables,) Coulomb friction [N] in place of the law's; None: one table with the law's own.
    step
        Physics step [s].
    """
    # The ramp keeps slow modes still; the oil column's ringing falls by a factor of 16 in a second. The
    # last period begins at the largest velocity, so that no reversal lies at its edge.
    periods, ramp = 7.25, 2.0
    samples = round(1.0 / (bench.frequency * step))
    coulomb = np.asarray([friction.coulomb] if levels is None else levels, dtype=float)
    kernel = NonlinearDynamics.from_plant(bench.plant, Nonlinearity(friction=friction), step, 1)
    kernel = replace(kernel, coulomb=coulomb)
    time = step * np.arange(round(periods * samples))
    phase = bench.frequency * (time + 0.5 * step)  # [-] a held current stands for its step's middle
    current = bench.current * np.sin(2.0 * np.pi * phase) * np.minimum(phase / ramp, 1.0)
    state = np.zeros((len(coulomb), kernel.states))
    states, accelerations, shears = [], [], []
    for value in current:
        response = kernel.control_step(state, np.full(len(coulomb), value))
        state = response.state
        states.append(state)
        accelerations.append(response.table_acceleration[:, 0])
        shears.append(response.base_shear[:, 0])
    # One sample more than the period, so that its loops close.
    last = np.stack(states[-samples - 1 :])
    acceleration, shear = np.stack(accelerations[-samples - 1 :]), np.stack(shears[-samples - 1 :])
    a, velocity = bench.plant.actuator, last[..., TABLE_VELOCITY]
    force = a.table_mass * acceleration + a.table_damping * velocity
    force = force + a.table_stiffness * last[..., TABLE_DISPLACEMENT]
    force = force - a.piston_area * last[..., LOAD_PRESSURE] - shear
    own_time = step * np.arange(samples + 1, dtype=np.float64)
    return TablePeriod(
        own_time, last[..., TABLE_DISPLACEMENT], velocity, acceleration, force,
        np.asarray([_falls(own_time, v) for v in velocity.T]),
    )  # fmt: skip


def _falls(time: FloatArray, values: FloatArray) -> float:
    """Return when `values` first falls through zero, straight between samples."""
    before = int(np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))[0])
    share = values[before] / (values[before] - values[before + 1])
    return float(time[before] + share * (time[before + 1] - time[before]))


def valve_flow(
    bench: ComponentSetup, valve: ServoValve, spool: FloatArray, pressure: FloatArray
) -> FloatArray:
    """Return the flow (...) [m^3/s] at a spool position (...) [m] and load pressure (...) [Pa]."""
    flow: FloatArray = bench.plant.actuator.flow_gain * valve.opening(spool, pressure)
    return flow
