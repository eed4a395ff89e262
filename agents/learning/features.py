"""What a network sees of the observation: the states that matter, bounded."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from scipy.linalg import block_diag
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from baselines.estimation.estimator_model import DISTURBANCES
from baselines.lqr.design_states import observable_states
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, REFERENCE_CURRENT, SPOOL_POSITION, TABLE_VELOCITY
from shake_env.motion.targets import FilteredNoise
from shake_env.scenario.scenario import Scenario


def feature_matrix(scenario: Scenario, believed: bool = False) -> FloatArray:
    """Return the fixed linear map (features, n) from observation to network input.

    An invertible map of what can be observed, but for the later part of a fine preview, into coordinates
    in which what a controller has to act on is not a small difference of large numbers. Each is divided
    by the size of what it is (`ERROR_SHARE`, `FLOW_SHARE`, the motion's amplitude), so that it is of the
    order of 1.

    Full state
        The position, where it feeds nothing and has no limit, is left out; the load pressure becomes the
        acceleration error y_A - y~, the spool position the flow that goes into compressing the oil,
        ``x_v - A_p v_a / K_q``, and the specimen's states their difference from the reference's.
    Measured signals
        Table acceleration, velocity and displacement become their errors from the target's, as far as
        the ground filter's state holds them, and the spool position the flow as above.
    Friction
        The table's velocity once more, so steep that its clip has the shape of the friction force.
    Preview
        Samples closer than a control period: those of the first `FINE` periods stay, the later ones
        become their mean over each period. A tenth of a second at 1 ms is then 28 numbers for 100; of
        preview LQR on the laboratory's table without its nonlinear parts this costs 0.3 %, samples 5 ms
        apart cost 68 %. Each becomes its difference from the one before it; the first, from the target
        now.
    Belief
        Where an estimator's beliefs follow the observation (`believed`; see `EstimatedLaw`), its full
        state is taken as the full state is, the disturbances and the law's action by their sizes.
    """
    if believed:
        both: FloatArray = block_diag(feature_matrix(scenario), _believed(scenario))
        return both
    shown = scenario.observation
    matrix = np.eye(shown.size)
    columns = np.arange(shown.size)
    if scenario.sensing.full_state:
        states = scenario.plant.layout.order
        matrix[:states, :states] = full_state_matrix(scenario)
        columns = np.concatenate([observable_states(scenario.plant), columns[states:]])
        if scenario.limits.table_displacement is not None:
            columns = np.arange(shown.size)  # what breaks a limit matters
    else:
        _measured(scenario, matrix)
    if shown.preview_samples:
        ahead = np.arange(shown.preview.start, shown.preview.stop)
        rows = _preview(scenario)
        matrix[ahead[: len(rows)]] = rows
        columns = np.setdiff1d(columns, ahead[len(rows) :])
    signals = np.delete(np.arange(shown.size), np.arange(shown.last_action.start, shown.size))
    motion = scenario.motion
    if isinstance(motion, FilteredNoise) and motion.amplitude > 0.0:
        matrix[signals] /= motion.amplitude
    matrix = matrix[columns]
    steep = _steep_velocity(scenario)
    return matrix if steep is None else np.vstack([matrix, steep])


def feature_sizes(scenario: Scenario, believed: bool = False) -> FloatArray:
    """Return what each clipped feature (features,) of :func:`feature_matrix` is multiplied by."""
    steep = scenario.nonlinearity.friction.active
    sizes = np.ones(len(feature_matrix(scenario)))
    if _steep_velocity(scenario) is not None:
        sizes[-1] = 1.0 / CLIP
    if believed:
        more = np.ones(len(_believed(scenario)))
        more[len(more) - steep :] = 1.0 / CLIP
        sizes = np.concatenate([sizes, more])
    return sizes


def _believed(scenario: Scenario) -> FloatArray:
    """Return the map (features, e) from what an `EstimatedLaw` shows."""
    layout, motion, friction = scenario.plant.layout, scenario.motion, scenario.nonlinearity.friction
    matrix: FloatArray = block_diag(full_state_matrix(scenario), np.eye(DISTURBANCES) / ERROR_SHARE, 1.0)
    matrix[-1] *= scenario.current_limit / REFERENCE_CURRENT
    if isinstance(motion, FilteredNoise) and motion.amplitude > 0.0:
        matrix /= motion.amplitude
    if not friction.active:
        return matrix
    row = np.zeros(matrix.shape[1])
    place = layout.table_velocity
    row[place] = CLIP * scenario.plant.state_scale[place] / (2.0 * friction.smoothing_velocity)
    return np.vstack([matrix, row])


def _planned(scenario: Scenario, entries: int) -> FloatArray:
    """Return the factors (e,) on what a `PlanLaw` shows: a third each currents and two signals."""
    motion = scenario.motion
    current = scenario.current_limit / REFERENCE_CURRENT
    factors = np.repeat([current, 1.0, 1.0], entries // 3)
    if isinstance(motion, FilteredNoise) and motion.amplitude > 0.0:
        factors /= motion.amplitude
    return factors


def _steep_velocity(scenario: Scenario) -> FloatArray | None:
    """Return a row that reaches the clip at twice friction's smoothing velocity; None without friction.

    Clipped, it has the shape of the friction force. A network would have to make that from a velocity a
    hundred times as large, by weights a hundred times as large.
    """
    shown, friction = scenario.observation, scenario.nonlinearity.friction
    row = np.zeros(shown.size)
    if scenario.sensing.full_state:
        place = scenario.plant.layout.table_velocity
        scale = float(scenario.plant.state_scale[place])
    elif "table_velocity" in shown.reading_names:
        reading = shown.reading_names.index("table_velocity")
        place, scale = shown.readings.start + reading, float(shown.reading_scale[reading])
    else:
        return None
    row[place] = CLIP * scale / (2.0 * friction.smoothing_velocity)
    return row if friction.active else None


def preview_means(scenario: Scenario) -> FloatArray:
    """Return the map (r, p) from a preview's samples to those that stay and the means of the others."""
    shown, substeps = scenario.observation, scenario.substeps
    p, block = shown.preview_samples, max(substeps // shown.preview_spacing, 1)
    if block == 1 or substeps % shown.preview_spacing:
        return np.eye(p)
    starts = [*range(min(FINE * block, p)), *range(FINE * block, p, block)]
    ends = [*starts[1:], p]
    means = np.zeros((len(starts), p))
    for row, start, end in zip(means, starts, ends, strict=True):
        row[start:end] = 1.0 / (end - start)
    return means


def _preview(scenario: Scenario) -> FloatArray:
    """Return the preview's rows (r, n): changes of the target over the size of such a change."""
    shown = scenario.observation
    means = preview_means(scenario)
    time = means @ (scenario.physics_step * shown.preview_spacing * np.arange(1, means.shape[1] + 1))
    rows = np.zeros((len(means), shown.size))
    rows[:, shown.preview] = np.diff(means, axis=0, prepend=0.0)
    rms = np.sqrt(scenario.plant.target_variance)
    rows[0, : shown.head] -= _target(scenario)[: shown.head] / rms
    size = PREVIEW_SHARE * np.sqrt(np.diff(time, prepend=0.0) / PREVIEW_SPACING)
    return rows / size[:, None]


def _target(scenario: Scenario) -> FloatArray:
    """Return the target acceleration now (order,) [m/s^2] as a row over the scaled state."""
    plant = scenario.plant
    row: FloatArray = plant.coupled.C[2] * plant.state_scale
    return row


def full_state_matrix(scenario: Scenario) -> FloatArray:
    """Return the map (order, order) from a scaled full state to errors of the order of the amplitude."""
    plant, layout, scale = scenario.plant, scenario.plant.layout, scenario.plant.state_scale
    pressure, spool = layout.actuator.start + LOAD_PRESSURE, layout.actuator.start + SPOOL_POSITION
    velocity = layout.actuator.start + TABLE_VELOCITY
    matrix = np.eye(layout.order)
    error = (plant.coupled.C[0] - plant.coupled.C[2]) * scale
    matrix[pressure] = error / (ERROR_SHARE * np.sqrt(plant.target_variance))
    matrix[spool, spool] = 1.0 / FLOW_SHARE
    matrix[spool, velocity] = -_flow_of_velocity(scenario) / FLOW_SHARE
    matrix[layout.specimen, layout.specimen] /= ERROR_SHARE
    matrix[layout.specimen, layout.reference] = -np.eye(2 * layout.stories) / ERROR_SHARE
    return matrix


def _measured(scenario: Scenario, matrix: FloatArray) -> None:
    shown, plant = scenario.observation, scenario.plant
    at = {name: shown.readings.start + i for i, name in enumerate(shown.reading_names)}
    sizes = dict(zip(shown.reading_names, shown.reading_scale, strict=True))
    scale = plant.state_scale[: shown.head]
    ground = scenario.ground
    # Rows of the target's acceleration, velocity and displacement over the ground filter's scaled state.
    # With the high-pass its last two states are the ground's motion; without, x_w is its velocity.
    rows = {"table_acceleration": _target(scenario)[: shown.head]}
    if ground.highpass_frequency is None:
        rows["table_velocity"] = np.array([2.0 * ground.damping_ratio * ground.omega, 0.0]) * scale
    else:
        rows["table_displacement"] = np.array([0.0, 0.0, 1.0, 0.0]) * scale
        rows["table_velocity"] = np.array([0.0, 0.0, 0.0, 1.0]) * scale
    if "spool_position" in at:
        spool = at["spool_position"]
        if "table_velocity" in at:
            matrix[spool, at["table_velocity"]] = -_flow_of_velocity(scenario)
        matrix[spool] /= FLOW_SHARE
    for name, row in rows.items():
        if name in at:
            matrix[at[name], : shown.head] -= row / sizes[name]
            matrix[at[name]] /= ERROR_SHARE


def _flow_of_velocity(scenario: Scenario) -> float:
    """Return the scaled spool position whose flow a scaled table velocity of 1 uses."""
    scale = scenario.plant.state_scale[scenario.plant.layout.actuator]
    actuator = scenario.actuator
    flow = actuator.piston_area / actuator.flow_gain * scale[TABLE_VELOCITY] / scale[SPOOL_POSITION]
    return float(flow)


CLIP = 20.0  # far outside what a working controller meets
ERROR_SHARE = 0.3  # errors of a table under control are of the order of 10 to 40 % of the target
# Of its rms, the target changes by this over 5 ms. Its slope is white noise: over other times, the root.
PREVIEW_SHARE, PREVIEW_SPACING = 0.4, 5e-3  # [-], [s]
FINE = 2  # control periods to come of which every previewed sample is an input
FLOW_SHARE = 0.03  # the oil is stiff: of the flow through the valve a few percent compress it


class FeatureMap:
    """From observations to what `LinearFeatures` makes of them, in numpy.

    Parameters
    ----------
    scenario
        What is observed.
    believed
        Whether an estimator's beliefs follow the observation, as in :func:`feature_matrix`.
    planned
        Entries of a plan that follow the observation (`agents.policies.plan_law.PlanLaw.shown`).
    """

    def __init__(self, scenario: Scenario, believed: bool = False, planned: int = 0) -> None:
        matrix, sizes = feature_matrix(scenario, believed), feature_sizes(scenario, believed)
        if planned:
            matrix = block_diag(matrix, np.diag(_planned(scenario, planned)))
            sizes = np.concatenate([sizes, np.ones(planned)])
        self._matrix, self._sizes = matrix.astype(np.float32), sizes.astype(np.float32)
        bound = CLIP * self._sizes
        self.space = spaces.Box(-bound, bound, dtype=np.float32)

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the features (..., features) of observations (..., n)."""
        features: NDArray[np.float32] = np.clip(observation @ self._matrix.T, -CLIP, CLIP) * self._sizes
        return features


class LinearFeatures(BaseFeaturesExtractor):
    """A fixed linear map of the observation, clipped to ``+-clip``.

    Entries behind those that it reads, which only a critic sees (`agents.learning.asymmetric`), are left
    out.

    Parameters
    ----------
    observation_space
        The environment's.
    matrix
        (features, n) what :func:`feature_matrix` returned.
    clip
        Bound of a feature.
    sizes
        (features,) what :func:`feature_sizes` returned; None: ones.
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        matrix: list[list[float]],
        clip: float = CLIP,
        sizes: list[float] | None = None,
    ) -> None:
        rows: NDArray[np.float32] = np.asarray(matrix, dtype=np.float32)
        super().__init__(observation_space, features_dim=len(rows))
        self.clip = clip
        self.matrix: torch.Tensor
        self.register_buffer("matrix", torch.from_numpy(rows))
        self.sizes: torch.Tensor
        ones = np.ones(len(rows), dtype=np.float32)
        given = ones if sizes is None else np.asarray(sizes, dtype=np.float32)
        self.scaled = bool(np.any(given != 1.0))
        # Not persistent, so that policies of before there were sizes still load.
        self.register_buffer("sizes", torch.from_numpy(given), persistent=False)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (batch, features)."""
        own = observations[..., : self.matrix.shape[1]]
        features = torch.clamp(own @ self.matrix.T, -self.clip, self.clip)
        return features * self.sizes if self.scaled else features
