"""Linear output feedback on measured signals, and the sampled nominal table that it is judged on.

PID and three-variable control are the same thing with different numbers: a small discrete linear system
from the eight signals of :mod:`baselines.servo.signals` to the current. Its closed loop with the nominal
table (hold, loop delay and specimen included) is then a matrix: stability and frequency response are
exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from baselines.servo.signals import (
    SIGNALS,
    TARGET_ACCELERATION,
    TARGET_DISPLACEMENT,
    TARGET_VELOCITY,
    Memory,
    SignalReader,
    as_action,
    recall,
)
from shake_env.dynamics.nonlinear import arrival, commands_under_way
from shake_env.errors import ParameterError
from shake_env.model.discretization import DiscretePlant
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_DISPLACEMENT, TABLE_VELOCITY
from shake_env.scenario.scenario import Scenario

ComplexArray = NDArray[np.complex128]
BASE_SHEAR = 5  # row of NominalTable.C after the five table signals


@dataclass(frozen=True)
class NominalTable:
    """The nominal table over one control period: ``x[k+1] = F x[k] + G u[k]``, ``y[k] = C x[k]``.

    States ``[x_A, x_S]`` and the commands under way, oldest first. Linear: friction, orifice and limits
    are not in it.
    """

    F: FloatArray  # (m, m)
    G: FloatArray  # (m,)
    C: FloatArray  # (6, m) the five table signals and the base shear, SI
    period: float  # [s]

    @classmethod
    def from_scenario(cls, scenario: Scenario, discrete: DiscretePlant | None = None) -> NominalTable:
        """Return the table of a scenario; `discrete` puts another plant in its place."""
        plant = scenario.discrete if discrete is None else discrete
        inner, k = plant.layout.controlled, plant.substeps
        A, B = plant.model.A[inner, inner], plant.model.B[inner, 0]
        commands = commands_under_way(scenario.delay, k)
        picks = arrival(scenario.delay, k, commands)
        n = len(A)
        running, arriving = np.eye(n), np.zeros((n, commands + 1))
        for row in picks:
            running, arriving = A @ running, A @ arriving + np.outer(B, row)
        F = np.zeros((n + commands, n + commands))
        G = np.zeros(n + commands)
        F[:n, :n], F[:n, n:], G[:n] = running, arriving[:, :commands], arriving[:, commands]
        if commands:
            F[n:-1, n + 1 :] = np.eye(commands - 1)
            G[-1] = 1.0
        C = np.zeros((6, n + commands))
        for row_index, state in enumerate((TABLE_DISPLACEMENT, TABLE_VELOCITY)):
            C[row_index, state] = 1.0
        C[2, :n], C[BASE_SHEAR, :n] = plant.plant.driven.C[:2, :n]
        C[3, LOAD_PRESSURE] = C[4, SPOOL_POSITION] = 1.0
        return cls(F, G, C, scenario.control_period)

    def response(self, frequency: FloatArray) -> ComplexArray:
        """Return the response of the outputs to the current, (frequencies, 6), at `frequency` [Hz]."""
        z = np.exp(2j * np.pi * frequency * self.period)
        m = len(self.G)
        states = np.linalg.solve(z[:, None, None] * np.eye(m) - self.F, self.G[:, None] + 0j)
        gain: ComplexArray = (self.C @ states)[..., 0]
        return gain


@dataclass(frozen=True)
class LinearLaw:
    """A discrete law from signals s to the current, with memory xi.

    ``u = C xi + D s``, ``xi+ = A xi + B s + W (sat(u) - u)``: W is what saturation
    feeds back into the memory, so that it does not wind up.
    """

    A: FloatArray  # (r, r)
    B: FloatArray  # (r, 8)
    C: FloatArray  # (r,)
    D: FloatArray  # (8,)
    W: FloatArray  # (r,)

    def __post_init__(self) -> None:
        r = len(self.C)
        shapes = (self.A.shape, self.B.shape, self.D.shape, self.W.shape)
        if shapes != ((r, r), (r, SIGNALS), (SIGNALS,), (r,)):
            raise ParameterError("A, B, D, W shapes", shapes, f"must fit C of {r} and {SIGNALS} signals")

    @classmethod
    def static(cls, D: FloatArray) -> LinearLaw:
        """Return a law without memory."""
        return cls(np.zeros((0, 0)), np.zeros((0, SIGNALS)), np.zeros(0), D, np.zeros(0))


@dataclass(frozen=True)
class SampledClosedLoop:
    """A law and the nominal table: states ``[x, xi]``, input the target's three signals."""

    table: NominalTable
    law: LinearLaw

    @cached_property
    def F(self) -> FloatArray:
        """(m + r, m + r) one control period."""
        t, law = self.table, self.law
        measured = t.C[:5]
        return np.block(
            [
                [t.F + np.outer(t.G, law.D[:5] @ measured), np.outer(t.G, law.C)],
                [law.B[:, :5] @ measured, law.A],
            ]
        )

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of `F`, largest first."""
        values: ComplexArray = np.linalg.eigvals(self.F).astype(np.complex128)
        return values[np.argsort(-np.abs(values))]

    @property
    def radius(self) -> float:
        """Spectral radius; below 1 the loop is stable."""
        return float(np.abs(self.poles[0]))

    def response(self, frequency: FloatArray) -> ComplexArray:
        """Return table acceleration over target acceleration at `frequency` (f,) [Hz], above 0.

        Target velocity and displacement are the exact integrals of a target sine.
        """
        s = 2j * np.pi * frequency
        target = np.zeros((len(frequency), SIGNALS), dtype=complex)
        target[:, TARGET_ACCELERATION] = 1.0
        target[:, TARGET_VELOCITY], target[:, TARGET_DISPLACEMENT] = 1.0 / s, 1.0 / s**2
        drive = np.concatenate(
            [(target @ self.law.D)[:, None] * self.table.G, target @ self.law.B.T], axis=1
        )
        size = len(self.F)
        z = np.exp(s * self.table.period)
        states = np.linalg.solve(z[:, None, None] * np.eye(size) - self.F, drive[..., None])[..., 0]
        gain: ComplexArray = states[:, : len(self.table.G)] @ self.table.C[2]
        return gain


class OutputFeedback:
    """A `LinearLaw` as a `Controller`.

    Parameters
    ----------
    scenario
        Whose observation it reads and whose current limit it keeps.
    law
        From signals to current.
    needs
        Table signals that it cannot do without.
    """

    def __init__(self, scenario: Scenario, law: LinearLaw, needs: tuple[str, ...]) -> None:
        self.law = law
        self.reader = SignalReader(scenario, needs)
        self.limit = scenario.current_limit  # [A]

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the action (..., 1) for an observation (..., n), and the memory."""
        law, own = self.law, self.reader.memory_size
        memory = recall(state, episode_start, observation.shape[:-1], own + len(self.law.C))
        signals, read = self.reader.read(observation, memory[..., :own])
        xi = memory[..., own:]
        current = xi @ law.C + signals @ law.D
        excess = np.clip(current, -self.limit, self.limit) - current
        xi = xi @ law.A.T + signals @ law.B.T + excess[..., None] * law.W
        return as_action(current, self.limit), (np.concatenate([read, xi], axis=-1),)
