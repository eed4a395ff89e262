"""Models and laws as python-control objects, in and out.

Inputs and outputs are SI, and every signal has a name. States go out in units of
``CoupledPlant.state_scale``: in SI they span ten decades (Pa beside m of spool), and python-control's
frequency response, through Slycot, then loses every digit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray

from baselines.servo.signals import as_action, recall
from shake_env.errors import ParameterError, ScenarioError, unknown
from shake_env.model.discretization import DiscretePlant, DiscreteStateSpace
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import CoupledPlant, StateSpace
from shake_env.scenario.scenario import Scenario

CURRENT, WHITE_NOISE = "current", "white_noise"
OUTPUTS = ("table_acceleration", "base_shear", "target_acceleration", "reference_base_shear")


def to_control(plant: CoupledPlant | DiscretePlant, *, scaled: bool = True) -> control.StateSpace:
    """Return the whole plant, eq. 13 corrected, as a python-control system.

    Outputs are `OUTPUTS` [m/s^2, N, m/s^2, N], states those of ``plant.layout.names``.

    Parameters
    ----------
    plant
        ``scenario.plant``: continuous, inputs ``current`` [A] and ``white_noise`` of unit intensity.
        ``scenario.discrete``: one physics step under a held current, its only input, and its ``dt``.
    scaled
        Whether a state is a multiple of its ``state_scale``; a gain found so is divided by that scale
        before it multiplies SI states. False: in SI.
    """
    if isinstance(plant, DiscretePlant):
        continuous, inputs, dt = plant.plant, [CURRENT], plant.dt
        model: StateSpace | DiscreteStateSpace = plant.model
    else:
        continuous, inputs, dt = plant, [CURRENT, WHITE_NOISE], 0.0  # python-control's continuous time
        model = plant.coupled
    scale = continuous.state_scale if scaled else np.ones(model.order)
    return control.ss(
        *_in_units(model, scale), dt, inputs=inputs, outputs=list(OUTPUTS),
        states=state_names(continuous), name="shake_table",
    )  # fmt: skip


def driven_to_control(plant: CoupledPlant, *, scaled: bool = True) -> control.StateSpace:
    """Return the plant without its ground filter, driven by a target acceleration of one's own.

    Inputs ``current`` [A] and ``target_acceleration`` [m/s^2]; outputs `OUTPUTS` without the target.
    """
    model, ground = plant.driven, plant.layout.filter_states
    scale = plant.state_scale[ground:] if scaled else np.ones(model.order)
    return control.ss(
        *_in_units(model, scale), inputs=[CURRENT, OUTPUTS[2]],
        outputs=[OUTPUTS[0], OUTPUTS[1], OUTPUTS[3]], states=state_names(plant)[ground:],
        name="driven_table",
    )  # fmt: skip


def _in_units(
    model: StateSpace | DiscreteStateSpace, scale: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    return model.A * scale / scale[:, None], model.B / scale[:, None], model.C * scale, model.D


def state_names(plant: CoupledPlant) -> list[str]:
    """Return state names in a form that python-control takes: without units, blanks and primes."""
    bare = (name.split(" [")[0] for name in plant.layout.names)
    return [name.replace("'", "_dot").replace(" ", "_") for name in bare]


def from_control(system: control.StateSpace) -> StateSpace | DiscreteStateSpace:
    """Return a python-control system as this package's own type, discrete if it has a step.

    Raises
    ------
    ParameterError
        If the system is discrete without saying its step, or its matrices do not fit together.
    """
    A, B, C, D = (np.array(part, dtype=np.float64) for part in (system.A, system.B, system.C, system.D))
    if system.dt is True:
        raise ParameterError("dt", system.dt, "give the step in seconds")
    if system.dt:  # None and 0 both mean continuous time
        return DiscreteStateSpace(A, B, C, D, float(system.dt))
    return StateSpace(A, B, C, D)


class ControlLaw:
    """A compensator designed in python-control as a `Controller`.

    Parameters
    ----------
    scenario
        What it drives.
    system
        A discrete system of the scenario's control period, from signals in SI to the current [A]. Its
        input labels say which signals: a reading's name where the scenario measures signals
        (``table_displacement``), one of `state_names` where it shows the full state, and
        ``target_acceleration``. It answers within the period in which it reads: D counts.

    Raises
    ------
    ScenarioError
        If an input is not among the signals that the scenario shows.
    ParameterError
        If the system is not discrete with the control period, or has more than one output.
    """

    def __init__(self, scenario: Scenario, system: control.StateSpace) -> None:
        law = from_control(system)
        period = scenario.control_period
        if not (isinstance(law, DiscreteStateSpace) and np.isclose(law.dt, period, rtol=1e-9)):
            raise ParameterError("dt", system.dt, f"sample it at the control period, {period:.6g} s")
        if law.C.shape[0] != 1:
            raise ParameterError("outputs", law.C.shape[0], "a table has one current")
        self._law, self._limit = law, scenario.current_limit
        self._rows = signal_rows(scenario, system.input_labels).T.copy()

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), and the law's states in a tuple."""
        law = self._law
        x = recall(state, episode_start, observation.shape[:-1], law.order)
        y = observation.astype(np.float64) @ self._rows
        current = (x @ law.C.T + y @ law.D.T)[..., 0]
        return as_action(current, self._limit), (x @ law.A.T + y @ law.B.T,)


def signal_rows(scenario: Scenario, names: Sequence[str]) -> FloatArray:
    """Return rows (signals, n) that take signals in SI from an observation (n,), for python-control.

    Raises
    ------
    ScenarioError
        If the scenario does not show one of them.
    """
    layout, plant = scenario.observation, scenario.plant
    ground, scale = plant.layout.filter_states, plant.state_scale
    known = {}
    for place, name in enumerate(state_names(plant)[: layout.head]):
        known[name] = np.zeros(layout.size)
        known[name][place] = scale[place]
    for column, name in enumerate(layout.reading_names):
        known[name] = np.zeros(layout.size)
        known[name][layout.readings.start + column] = layout.reading_scale[column]
    target = np.zeros(layout.size)
    target[:ground] = plant.coupled.C[2, :ground] * scale[:ground]
    known[OUTPUTS[2]] = target
    for name in names:
        if name not in known:
            raise unknown(ScenarioError, "input", name, known)
    return np.array([known[name] for name in names])
