"""Inverse-model feed-forward: the current that would make the nominal table move as the target does.

The inverse of the coupled plant is not causal: it needs the target ahead by the loop's delay and the
valve's lag. The stable inverse is a two-sided impulse response (Devasia, Chen and Paden, IEEE TAC 41,
1996; Tomizuka, J. Dyn. Syst. Meas. Control 109, 1987); here its taps, on as much of the future as the
scenario previews, are found at once by least squares on the nominal response. Errors are weighted as the
stage cost weights them under the ground filter's spectrum, which also keeps the current in bounds where
the table responds little.

The taps act on what is really seen: velocities of the past, and velocities to come by trapezoids of
all previewed accelerations. The target is rough (white noise is its slope), so that what lies above the
Nyquist frequency folds into all of these, and not alike. The least squares therefore extends over
several Nyquist bands: without it the taps set signals against each other whose folded parts do not
cancel, and ring the lightly damped oil column.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.servo.output_feedback import ComplexArray, NominalTable
from baselines.servo.signals import (
    ACCELERATION,
    SIGNALS,
    TARGET_ACCELERATION,
    TARGET_VELOCITY,
    Memory,
    SignalReader,
    as_action,
    recall,
)
from baselines.servo.tvc import FEEDBACK, TARGETS, TVCDesign, placed_feedback
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.parameters import FloatArray, require_positive
from shake_env.model.plant import ground_filter, specimen_plant
from shake_env.scenario.scenario import Scenario

FREQUENCIES = 400  # of the least squares, from LOWEST to the Nyquist frequency
BANDS = 4  # multiples of the control rate whose sidebands fold into the first band
LOWEST = 0.05  # [Hz]


@dataclass(frozen=True, kw_only=True)
class InverseDesign:
    """What the inverse is asked for.

    Raises
    ------
    ParameterError
        If the cut-off is not above zero, or there is no past tap.
    """

    cutoff: float = 40.0  # [Hz] the target is low-passed here, without delay; past the oil column
    past: int = 120  # control periods of the target that have been, and are still remembered
    preview: int | None = None  # control periods to come; None: all that the scenario previews
    feedback: TVCDesign | None = None  # poles that a feedback on the errors places; None: no feedback

    def __post_init__(self) -> None:
        require_positive(self, "cutoff")
        for field in ("past", "preview"):
            value, lowest = getattr(self, field), 1 if field == "past" else 0
            if value is not None and not (isinstance(value, int) and value >= lowest):
                raise ParameterError(field, value, f"must be a whole number of at least {lowest}")


@dataclass(frozen=True)
class InverseLaw:
    """Taps of the feed-forward ``u_k = sum_j h_j v~_(k+j) + h_a y~_k`` and the errors' feedback."""

    taps: FloatArray  # (past + 1 + preview,) [A s/m], oldest velocity first
    acceleration_tap: float  # h_a [A s^2/m]
    preview: int  # control periods to come
    samples: int  # of the target that a control period's preview shows
    feedback: FloatArray  # (8,) of the signals
    tracking: ComplexArray  # (frequencies,) y_A / y~ of the nominal table that it leaves
    frequency: FloatArray  # (frequencies,) [Hz]; those of the first band, then the folded ones
    spacing: FloatArray  # (frequencies,) [Hz] that each stands for


def previewed_periods(scenario: Scenario, asked: int | None) -> tuple[int, int]:
    """Return how many coming control periods a controller may use, and the samples a period shows.

    Parameters
    ----------
    scenario
        Whose preview is read.
    asked
        Number of periods; None: all that are previewed.

    Raises
    ------
    ScenarioError
        If fewer are previewed than were asked for, or the control period is no whole number of the
        preview's spacings.
    """
    layout = scenario.observation
    if layout.preview_samples and scenario.substeps % layout.preview_spacing:
        spacing = layout.preview_spacing * scenario.physics_step
        raise ScenarioError(
            "preview_spacing", spacing, f"must divide the control period of {scenario.control_period} s"
        )
    samples = scenario.substeps // layout.preview_spacing
    periods = layout.preview_samples // samples
    if asked is not None and asked > periods:
        raise ScenarioError("preview", asked, f"the scenario shows {periods} periods")
    return (periods if asked is None else asked), samples


def folded_frequencies(rate: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies of a sampling at `rate` and of what folds into them, with their spacing [Hz].

    The sidebands repeat the first band's grid, so that a resonance is resolved wherever it folds to.
    """
    first = np.geomspace(LOWEST, 0.5 * rate, FREQUENCIES)
    sides = [side for m in range(1, BANDS + 1) for side in (m * rate - first, m * rate + first)]
    spacing = np.gradient(first)
    return np.concatenate([first, *sides]), np.tile(spacing, 1 + 2 * BANDS)


def inverse_law(scenario: Scenario, design: InverseDesign) -> InverseLaw:
    """Return the least-squares inverse of a scenario's nominal table, as a feed-forward.

    Raises
    ------
    ScenarioError
        If more preview is asked for than there is.
    NumericalError
        If the feedback's loop is not stable.
    """
    table, period = NominalTable.from_scenario(scenario), scenario.control_period
    preview, samples = previewed_periods(scenario, design.preview)
    frequency, spacing = folded_frequencies(scenario.control_rate)
    omega = 2.0 * math.pi * frequency
    s = 1j * omega
    z = np.exp(s * period)
    feedback = np.zeros(SIGNALS)
    response = table.response(frequency)
    closed = np.ones(len(s), dtype=complex)
    from_target = np.zeros(len(s), dtype=complex)  # current per target acceleration, by the errors
    if design.feedback is not None:
        gains = placed_feedback(table, scenario, design.feedback)
        feedback[FEEDBACK], feedback[TARGETS] = -gains, gains
        closed = 1.0 / (1.0 + response[:, FEEDBACK] @ gains)
        from_target = gains[0] / s**2 + gains[1] / s + gains[2]
    acceleration = response[:, ACCELERATION] * closed
    # Per target acceleration: what the past shows, the velocities to come by trapezoids, itself.
    known = z[:, None] ** np.arange(-design.past, 1)
    sample = period / samples
    shift = np.exp(s * sample)[:, None] ** np.arange(preview * samples)
    steps = 0.5 * sample * (s * (1.0 + np.exp(s * sample)))[:, None] * shift
    future = 1.0 + np.cumsum(steps, axis=1)[:, samples - 1 :: samples]
    basis = np.concatenate([known, future, s[:, None]], axis=1) / s[:, None]
    in_band = frequency <= 0.5 * scenario.control_rate
    wanted = np.where(in_band, 1.0 / (1.0 + (frequency / design.cutoff) ** 8), 0.0)
    # An error of acceleration is G_S times as much of base shear, at the frequency it folds into.
    cost, plant = scenario.stage_cost, scenario.plant
    shear = specimen_plant(plant.specimen).frequency_response(omega[in_band])[:, 0, 0]
    importance = np.sqrt(cost.acceleration + cost.force * np.abs(np.resize(shear, len(s))) ** 2)
    target = np.abs(ground_filter(plant.ground).frequency_response(omega)[:, 0, 0]) * np.sqrt(spacing)
    error, effort = importance * target, math.sqrt(cost.current) * target
    matrix = np.concatenate(
        [(error * acceleration)[:, None] * basis, (effort * closed)[:, None] * basis]
    )
    right = np.concatenate(
        [error * (wanted - acceleration * from_target), -effort * closed * from_target]
    )
    scale = np.linalg.norm(matrix, axis=0)
    stacked = np.concatenate([matrix.real, matrix.imag]) / scale
    solution = np.linalg.lstsq(stacked, np.concatenate([right.real, right.imag]), rcond=1e-10)[0] / scale
    return InverseLaw(
        taps=solution[:-1],
        acceleration_tap=float(solution[-1]),
        preview=preview,
        samples=samples,
        feedback=feedback,
        tracking=acceleration * (basis @ solution + from_target),
        frequency=frequency,
        spacing=spacing,
    )


class InverseFeedForward:
    """The inverse as a `Controller`; its memory is the target's past velocity.

    Parameters
    ----------
    scenario
        Whose observation it reads and whose nominal table it inverts.
    design
        Its taps and feedback; None: the default, without feedback.
    """

    def __init__(self, scenario: Scenario, design: InverseDesign | None = None) -> None:
        self.law = inverse_law(scenario, design or InverseDesign())
        fed_back = bool(self.law.feedback.any())
        needs = ("table_displacement", "table_velocity", "table_acceleration") if fed_back else ()
        self.reader = SignalReader(scenario, needs)
        self.limit = scenario.current_limit  # [A]
        self.sample = scenario.control_period / self.law.samples  # [s]
        first = scenario.observation.preview.start
        self._preview = slice(first, first + self.law.preview * self.law.samples)
        self.preview_scale = math.sqrt(scenario.plant.target_variance)  # [m/s^2]
        self.past = len(self.law.taps) - 1 - self.law.preview  # periods that are remembered

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the action (..., 1) for an observation (..., n), and the memory."""
        own = self.reader.memory_size
        memory = recall(state, episode_start, observation.shape[:-1], own + self.past)
        signals, read = self.reader.read(observation, memory[..., :own])
        now = signals[..., TARGET_VELOCITY : TARGET_VELOCITY + 1]
        acceleration = signals[..., TARGET_ACCELERATION : TARGET_ACCELERATION + 1]
        coming = observation[..., self._preview].astype(np.float64) * self.preview_scale
        before = np.concatenate([acceleration, coming[..., :-1]], axis=-1)[..., : coming.shape[-1]]
        steps = np.cumsum(0.5 * self.sample * (coming + before), axis=-1)
        future = now + steps[..., self.law.samples - 1 :: self.law.samples]
        known = np.concatenate([memory[..., own:], now], axis=-1)
        current = np.concatenate([known, future], axis=-1) @ self.law.taps
        current = (
            current + acceleration[..., 0] * self.law.acceleration_tap + signals @ self.law.feedback
        )
        lines = np.concatenate([read, known[..., 1:]], axis=-1)
        return as_action(current, self.limit), (lines,)
