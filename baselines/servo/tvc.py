"""Three-variable control: displacement, velocity and acceleration, each fed back and fed forward.

``u = -(k_d x_a + k_v v_a + k_a y_A) + f_d x~ + f_v v~ + f_a y~``, the law of commercial seismic
controllers (Tagawa and Kajiwara, J. Syst. Control Eng. 221, 2007; Stehman and Nakata, Smart Struct.
Syst. 12, 2013). Its feedback places three poles of the nominal table, those of the position loop
and of the oil column; its feed-forward is what makes the acceleration response flat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from baselines.servo.output_feedback import LinearLaw, NominalTable, OutputFeedback, SampledClosedLoop
from baselines.servo.signals import (
    ACCELERATION,
    DISPLACEMENT,
    SIGNALS,
    TARGET_ACCELERATION,
    TARGET_DISPLACEMENT,
    TARGET_VELOCITY,
    VELOCITY,
)
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import FloatArray, require_positive
from shake_env.scenario.scenario import Scenario

FEEDBACK = [DISPLACEMENT, VELOCITY, ACCELERATION]
TARGETS = [TARGET_DISPLACEMENT, TARGET_VELOCITY, TARGET_ACCELERATION]
BAND_POINTS = 200  # of the band's frequencies, evenly spaced on a logarithmic axis


@dataclass(frozen=True, kw_only=True)
class TVCDesign:
    """What three-variable control is asked for.

    The defaults are a position loop of 1 Hz, fast enough to hold the table in its stroke and below the
    band of most of the target, and a well damped oil column. Less damping (0.06) makes the response
    flatter, within 1.2 dB to 5 Hz, and lets what lies above the band through many times as loud, sensor
    noise and friction with it. A damping of 0.3 is quieter still under the laboratory's delay, and has
    no stable loop without delay.

    Raises
    ------
    ParameterError
        If a value is not above zero, or the band not in order.
    """

    position_bandwidth: float = 1.0  # [Hz] of the real pole
    oil_damping: float = 0.2  # [-] damping ratio of the oil column's placed pair
    lowest: float = 0.3  # [Hz] of the band that is made flat
    highest: float = 10.0  # [Hz]

    def __post_init__(self) -> None:
        require_positive(self, "position_bandwidth", "oil_damping", "lowest", "highest")
        if not self.lowest < self.highest:
            raise ParameterError("lowest, highest", (self.lowest, self.highest), "must be in order")
        if not self.oil_damping < 1.0:
            raise ParameterError("oil_damping", self.oil_damping, "must be below 1")

    @property
    def band(self) -> FloatArray:
        """Frequencies of the band [Hz], (points,)."""
        return np.geomspace(self.lowest, self.highest, BAND_POINTS)


def feedback_gains(table: NominalTable, poles: FloatArray) -> FloatArray:
    """Return TVC's k (3,) of displacement, velocity and acceleration that give three poles.

    A pole p of the loop has ``1 + k' g(p) = 0`` with g the table's response to the current: linear in k.
    The other poles go where they go.

    Parameters
    ----------
    table
        What is controlled.
    poles
        (3,) complex, in the z plane, closed under conjugation.

    Raises
    ------
    NumericalError
        If a pole is the table's own, or the three conditions are no three.
    """
    m = len(table.G)
    rows = []
    for pole in poles:
        response = table.C[FEEDBACK] @ np.linalg.solve(pole * np.eye(m) - table.F, table.G + 0j)
        rows.append(response)
    matrix = np.array(rows)
    scale = np.abs(matrix).max(axis=0)
    if not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix / scale, tol=1e-9) < 3:
        raise NumericalError("poles", poles, "the three conditions are not independent")
    gains: FloatArray = (np.linalg.solve(matrix / scale, -np.ones(3)) / scale).real
    return gains


def feed_forward_gains(table: NominalTable, feedback: FloatArray, band: FloatArray) -> FloatArray:
    """Return TVC's weights (3,) of the target's x~, v~, y~ that make the loop's response flattest.

    Least squares of ``|y_A / y~ - 1|`` over the band: the response is linear in the weights.
    """
    D = np.zeros(SIGNALS)
    D[FEEDBACK] = -feedback
    columns = []
    for target in TARGETS:
        one = D.copy()
        one[target] = 1.0
        columns.append(SampledClosedLoop(table, LinearLaw.static(one)).response(band))
    matrix = np.stack(columns, axis=1)
    stacked = np.concatenate([matrix.real, matrix.imag])
    wanted = np.concatenate([np.ones(len(band)), np.zeros(len(band))])
    scale = np.linalg.norm(stacked, axis=0)
    solution: FloatArray = np.linalg.lstsq(stacked / scale, wanted, rcond=None)[0] / scale
    return solution


def placed_feedback(table: NominalTable, scenario: Scenario, design: TVCDesign) -> FloatArray:
    """Return TVC's feedback gains (3,) of a design on a scenario's nominal table.

    Raises
    ------
    NumericalError
        If the loop with the placed poles is not stable.
    """
    oil = 2.0 * math.pi * scenario.plant.oil_column_frequency
    zeta = design.oil_damping
    pair = oil * complex(-zeta, math.sqrt(1.0 - zeta**2))
    s = np.array([-2.0 * math.pi * design.position_bandwidth, pair, pair.conjugate()])
    feedback = feedback_gains(table, np.exp(s * table.period))
    D = np.zeros(SIGNALS)
    D[FEEDBACK] = -feedback
    radius = SampledClosedLoop(table, LinearLaw.static(D)).radius
    if not radius < 1.0:
        raise NumericalError("spectral radius", radius, "ask for less bandwidth or oil damping")
    return feedback


def tvc_law(scenario: Scenario, design: TVCDesign) -> LinearLaw:
    """Return three-variable control of a scenario's nominal table."""
    table = NominalTable.from_scenario(scenario)
    feedback = placed_feedback(table, scenario, design)
    D = np.zeros(SIGNALS)
    D[FEEDBACK] = -feedback
    D[TARGETS] = feed_forward_gains(table, feedback, design.band)
    return LinearLaw.static(D)


def tvc(scenario: Scenario, design: TVCDesign | None = None) -> OutputFeedback:
    """Return three-variable control of a scenario's nominal table, ready to drive it."""
    law = tvc_law(scenario, design or TVCDesign())
    return OutputFeedback(scenario, law, ("table_displacement", "table_velocity", "table_acceleration"))
