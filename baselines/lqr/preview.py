"""Preview LQR: exact finite preview, and the lower bound with the whole future known.

The feedback is that of `sampled_lqr`; what preview changes is the expectation of the feed-forward
(`baselines.lqr.tracking_problem`). Given the filter state and p samples of the coming y~, the white
noise of the horizon is Gaussian with a mean linear in them, so that the law is one row over the whole
observation, ``u = -gain @ x + preview_gain @ y~``. Classical preview control (Tomizuka 1975; Louam,
Wilson and Sharp, Vehicle System Dynamics 17, 1988) takes samples at the control instants of a held
reference; here cost, noise and samples are those of the continuous plant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq

from baselines.lqr.discrete_lyapunov import discrete_lyapunov
from baselines.lqr.sampled import StationaryPerformance, action_row
from baselines.lqr.tracking_problem import TrackingProblem
from shake_env.errors import NumericalError, ScenarioError
from shake_env.model.discretization import DiscretePlant
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.scenario.objective import StageCost
from shake_env.scenario.observation import Sensing
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class Forecast:
    """What the previewed samples say about the noise of the coming periods.

    ``y = C_y x_e + N_y d``, y the p previewed samples, d the draws of the `periods` that they lie in.
    """

    C_y: FloatArray  # (p, e) [m/s^2]
    N_y: FloatArray  # (p, periods * draws) [m/s^2]
    periods: int

    @classmethod
    def from_problem(cls, problem: TrackingProblem, steps: int, stride: int) -> Forecast:
        """Relate `steps` samples, at `stride`, 2 `stride` ... physics steps ahead, to the noise."""
        k, draws = problem.discrete.substeps, problem.N.shape[1]
        ahead = stride * np.arange(1, steps + 1) - 1
        periods = -(-stride * steps // k)
        powers = np.empty((periods + 1, *problem.A.shape))
        powers[0] = np.eye(len(problem.A))
        for j in range(periods):
            powers[j + 1] = problem.A @ powers[j]
        C_y, N_y = np.empty((steps, len(problem.A))), np.zeros((steps, periods, draws))
        for row, (period, substep) in enumerate(zip(ahead // k, ahead % k, strict=True)):
            target = problem.C[substep, 0]
            C_y[row] = target @ powers[period]
            # A draw of period l reaches the sample through the state at the end of l.
            N_y[row, :period] = (target @ powers[:period] @ problem.N)[::-1]
            N_y[row, period] = problem.D[substep, 0]
        return cls(C_y, N_y.reshape(steps, periods * draws), periods)

    def expectation(self, rows: FloatArray) -> FloatArray:
        """Return b, (r, p), with ``E[rows @ d | x_e, y] = b (y - C_y x_e)``.

        The least-squares solution of ``N_y' b' = rows'``: Gaussian conditioning without forming the
        covariance ``N_y N_y'``, whose condition would be squared, and whatever its rank.
        """
        if not len(self.C_y):
            return np.zeros((len(rows), 0))
        solution: FloatArray = lstsq(self.N_y.T, rows.T, cond=1e-12)[0].T
        return solution


@dataclass(frozen=True)
class PreviewDesign:
    """A preview law ``u = -gain @ x + preview_gain @ y``: x the full state in SI, y in m/s^2."""

    gain: FloatArray  # (n,) [A per SI unit of each state]
    preview_gain: FloatArray  # (p,) [A s^2/m] on y~ at spacing, 2 spacing ... ahead
    spacing: float  # [s]
    analytic_cost: float  # stationary expected stage cost
    performance: StationaryPerformance


def preview_lqr(
    discrete: DiscretePlant,
    cost: StageCost,
    preview: float,
    spacing: float | None = None,
    position: float | None = None,
) -> PreviewDesign:
    """Design the LQR that sees `preview` seconds of the coming target.

    Parameters
    ----------
    discrete, cost
        Plant at its physics step and control rate, and the stage cost to minimise.
    preview
        [s] ``p = preview / spacing`` samples are seen; 0 gives `sampled_lqr`.
    spacing
        [s] between samples, a whole number of physics steps; None: the physics step.
    position
        [m] error of the table's place that is worth a motionless table's stage cost; None: no error of
        place is worth anything, and the table drifts. The design's cost leaves this term out.

    Notes
    -----
    No causal law does better where `spacing` divides the control period: earlier samples then lie on the
    present grid. With a coarser grid it is the best law that weighs the present observation's exogenous
    part, and earlier samples, which fall between the present ones, would add a little.

    Raises
    ------
    ParameterError
        If the spacing is no whole number of physics steps, or the preview none of spacings.
    ScenarioError
        If the target drives the specimen directly, as in the printed equations.
    NumericalError
        If an equation fails its check, or the cost of the law differs from that of its parts.
    """
    shown = Sensing(preview=preview, preview_spacing=spacing)
    samples, stride = shown.preview_steps(discrete.dt)
    problem = TrackingProblem.from_plant(discrete, cost, position)
    forecast = Forecast.from_problem(problem, samples, stride)
    rows = problem.future_rows(forecast.periods)
    b = forecast.expectation(rows.reshape(1, -1))
    # Row j: what the law of j periods earlier knows of v through a period's draws.
    known_rows = (b @ forecast.N_y).reshape(rows.shape)
    performance = _performance(problem, problem.L, known_rows)
    analytic = performance.cost
    if position is None:  # what completing the square says contains the position's term, too
        analytic = _floor(problem) + problem.R_u * (problem.unseen - float(np.sum(known_rows**2)))
        _agree(problem, performance.cost, analytic)
    row = problem.row(problem.L - b @ forecast.C_y)
    gain = -row * REFERENCE_CURRENT / discrete.plant.state_scale
    return PreviewDesign(gain, b[0] * REFERENCE_CURRENT, stride * discrete.dt, analytic, performance)


def infinite_preview(discrete: DiscretePlant, cost: StageCost) -> StationaryPerformance:
    """Return what the best law that knows the whole future reaches: the floor of every preview.

    Raises
    ------
    NumericalError
        If the cost differs from that found by completing the square.
    """
    problem = TrackingProblem.from_plant(discrete, cost)
    floor = _floor(problem)
    performance = _performance(problem, problem.L, None)
    _agree(problem, performance.cost, floor)
    return performance


def check_preview(scenario: Scenario, samples: int, spacing: float) -> None:
    """Raise ScenarioError unless the scenario shows `samples` of y~ at `spacing` [s]."""
    shown = scenario.observation
    step = shown.preview_spacing * scenario.physics_step
    if shown.preview_samples != samples or (samples and abs(step - spacing) > 1e-9 * spacing):
        raise ScenarioError(
            "sensing",
            (shown.preview_samples, step),
            f"must show {samples} samples of the coming target, {spacing:.6g} s apart",
        )


def _agree(problem: TrackingProblem, simulated: float, analytic: float) -> None:
    # The analytic cost is a small difference of numbers of the motionless table's size.
    size = problem.cost.motionless(problem.discrete.plant)
    if not abs(simulated - analytic) <= 1e-6 * analytic + 1e-10 * size:
        raise NumericalError("cost", analytic, f"differs from the closed loop's {simulated!r}")


def _floor(problem: TrackingProblem) -> float:
    """Return the cost that no current changes: ``E[r'r] - R_u E[v^2]``, r weighed."""
    cost, k = problem.cost, problem.discrete.substeps
    weights = np.array([cost.acceleration, cost.force]) / k
    stationary = discrete_lyapunov(problem.A, problem.N @ problem.N.T, problem.A.T)
    reference = np.einsum("o,koi,ij,koj->", weights, problem.C, stationary, problem.C)
    reference += np.einsum("o,kod->", weights, problem.D**2)
    known = float(problem.L[0] @ stationary @ problem.L[0])
    return float(reference) - problem.R_u * (known + problem.unseen)


def _performance(
    problem: TrackingProblem, on_state: FloatArray, on_draws: FloatArray | None
) -> StationaryPerformance:
    """Return the stationary performance of ``u = -K x_c + on_state x_e + sum_j on_draws_j d_i+j``.

    By the response to one draw, summed over time: before its period through `on_draws` (None: all of v's
    future), in it, and after it, where state feedback is all that is left.
    """
    q, m = problem, len(problem.F)
    draws = q.N.shape[1]
    errors = np.concatenate([q.Z_x, -q.C], axis=2)  # over [x_c, x_e]
    energy = np.zeros(3)  # acceleration, force, current; each summed over physics steps
    if on_draws is None:
        # With the whole future x_c at j periods before the draw is Y closed'^j Gamma.
        Y = discrete_lyapunov(q.closed, q.G @ q.G.T, q.closed.T) / q.R_u
        current = q.G.T / q.R_u - q.K @ Y @ q.closed.T
        before = q.Z_x @ (Y @ q.closed.T) + q.Z_u @ current
        spread = discrete_lyapunov(q.closed.T, q.Gamma @ q.Gamma.T, q.closed)
        energy += _energies(before, current, spread)
        x_c, now = Y @ q.Gamma, q.M_0
    else:
        x_c, now = np.zeros((m, draws)), np.zeros((1, draws))
        for j in range(len(on_draws) - 1, -1, -1):
            now = on_draws[j : j + 1]
            if j == 0:
                break
            u = now - q.K @ x_c
            energy[:2] += np.sum((q.Z_x @ x_c + q.Z_u @ u) ** 2, axis=(0, 2))
            energy[2] += np.sum(u**2)
            x_c = q.F @ x_c + q.G @ u
    u = now - q.K @ x_c
    energy[:2] += np.sum((q.Z_x @ x_c + q.Z_u @ u - q.D) ** 2, axis=(0, 2))
    energy[2] += np.sum(u**2)
    start = np.vstack([q.F @ x_c + q.G @ u, q.N])
    loop = np.block([[q.closed, q.G @ on_state], [np.zeros((len(q.A), m)), q.A]])
    row = np.hstack([-q.K, on_state])
    spread = discrete_lyapunov(loop, start @ start.T, loop.T)
    energy += _energies(errors + q.Z_u @ row, row, spread)
    acceleration, shear = energy[:2] / q.discrete.substeps
    current_square = float(energy[2]) * REFERENCE_CURRENT**2
    return StationaryPerformance.from_mean_squares(
        q.discrete.plant, q.cost, acceleration, shear, current_square
    )


def _energies(errors: FloatArray, current: FloatArray, spread: FloatArray) -> FloatArray:
    """Return (3,): squares of both errors, summed over physics steps, and of the current."""
    return np.append(
        np.einsum("koi,ij,koj->o", errors, spread, errors), current[0] @ spread @ current[0]
    )


def with_preview(scenario: Scenario, gain: FloatArray, position: float | None = None) -> PreviewFeedback:
    """Return ``u = -gain @ x`` with what the previewed samples add to the nominal LQR's command.

    A gain that was designed without preview takes the target's future for its expectation; what the
    samples say beyond that enters as in `preview_lqr`, whose own feedback it comes to.

    Parameters
    ----------
    scenario
        Whose observation is read.
    gain
        (n,) [A per SI unit of each state].
    position
        [m] as the gain's design weighs it.
    """
    discrete, cost, sensing = scenario.discrete, scenario.stage_cost, scenario.sensing
    blind = preview_lqr(discrete, cost, 0.0, position=position)
    seeing = preview_lqr(discrete, cost, sensing.preview, sensing.preview_spacing, position)
    return PreviewFeedback(scenario, replace(seeing, gain=gain + seeing.gain - blind.gain))


class PreviewFeedback:
    """A preview law as a `Controller`.

    Parameters
    ----------
    scenario
        Whose observation it reads: the full state and the previewed samples. What follows is not read.
    design
        The law; None: `preview_lqr` for the scenario's own objective and preview.
    position
        [m] of that design, where none is given.

    Raises
    ------
    ScenarioError
        If the scenario does not show the full state, or another preview than the law's.
    """

    def __init__(
        self,
        scenario: Scenario,
        design: PreviewDesign | None = None,
        position: float | None = None,
    ) -> None:
        sensing = scenario.sensing
        if design is None:
            design = preview_lqr(
                scenario.discrete,
                scenario.stage_cost,
                sensing.preview,
                sensing.preview_spacing,
                position,
            )
        check_preview(scenario, len(design.preview_gain), design.spacing)
        self.row = action_row(scenario, design.gain)  # (size,) action per entry of the observation
        size = np.sqrt(scenario.plant.target_variance) / scenario.current_limit
        self.row[scenario.observation.preview] = design.preview_gain * size

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., size), within [-1, 1]."""
        action = np.clip(observation @ self.row, -1.0, 1.0)
        return action[..., None].astype(np.float32), None
