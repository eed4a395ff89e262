"""What the ground of a control period is, and the maps that it is computed with.

A row holds the filter state, the reference specimen, the target and the reference's base shear after
each physics step, and, in the printed equations, what the target does to the table itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics.linear import as_like
from shake_env.dynamics.yielding_reference import YieldingReference
from shake_env.model.discretization import DiscretePlant
from shake_env.model.nonlinearity import Yielding
from shake_env.model.parameters import FloatArray, GroundFilter
from shake_env.model.plant import submatrix
from shake_env.motion.targets import TargetHistory

Array = Any  # a numpy array or a torch tensor
IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class GroundPeriod:
    """The ground over one control period of k physics steps."""

    ground: Array  # (..., 2 or 4) filter state x_W at the period's end, SI
    reference: Array  # (..., 2 stories) reference specimen x~_S at the period's end, SI
    target: Array  # (..., k) target acceleration y~ after each physics step [m/s^2]
    reference_shear: Array  # (..., k) reference base shear f~_s after each physics step [N]
    drive: Array | None  # (..., 4 + 2 stories + 2 k) or None, see TableDynamics.control_step
    preview: Array | None = None  # (..., samples) target acceleration to come [m/s^2], or None

    def to(self, array: Array) -> GroundPeriod:
        """Return this period in the library, precision and device of `array`."""
        drive = None if self.drive is None else as_like(self.drive, array)
        preview = None if self.preview is None else as_like(self.preview, array)
        return GroundPeriod(
            as_like(self.ground, array),
            as_like(self.reference, array),
            as_like(self.target, array),
            as_like(self.reference_shear, array),
            drive,
            preview,
        )


@dataclass(frozen=True)
class GroundRowLayout:
    """Width of each part of a row, in order."""

    ground: int
    reference: int
    substeps: int
    drive: int

    @property
    def width(self) -> int:
        """Length of a row."""
        return self.ground + self.reference + 2 * self.substeps + self.drive

    @property
    def target(self) -> slice:
        """Where the target lies."""
        return slice(self.ground + self.reference, self.ground + self.reference + self.substeps)

    def period(self, row: FloatArray, preview: FloatArray | None = None) -> GroundPeriod:
        """Return the parts of rows (..., width), views, with the preview (..., samples)."""
        target = self.ground + self.reference
        shear, drive = target + self.substeps, target + 2 * self.substeps
        return GroundPeriod(
            row[..., : self.ground],
            row[..., self.ground : target],
            row[..., target:shear],
            row[..., shear:drive],
            row[..., drive:] if self.drive else None,
            preview,
        )

    @classmethod
    def from_plant(cls, discrete: DiscretePlant) -> GroundRowLayout:
        """Return the widths for a plant."""
        layout, k = discrete.layout, discrete.substeps
        # In the corrected equations the target reaches the table through the current only.
        felt = discrete.plant.equations.specimen_feels_target
        drive = 4 + 2 * layout.stories + 2 * k if felt else 0
        return cls(layout.filter_states, 2 * layout.stories, k, drive)


def _noise_map(discrete: DiscretePlant) -> FloatArray:
    """Return the map ``[x_W, x~_S, draws] -> row`` of one control period."""
    layout, lifted = discrete.layout, discrete.lifted
    exogenous = np.r_[layout.ground, layout.reference]
    columns = np.r_[exogenous, layout.order + 1 : lifted.state.shape[-1]]
    blocks = [
        submatrix(lifted.state, exogenous, columns),
        lifted.outputs[..., 2, columns],
        lifted.outputs[..., 3, columns],
    ]
    if discrete.plant.equations.specimen_feels_target:
        blocks += [
            submatrix(lifted.state, np.r_[layout.controlled], columns),
            lifted.outputs[..., 0, columns],
            lifted.outputs[..., 1, columns],
        ]
    return np.concatenate(blocks, axis=-2)


def filter_state(ground: GroundFilter, history: TargetHistory, dt: float) -> FloatArray:
    """Return the ground filter's state (samples, 2 or 4) that a recorded target would have come from.

    ``x_w' = y~ / (2 zeta_g omega_g)`` and x_w its integral; with the high-pass, y~ first becomes the
    high-pass's input, whose states are the ground's displacement and velocity.
    """
    gain = 2.0 * ground.damping_ratio * ground.omega
    if ground.highpass_frequency is None:
        return np.stack([history.velocity, history.acceleration], axis=-1) / gain
    omega_h = 2.0 * math.pi * ground.highpass_frequency
    friction = 2.0 * ground.highpass_damping_ratio * omega_h
    x, v, a = history.displacement, history.velocity, history.acceleration
    source = a + friction * v + omega_h**2 * x
    # The integral of the source is known from v and x but for the integral of x, whose own drift is
    # what the high-pass removes.
    integral = v + friction * x + omega_h**2 * _running_integral(x, dt)
    return np.stack([integral / gain, source / gain, x, v], axis=-1)


def _running_integral(values: FloatArray, step: float) -> FloatArray:
    summed = np.cumsum(values) * step
    line = np.linspace(0.0, 1.0, len(values))
    return summed - np.polyval(np.polyfit(line, summed, 1), line)


def _record_map(discrete: DiscretePlant) -> FloatArray:
    """Return the map ``[x~_S, k + 1 target samples] -> [x~_S, shear, drive]`` of one control period."""
    layout, lifted, w = discrete.layout, discrete.lifted_record, discrete.layout.filter_states
    n = layout.order - w
    reference = np.r_[layout.reference] - w
    columns = np.r_[reference, n + 1 : lifted.state.shape[-1]]
    blocks = [submatrix(lifted.state, reference, columns), lifted.outputs[..., 2, columns]]
    if discrete.plant.equations.specimen_feels_target:
        controlled = np.r_[layout.controlled] - w
        blocks += [
            submatrix(lifted.state, controlled, columns),
            lifted.outputs[..., 0, columns],
            lifted.outputs[..., 1, columns],
        ]
    return np.concatenate(blocks, axis=-2)


@dataclass(frozen=True)
class GroundMaps:
    """What the ground of a plant is computed with; common to the batch, or stacked, one a lane."""

    noise: FloatArray  # (..., rows, columns) see _noise_map
    record: FloatArray  # (..., rows, columns) see _record_map
    yielding: YieldingReference | None

    @classmethod
    def from_plant(cls, discrete: DiscretePlant, yielding: Yielding) -> GroundMaps:
        """Return the maps of one plant, or of a stack."""
        reference = (
            YieldingReference.from_plant(discrete.plant, yielding, discrete.dt)
            if yielding.active
            else None
        )
        return cls(_noise_map(discrete), _record_map(discrete), reference)

    def pick(self, lanes: IntArray) -> GroundMaps:
        """Return the maps of some lanes."""
        if self.noise.ndim == 2:
            return self
        reference = None if self.yielding is None else self.yielding.pick(lanes)
        return GroundMaps(self.noise[lanes], self.record[lanes], reference)
