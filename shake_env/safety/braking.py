"""What braking will do: the table's motion from now on, as an affine function of one command.

A command holds for one period; from then on a braking law, a fixed feedback of the last command and
the displacement, brings the table to rest. On the linear plant everything that follows (displacement,
velocity, pressure, accelerations, the law's own commands) is affine in the present command. A row here
is one quantity at one time under one specimen that the table may carry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shake_env.dynamics.nonlinear import (
    FLOW,
    FORCE,
    arrival,
    commands_under_way,
    controlled_plant,
    controlled_scale,
    floor_rows,
)
from shake_env.errors import NumericalError, ScenarioError
from shake_env.model.discretization import first_order_hold, zero_order_hold
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray, Specimen
from shake_env.model.plant import (
    LOAD_PRESSURE,
    TABLE_DISPLACEMENT,
    TABLE_VELOCITY,
    CoupledPlant,
    StateSpace,
    specimen_plant,
)
from shake_env.scenario.scenario import Scenario

ACTUATOR = 4  # x_A leads every vector here
# Quantity: [s] between looks at it, and the last. The law stops a table in 0.1 s, most of it in the
# first 0.05 s. There are 14 looks at a period of the oil column. A specimen of 3 Hz answers within half
# its own.
LOOKS = {
    "table_displacement": (0.010, 0.2),
    "table_velocity": (0.002, 0.05),
    "load_pressure": (0.004, 0.1),
    "table_acceleration": (0.002, 0.05),
    "specimen_acceleration": (0.005, 0.15),
    "current": (0.005, 0.03),  # of the law's own commands, which must be possible
}
PLACES = {
    "load_pressure": LOAD_PRESSURE,
    "table_displacement": TABLE_DISPLACEMENT,
    "table_velocity": TABLE_VELOCITY,
    "table_acceleration": 4,
}
CLOSING = 0.012  # [s] time constant in which the braking law lets the valve close
CREEP = 0.73  # [1/s] rate at which it brings a table back to the middle of its stroke
FLOW_DECAY = 0.02  # [s] in which the orifice's departure from the linear flow goes as the table brakes
MATTERS = 0.01  # [-] of a limit; what full current moves by less is left out


@dataclass(frozen=True)
class Hypothesis:
    """The linear table under one specimen, over one control period.

    Columns are ``z = [x_A, x_r, w, force, flow, commands under way, command]``: w are the floors'
    velocities in space, force [N] and flow [m of spool] what the linear plant under this specimen
    leaves out.
    """

    period: FloatArray  # (columns - 1, columns) what follows of z, without its command
    outputs: FloatArray  # (substeps, quantities, columns) [x_A, y_A, floors] after each physics step


def braking_law(scenario: Scenario) -> FloatArray:
    """Return K, (4 + commands under way,) [A per SI unit], of the law ``u = -K [x_A, commands]``.

    The last command is let go by a fixed share in each period, and the valve closes with it. No reading
    but the displacement enters, weakly, so that a table at the end of its stroke creeps back: the law
    stops a table whatever bulk modulus, valve gain and delay are, and when readings are late or wrong.
    """
    n = max(1, commands_under_way(scenario.delay, scenario.substeps))
    gain = np.zeros(ACTUATOR + n)
    share = math.exp(-scenario.control_period / CLOSING)
    gain[TABLE_DISPLACEMENT] = CREEP * (1.0 - share) / scenario.actuator.velocity_gain
    gain[-1] = -share
    return gain


def bare_table(scenario: Scenario) -> Hypothesis:
    """Return the table under a specimen of one storey that weighs nothing."""
    bare = scenario.specimen.masses[0] * 1e-9
    return _hypothesis(scenario, Specimen(masses=(bare,), stiffnesses=(bare * 1e3,), dampings=(bare,)))


def _hypothesis(scenario: Scenario, specimen: Specimen) -> Hypothesis:
    plant = CoupledPlant(scenario.actuator, specimen, scenario.ground, scenario.equations)
    plain = Nonlinearity()
    model = zero_order_hold(
        controlled_plant(plant, plain), scenario.physics_step, controlled_scale(plant, plain)
    )
    n, m, k = specimen.stories, model.order, scenario.substeps
    commands = max(1, commands_under_way(scenario.delay, k))
    arriving = arrival(scenario.delay, k, commands)
    force, flow, queue = m, m + 1, slice(m + 2, m + 3 + commands)
    columns = m + 3 + commands
    running = np.zeros((m, columns))
    running[:, :m] = np.eye(m)
    running[ACTUATOR + n :, TABLE_VELOCITY] = -1.0  # x_r' = w - v_a
    floors = np.zeros((n, m))
    floors[:, ACTUATOR:] = floor_rows(plant, plain.yielding)
    output_rows = np.vstack([np.eye(ACTUATOR, m), model.C[:1], floors])
    push = np.zeros((len(output_rows), columns))
    push[ACTUATOR, force] = 1.0 / scenario.actuator.table_mass
    decay, outputs = math.exp(-scenario.physics_step / FLOW_DECAY), []
    for j in range(k):
        running = model.A @ running
        running[:, queue] += np.outer(model.B[:, 0], arriving[j])
        running[:, force] += model.B[:, 1 + FORCE]
        running[:, flow] += model.B[:, 1 + FLOW] * decay**j
        outputs.append(output_rows @ running + push)
    period = np.zeros((columns - 1, columns))
    period[:m] = running
    period[ACTUATOR + n : m] += running[TABLE_VELOCITY]
    period[force, force], period[flow, flow] = 1.0, decay**k
    period[flow + 1 :, flow + 2 :] = np.eye(commands)
    return Hypothesis(period, np.stack(outputs))


def _carried(scenario: Scenario, specimen: Specimen) -> tuple[FloatArray, FloatArray]:
    """Return how a specimen follows its table over a period, [x_r, w] -> [x_r, w].

    (2 stories, 2 stories), and (2 stories, 2) for the table's velocity at both ends, straight between.
    """
    n = specimen.stories
    A = specimen_plant(specimen).A
    B = np.concatenate([-np.ones(n), -A[n:, n:] @ np.ones(n)])[:, None]
    size = np.sqrt(specimen.stiffnesses[0] / specimen.masses[0])
    system = StateSpace(A, B, np.zeros((1, 2 * n)), np.zeros((1, 1)))
    scale = np.r_[np.full(n, 1.0 / size), np.ones(n)]
    model, following = first_order_hold(system, scenario.control_period, scale)
    return model.A, np.hstack([model.B, following])


@dataclass(frozen=True)
class BrakingPrediction:
    """What one command brings about, under each of H specimens: everything that is made ahead.

    Columns are those of ``z = [x_A, x_r, w, force, flow, commands under way]``, SI, without the command.
    A row is divided by what one ampere of the command does to it, so that `P = z @ rows` says by how
    much the command that would just reach a limit differs from `bound`.
    """

    feedback: FloatArray  # (4 + commands,) the braking law's K
    rows: FloatArray  # (H, columns, R) [A per unit of z]
    bound: FloatArray  # (H, 1, R) [A]
    velocity: FloatArray  # (H, columns + 1) v_a at the period's end from z and the command
    push: FloatArray  # (H,) what one newton does to it [m/s per N]
    carry: FloatArray  # (H, 2 stories, 2 stories + 2) [x_r, w] from [x_r, w, v_a before, v_a after]

    @classmethod
    def from_scenario(
        cls,
        scenario: Scenario,
        specimens: Sequence[Specimen],
        bounds: dict[str, float],
        noise: FloatArray,
    ) -> BrakingPrediction:
        """Look ahead from every state of a scenario's table.

        Parameters
        ----------
        scenario
            Its nominal actuator, timing, delay and current limit.
        specimens
            What the table may carry, H of them, of equally many storeys.
        bounds
            What each quantity of `Limits` may reach under braking, in SI, the current among them; those
            not named are not looked at.
        noise
            (4,) rms error of the readings of x_A; three times its effect is taken off a bound.

        Raises
        ------
        NumericalError
            If the braking law does not bring the table to rest under one of the specimens.
        ScenarioError
            If the noise alone reaches a bound.
        """
        feedback = braking_law(scenario)
        current = scenario.current_limit
        rows, reach, velocity, push, carry = [], [], [], [], []
        for specimen in specimens:
            model = _hypothesis(scenario, specimen)
            predicted, allowed = _predict(scenario, model, feedback, bounds)
            spread = np.sqrt(np.square(predicted[:, :ACTUATOR]) @ np.square(noise))
            if (allowed - 3.0 * spread <= 0.0).any():
                raise ScenarioError(
                    "sensing noise",
                    tuple(noise),
                    "is too large to tell when a limit is near: better sensors, or wider limits",
                )
            rows.append(predicted)
            reach.append(allowed - 3.0 * spread)
            velocity.append(model.outputs[-1, TABLE_VELOCITY])
            push.append(velocity[-1][ACTUATOR + 2 * specimen.stories])
            carry.append(np.hstack(_carried(scenario, specimen)))
        table, limit = np.stack(rows), np.stack(reach)
        effect = table[:, :, -1] * np.where(table[:, :, -1] < 0.0, -1.0, 1.0)
        matters = effect * current > MATTERS * limit
        relevant = matters.any(axis=0)
        effect = np.where(matters, effect, np.inf)[:, relevant]
        sign = np.where(table[:, relevant, -1] < 0.0, -1.0, 1.0)
        return cls(
            feedback=feedback,
            rows=np.swapaxes(table[:, relevant, :-1] * (sign / effect)[:, :, None], 1, 2).astype(
                np.float32
            ),
            bound=np.where(np.isinf(effect), 1e3, limit[:, relevant] / effect)[:, None].astype(
                np.float32
            ),
            velocity=np.stack(velocity),
            push=np.asarray(push),
            carry=np.stack(carry),
        )


def _predict(
    scenario: Scenario, model: Hypothesis, feedback: FloatArray, bounds: dict[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Return rows (R, columns) [SI] of what follows a command, and what each may reach (R,)."""
    step, columns = scenario.physics_step, model.period.shape[1]
    law = np.zeros(columns - 1)
    law[:ACTUATOR] = feedback[:ACTUATOR]
    law[columns - 1 - (len(feedback) - ACTUATOR) :] = feedback[ACTUATOR:]
    closed = model.period[:, :-1] - np.outer(model.period[:, -1], law)
    # Force and flow are inputs that stay or die out by themselves.
    inputs = columns - 1 - (len(feedback) - ACTUATOR) - 2
    moving = np.delete(np.arange(columns - 1), [inputs, inputs + 1])
    radius = float(np.max(np.abs(np.linalg.eigvals(closed[np.ix_(moving, moving)]))))
    if not radius < 1.0:
        raise NumericalError(
            "spectral radius",
            radius,
            "braking does not stop a table with this specimen: less mass on it, or more storey damping",
        )
    every = {name: max(1, round(LOOKS[name][0] / step)) for name in bounds}
    last = {name: round(LOOKS[name][1] / step) for name in bounds}
    rows, allowed = [], []
    running, now = np.eye(columns), 0
    while now < max(last.values()):
        outputs = model.outputs @ running
        following = model.period @ running
        running = np.vstack([following, -law @ following])
        for output in outputs:
            now += 1
            due = [name for name in bounds if now <= last[name] and now % every[name] == 0]
            for name in due:
                if name in PLACES:
                    looked = output[PLACES[name] : PLACES[name] + 1]
                else:
                    looked = output[ACTUATOR + 1 :] if name != "current" else running[-1:]
                rows.append(looked)
                allowed.extend([bounds[name]] * len(looked))
    return np.concatenate(rows), np.asarray(allowed)
