"""What measured signals say of the target and the reference specimen, now and when a command will act.

The filter state x_W is shown at every control instant, the response of the reference specimen is not.
Between two instants x_W is Markov, so that the exact conditional mean of x~_S is a recursion: what the
noise of the period did to it is regressed on what it did to x_W (a Kalman filter whose observation has
no noise). From there to the instant at which a command acts, the conditional mean given x_W and the
previewed samples is one linear map. All of it is conditional on the noise being Gaussian and white;
for recorded motions, and under an envelope, it is the best interpolation of that model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shake_env.errors import ScenarioError
from shake_env.model.discretization import noise_covariance, zero_order_hold
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import StateSpace
from shake_env.scenario.scenario import Scenario

# How well x_W is taken to fit the filter, over its scale. Noise fits to float32; a recorded motion's x_W
# is integrated and freed of drift. With this, x~_S is known to 0.08 % of its size under noise (without a
# high-pass, where its last trace is not in x_W), and to 0.2 % under most records, 2 % under the longest.
TOLERANCE = 1e-4


@dataclass(frozen=True)
class ReferenceRecursion:
    """x~_S from sampled x_W, ``x~ <- S x~ + W_before x_W,k + W_now x_W,k+1``, in observation units."""

    S: FloatArray  # (2 stories, 2 stories)
    W_before: FloatArray  # (2 stories, w)
    W_now: FloatArray  # (2 stories, w)
    unseen: FloatArray  # (2 stories, 2 stories) of what a period adds to the error, unit intensity

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> ReferenceRecursion:
        """Derive the recursion from the lifted noise model of a period.

        Raises
        ------
        ScenarioError
            If the target drives the specimen directly, as in the printed equations.
        """
        plant, layout, lifted = scenario.plant, scenario.plant.layout, scenario.discrete.lifted
        if plant.equations.specimen_feels_target:
            raise ScenarioError("equations", plant.equations, "needs the corrected equations")
        g, r = np.r_[layout.ground], np.r_[layout.reference]
        scale = plant.state_scale
        A = lifted.state[:, : layout.order] * scale / scale[:, None]
        N = lifted.state[:, layout.order + 1 :] / scale[:, None]
        A_W, N_W, N_S = A[np.ix_(g, g)], N[g], N[r]
        spread = N_W @ N_W.T + TOLERANCE**2 * np.eye(len(g))
        now: FloatArray = np.linalg.solve(spread, N_W @ N_S.T).T.astype(np.float64)
        rest = N_S - now @ N_W
        before: FloatArray = A[np.ix_(r, g)] - now @ A_W
        return cls(A[np.ix_(r, r)], before, now, rest @ rest.T)

    def advance(self, reference: FloatArray, before: FloatArray, now: FloatArray) -> FloatArray:
        """Return x~_S (..., 2 stories) a period on, from x_W (..., w) at its start and end."""
        moved: FloatArray = reference @ self.S.T + before @ self.W_before.T + now @ self.W_now.T
        return moved


def predicted_ground(scenario: Scenario, shown: Scenario) -> tuple[FloatArray, FloatArray]:
    """Return the ground's conditional mean when a command acts, and its covariance.

    Parameters
    ----------
    scenario
        Its loop delay is the time ahead; its preview is what is known.
    shown
        Its preview is what is asked for, counted from the end of the delay.

    Returns
    -------
    map, covariance
        (w + 2 stories + p', w + 2 stories + p) from ``[x_W, x~_S, previewed y~]`` now to the same after
        the delay, in observation units; (w + 2 stories + p', ...) for the unit-intensity noise, without
        what x~_S is wrong by now.
    """
    plant, layout, dt = scenario.plant, scenario.plant.layout, scenario.physics_step
    e = np.r_[layout.ground, layout.reference]
    scale = plant.state_scale[e]
    A = plant.coupled.A[np.ix_(e, e)] * scale / scale[:, None]
    B = plant.coupled.B[e, 1:] / scale[:, None]
    target = plant.coupled.C[2, e] * scale / np.sqrt(plant.target_variance)
    ahead = scenario.delay * dt
    known, wanted = scenario.observation, shown.observation
    times = dt * known.preview_spacing * np.arange(1, known.preview_samples + 1)
    asked = ahead + dt * wanted.preview_spacing * np.arange(1, wanted.preview_samples + 1)
    process = _Process(A, B)
    rows = [(ahead, np.eye(len(e)))] + [(time, target[None]) for time in asked]
    data = [(time, target[None]) for time in times]
    mean, mean_seen = process.means(rows), process.means(data)
    covariance, cross = process.covariance(rows, rows), process.covariance(rows, data)
    given = process.covariance(data, data)
    gain = np.linalg.lstsq(given, cross.T, rcond=1e-12)[0].T if data else cross
    return np.hstack([mean - gain @ mean_seen, gain]), covariance - gain @ cross.T


class _Process:
    """A state from a known start under unit white noise: means and covariances at any times."""

    def __init__(self, A: FloatArray, B: FloatArray) -> None:
        self._A, self._B, self._unit = A, B, np.ones(len(A))
        self._transitions: dict[float, FloatArray] = {}
        self._spreads: dict[float, FloatArray] = {}

    def _transition(self, time: float) -> FloatArray:
        key = round(time, 12)
        if key not in self._transitions:
            n = len(self._A)
            system = StateSpace(self._A, np.zeros((n, 1)), np.zeros((1, n)), np.zeros((1, 1)))
            self._transitions[key] = (
                zero_order_hold(system, key, self._unit).A if key > 0.0 else np.eye(n)
            )
        return self._transitions[key]

    def _spread(self, time: float) -> FloatArray:
        key = round(time, 12)
        if key not in self._spreads:
            zero = np.zeros_like(self._A)
            self._spreads[key] = (
                noise_covariance(self._A, self._B, key, self._unit) if key > 0.0 else zero
            )
        return self._spreads[key]

    def means(self, outputs: list[tuple[float, FloatArray]]) -> FloatArray:
        """Return what the start does to outputs, each a time and rows of the state."""
        empty = np.zeros((0, len(self._A)))
        return np.vstack([empty, *(rows @ self._transition(time) for time, rows in outputs)])

    def covariance(
        self, left: list[tuple[float, FloatArray]], right: list[tuple[float, FloatArray]]
    ) -> FloatArray:
        """Return the covariance of two lists of outputs that the noise makes.

        At times t >= s it is ``C Phi(t - s) P(s) D'``, P(s) the state's covariance at s.
        """
        (t, C), (s, D) = self._listed(left), self._listed(right)
        if not len(t) or not len(s):
            return np.zeros((len(t), len(s)))
        gaps = np.round(np.subtract.outer(t, s), 12)
        lags, place = np.unique(np.abs(gaps), return_inverse=True)
        place = place.reshape(gaps.shape)
        moves = np.stack([self._transition(float(lag)) for lag in lags])
        i, j = np.arange(len(t))[:, None], np.arange(len(s))
        spread_C, spread_D = (
            np.stack([self._spread(float(time)) @ row for time, row in zip(times, rows, strict=True)])
            for times, rows in ((t, C), (s, D))
        )
        moved_C, moved_D = (np.einsum("an,lnm->alm", rows, moves) for rows in (C, D))
        later = np.einsum("abm,bm->ab", moved_C[i, place], spread_D)
        earlier = np.einsum("abm,am->ab", moved_D[j, place], spread_C)
        covariance: FloatArray = np.where(gaps >= 0.0, later, earlier)
        return covariance

    def _listed(self, outputs: list[tuple[float, FloatArray]]) -> tuple[FloatArray, FloatArray]:
        """Return the time of each row (a,) and the rows (a, n)."""
        times = [time for time, rows in outputs for _ in rows]
        return np.array(times), np.vstack([np.zeros((0, len(self._A))), *(rows for _, rows in outputs)])
