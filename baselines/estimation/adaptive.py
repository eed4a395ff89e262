"""Certainty equivalence: find out which specimen stands on the table, and drive it by its own LQR.

The table weighs its specimen: ``f_s = m_a y_A + c_a v_a + k_a x_a - A_p p_l`` is known from its own
signals. Each candidate frequency's specimen is simulated from the table's acceleration; the mass ratio
that its base shear then needs follows by least squares with forgetting, and what is left decides
between frequencies (the multiple-model estimator of Lainiotis, Proc. IEEE 64, 1976, with the mass
integrated out). The command is the posterior mean of the candidates' preview LQR commands, as if what
is believed were true (Astrom and Wittenmark, Adaptive Control, 1995, ch. 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimation.specimen_bank import SpecimenBank
from baselines.estimation.table_observer import SIGNALS, TableObserver, check_signals
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.parameters import Actuator, FloatArray
from shake_env.model.plant import (
    LOAD_PRESSURE,
    SPOOL_POSITION,
    TABLE_DISPLACEMENT,
    TABLE_VELOCITY,
    ground_filter,
)
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class AdaptiveState:
    """What is remembered of N tables, between control periods."""

    specimen: FloatArray  # (N, F, 2 stories) x_S of each candidate frequency
    reference: FloatArray  # (N, F, 2 stories) x~_S
    moments: FloatArray  # (N, F, 2) forgetting sums of phi^2 and phi f_s; phi the shear at mass ratio 1
    square: FloatArray  # (N,) and of f_s^2 [N^2]
    table: FloatArray  # (N, 4) x_A of the last period, shown or estimated
    acceleration: FloatArray  # (N, 2) last y_A, and its low-passed reading [m/s^2]
    target: FloatArray  # (N,) last y~ [m/s^2]
    phi: FloatArray  # (N, F) last phi [N]
    commands: FloatArray  # (N, 2) last command, and the one before [A]
    started: NDArray[np.bool_]  # (N,) whether there was a last period

    @classmethod
    def none(cls, lanes: int, candidates: int, states: int) -> AdaptiveState:
        """Return the memory before anything was seen: all at rest."""
        two = (lanes, candidates, states)
        return cls(
            np.zeros(two), np.zeros(two), np.zeros((lanes, candidates, 2)), np.zeros(lanes),
            np.zeros((lanes, 4)), np.zeros((lanes, 2)), np.zeros(lanes), np.zeros((lanes, candidates)),
            np.zeros((lanes, 2)), np.zeros(lanes, dtype=bool),
        )  # fmt: skip

    def restarted(self, lanes: NDArray[np.bool_]) -> AdaptiveState:
        """Return this memory with `lanes` (N,) as before anything was seen."""
        if not lanes.any():
            return self
        arrays = {}
        for field in fields(self):
            arrays[field.name] = getattr(self, field.name).copy()
            arrays[field.name][lanes] = 0
        return AdaptiveState(**arrays)


class CertaintyEquivalence:
    """The law as a `Controller`.

    Parameters
    ----------
    scenario
        Whose nominal model, uncertainty and observation it reads: the full state, or the five signals
        `table_observer.SIGNALS`. What is not uncertain there is taken for known.
    bank
        The candidates; None: `SpecimenBank.from_scenario` with a displacement weight.
    memory
        [s] over which evidence is forgotten; infinite: never.
    floor
        Error of a simulated base shear that is expected beside the sensors' noise, over the nominal
        reference's rms [-]: what sampling and an imperfect model leave.

    Raises
    ------
    ParameterError
        If memory or floor are not above 0.
    ScenarioError
        If a signal is missing.
    """

    def __init__(
        self,
        scenario: Scenario,
        bank: SpecimenBank | None = None,
        *,
        memory: float = 20.0,
        floor: float = 0.05,
        position: float | None = None,
    ) -> None:
        if not (memory > 0.0 and 0.0 < floor < math.inf):
            raise ParameterError("memory, floor", (memory, floor), "must be above 0")
        shown, plant = scenario.observation, scenario.plant
        if not scenario.sensing.full_state:
            check_signals(shown.reading_names)
        self.scenario = scenario
        self.bank = SpecimenBank.from_scenario(scenario, position=position) if bank is None else bank
        self.forget = math.exp(-scenario.control_period / memory)  # of evidence, a period [-]
        self.source = ground_filter(scenario.ground).C[0]  # (w,) target per SI unit of x_W
        uncertain = scenario.uncertainty.mass_ratio
        low, high = (0.0, 0.0) if uncertain is None else (uncertain.low, uncertain.high)
        nominal = float(np.mean(self.bank.mass_ratios))
        self.prior = (nominal, max((high - low) ** 2 / 12.0, 1e-12))  # mass ratio: mean, variance
        rms = math.sqrt(float(plant.reference_shear_variance)) * scenario.motion.amplitude
        a, noise = scenario.actuator, self._noise
        sensors = np.array(
            [
                a.table_mass * noise("table_acceleration"),
                a.table_damping * noise("table_velocity"),
                a.piston_area * noise("load_pressure"),
            ]
        )
        self.variance = float(np.sum(sensors**2)) + (floor * rms) ** 2  # of a balance's shear [N^2]
        self.impulse = _impulse(a, scenario.control_period)
        # Base shear [N] that the balance of forces leaves, per SI unit of each of `SIGNALS`, (5,).
        force = {
            "table_displacement": a.table_stiffness, "table_velocity": a.table_damping,
            "load_pressure": -a.piston_area, "table_acceleration": a.table_mass,
        }  # fmt: skip
        self.balance = np.array([force.get(signal, 0.0) for signal in SIGNALS])
        self.observer = None
        if not scenario.sensing.full_state:
            self.observer = TableObserver.from_scenario(scenario, floor * rms)
            # Where the readings have each of `SIGNALS`.
            self.places = [shown.reading_names.index(signal) for signal in SIGNALS]
            # The accelerometer's low-pass, f' = omega (y - f), is undone by a difference of readings.
            cutoff = shown.sensor_values("lowpass_frequency")[self.places[-1]]
            self.lead = 1.0 / (2.0 * math.pi * scenario.control_period * cutoff)  # [-]

    def _noise(self, signal: str) -> float:
        names = self.scenario.observation.reading_names
        if signal not in names:
            return 0.0
        return float(self.scenario.observation.sensor_values("noise")[names.index(signal)])

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), within [-1, 1]."""
        rows = np.atleast_2d(observation).astype(float)
        if state is None:
            belief = AdaptiveState.none(len(rows), *self.bank.shear.shape)
        else:
            belief = state[0]
            if episode_start is not None:
                belief = belief.restarted(np.atleast_1d(episode_start))
        current, belief = self._command(rows, belief)
        action = current / self.scenario.current_limit
        return action.reshape(*observation.shape[:-1], 1).astype(np.float32), (belief,)

    def posterior(self, belief: AdaptiveState) -> tuple[FloatArray, FloatArray]:
        """Return each frequency's probability (N, F) and its mass ratio (N, F)."""
        mean, variance = self.prior
        precision = belief.moments[..., 0] / self.variance + 1.0 / variance
        mass = (belief.moments[..., 1] / self.variance + mean / variance) / precision
        low, high = self.bank.mass_ratios[[0, -1]]
        mass = np.clip(mass, low, high)
        left = belief.square[:, None] - 2.0 * mass * belief.moments[..., 1]
        left += mass**2 * belief.moments[..., 0]
        evidence = left / self.variance + (mass - mean) ** 2 / variance + np.log(precision * variance)
        weight = np.exp(-0.5 * (evidence - evidence.min(axis=-1, keepdims=True)))
        return weight / weight.sum(axis=-1, keepdims=True), mass

    def estimate(self, belief: AdaptiveState) -> tuple[FloatArray, FloatArray]:
        """Return the posterior mean of mass ratio (N,) and storey frequency (N,) [Hz]."""
        weight, mass = self.posterior(belief)
        return np.sum(weight * mass, axis=-1), weight @ self.bank.frequencies

    def _command(self, rows: FloatArray, belief: AdaptiveState) -> tuple[FloatArray, AdaptiveState]:
        scenario, shown = self.scenario, self.scenario.observation
        layout, scale = scenario.plant.layout, scenario.plant.state_scale
        head = rows[:, : shown.head] * scale[: shown.head]
        ground = head[:, layout.ground]
        target = ground @ self.source
        if shown.sensing.last_action:  # what was given, which a supervisor may have changed
            given = scenario.current_limit * rows[:, shown.last_action]
            belief = replace(belief, commands=np.concatenate([given, belief.commands[:, 1:]], axis=-1))
        if self.observer is None:
            belief = self._shown(head, belief)
            weight, mass = self.posterior(belief)
            table = head[:, layout.actuator]
        else:
            readings, raw = self._readings(rows, belief)
            before, belief = belief.phi, self._simulated(readings, raw, target, belief)
            weight, mass = self.posterior(belief)
            shear = np.stack([np.sum(weight * mass * phi, axis=-1) for phi in (before, belief.phi)], -1)
            table = self.observer.update(belief.table, belief.commands, shear, readings)
        common = np.concatenate(
            [
                rows[:, shown.preview] * math.sqrt(scenario.plant.target_variance),
                belief.commands[:, :1],
            ],
            axis=-1,
        )
        candidates = belief.phi.shape
        features = np.concatenate(
            [
                np.broadcast_to(ground[:, None], (*candidates, ground.shape[-1])),
                np.broadcast_to(table[:, None], (*candidates, 4)),
                belief.specimen,
                belief.reference,
                np.broadcast_to(common[:, None], (*candidates, common.shape[-1])),
            ],
            axis=-1,
        )
        wanted = np.sum(self.bank.law(mass) * features, axis=-1)
        limit = scenario.current_limit
        current: FloatArray = np.clip(np.sum(weight * wanted, axis=-1), -limit, limit)
        now = np.ones(len(rows), dtype=bool)
        commands = np.stack([current, belief.commands[:, 0]], axis=-1)
        belief = replace(belief, table=table, target=target, commands=commands, started=now)
        return current, belief

    def _learnt(self, belief: AdaptiveState, phi: FloatArray, shear: FloatArray) -> AdaptiveState:
        """Return the belief after a period of `shear` (N,); an episode's start tells nothing."""
        new = np.where(belief.started[:, None], phi, 0.0)
        f = np.where(belief.started, shear, 0.0)
        added = np.stack([new**2, new * f[:, None]], axis=-1)
        return replace(
            belief,
            moments=self.forget * belief.moments + added,
            square=self.forget * belief.square + f**2,
        )

    def _readings(self, rows: FloatArray, belief: AdaptiveState) -> tuple[FloatArray, FloatArray]:
        """Return the readings (N, 5) of `SIGNALS` in SI, the low-pass undone, and what it gave."""
        shown = self.scenario.observation
        readings = (rows[:, shown.readings] * shown.reading_scale)[:, self.places]
        raw = readings[:, -1].copy()
        readings[:, -1] += self.lead * (raw - belief.acceleration[:, 1])
        return readings, raw

    def _simulated(
        self, readings: FloatArray, raw: FloatArray, target: FloatArray, belief: AdaptiveState
    ) -> AdaptiveState:
        """Advance the candidates by measured acceleration and target, and learn from the balance."""
        acceleration = readings[:, -1]
        b = self.bank
        specimen, reference = (
            np.einsum("fij,nfj->nfi", b.advance, x)
            + b.now * last[:, None, None]
            + b.following * present[:, None, None]
            for x, last, present in (
                (belief.specimen, belief.acceleration[:, 0], acceleration),
                (belief.reference, belief.target, target),
            )
        )
        phi = np.sum(b.shear * specimen, axis=-1)
        belief = self._learnt(belief, phi, readings @ self.balance)
        return replace(
            belief,
            specimen=specimen,
            reference=reference,
            phi=phi,
            acceleration=np.stack([acceleration, raw], axis=-1),
        )

    def _shown(self, head: FloatArray, belief: AdaptiveState) -> AdaptiveState:
        """Learn from the full state: a period's impulse is the change of momentum."""
        layout = self.scenario.plant.layout
        table = head[:, layout.actuator]
        candidates = len(self.bank.frequencies)
        specimen = np.repeat(head[:, None, layout.specimen], candidates, axis=1)
        reference = np.repeat(head[:, None, layout.reference], candidates, axis=1)
        phi = np.sum(self.bank.shear * specimen, axis=-1)
        shear = belief.table @ self.impulse[0] + table @ self.impulse[1]
        belief = self._learnt(belief, 0.5 * (belief.phi + phi), shear)
        return replace(belief, specimen=specimen, reference=reference, phi=phi)


def _impulse(a: Actuator, period: float) -> FloatArray:
    """Return the mean base shear [N] of a period per SI unit of x_A at its start and end, (2, 4).

    The change of momentum less the other forces' impulse. The pressure's slope is known at both ends:
    its mean is that of the cubic between them.
    """
    slope = np.zeros(4)
    slope[[SPOOL_POSITION, TABLE_VELOCITY, LOAD_PRESSURE]] = a.flow_gain, -a.piston_area, -a.leakage
    slope *= 4.0 * a.bulk_modulus / a.oil_volume
    rows = np.zeros((2, 4))
    for row, sign in zip(rows, (-1.0, 1.0), strict=True):
        row[TABLE_VELOCITY] = sign * a.table_mass / period
        row[TABLE_DISPLACEMENT] = sign * a.table_damping / period + 0.5 * a.table_stiffness
        row[LOAD_PRESSURE] = -0.5 * a.piston_area
        row += sign * a.piston_area * period / 12.0 * slope
    return rows


def certainty_equivalence(
    scenario: Scenario, displacement_tolerance: float = 0.05
) -> CertaintyEquivalence:
    """Return the adaptive law, with a displacement weight where the ground has a high-pass.

    Raises
    ------
    ScenarioError
        If nothing is uncertain that it could find out.
    """
    if scenario.uncertainty.mass_ratio is None and scenario.uncertainty.storey_frequency is None:
        raise ScenarioError("uncertainty", scenario.uncertainty, "has no uncertain specimen: use lqg")
    position = None if scenario.ground.highpass_frequency is None else displacement_tolerance
    return CertaintyEquivalence(scenario, position=position)
