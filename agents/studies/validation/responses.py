"""Responses of the coupled plant to target motions, under each controller of the validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from agents.seeds import VALIDATION_SEED
from agents.studies.reproduction.tables import WEIGHTS
from baselines.analysis.balanced_truncation import Reduction
from baselines.analysis.closed_loop import ContinuousClosedLoop, Response, closed_loop, forced_response
from baselines.lqr.continuous import continuous_lqr
from baselines.lqr.sampled import LinearFeedback, sampled_lqr
from shake_env.model.discretization import first_order_hold
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_DISPLACEMENT, TABLE_VELOCITY
from shake_env.model.random_numbers import episode_key
from shake_env.motion.targets import Envelope, FilteredNoise, RecordedMotion, target_history
from shake_env.rollout import (
    Earthquake,
    noise_earthquakes,
    recorded_earthquakes,
    rollout,
)
from shake_env.scenario.limits import Limits
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.excitation import Excitation
from shake_env.simulation.streams import earthquake_stream
from shake_env.simulation.trajectory import Trajectory

HIGHPASS = 0.5  # [Hz] of the third group: without it the target's displacement has no bound
UNKNOWN_SPECIMEN = 1e-3  # mass over table mass of a design that takes the table as empty
UNCLIPPED = 100.0  # [A] the validation asks what a motion needs, so that nothing may cut it short

SAMPLED, UNAWARE = "LQR", "LQR without specimen"


@dataclass(frozen=True)
class Group:
    """Motions that share a plant."""

    name: str
    scenario: Scenario
    earthquakes: list[Earthquake]


def motion_groups(scenario: Scenario, noise: int) -> list[Group]:
    """Return the validation's motions by group: records, filtered noise, enveloped filtered noise."""
    free = replace(scenario, limits=Limits(), current_limit=UNCLIPPED)
    group_list = [Group("records", free, recorded_earthquakes(free))]
    if noise == 0:
        return group_list
    group_list.append(Group("filtered noise", free, noise_earthquakes(free, noise, VALIDATION_SEED)))
    if scenario.ground.highpass_frequency is None:
        ground = replace(scenario.ground, highpass_frequency=HIGHPASS)
        motion = free.motion if isinstance(free.motion, FilteredNoise) else FilteredNoise()
        highpassed = replace(free, ground=ground, motion=replace(motion, envelope=Envelope()))
        quakes = noise_earthquakes(highpassed, noise, VALIDATION_SEED + noise)
        group_list.append(Group("high-passed noise", highpassed, quakes))
    return group_list


def sampled_gains(scenario: Scenario) -> dict[str, FloatArray]:
    """Return the LQR gains (n,) of the validation's two sampled-data controllers."""
    specimen, table = scenario.specimen, scenario.actuator.table_mass
    shrink = UNKNOWN_SPECIMEN * table / specimen.mass
    empty = replace(scenario, specimen=specimen.scaled(mass=shrink))
    return {
        SAMPLED: sampled_lqr(scenario.discrete, scenario.stage_cost).gain,
        UNAWARE: sampled_lqr(empty.discrete, empty.stage_cost).gain,
    }


@dataclass(frozen=True)
class Motion:
    """What one controller made of one motion."""

    name: str
    time: FloatArray  # (samples,) [s]
    signals: dict[str, FloatArray]  # (samples,) by name, SI


def sampled_responses(group: Group, gain: FloatArray) -> list[Motion]:
    """Roll a sampled-data law out on every motion; return its tables' signals at the physics step."""
    scenario = group.scenario
    _, traces = rollout(
        LinearFeedback(scenario, gain),
        scenario,
        group.earthquakes,
        record=range(len(group.earthquakes)),
    )
    responses = []
    for i, quake in enumerate(group.earthquakes):
        trace = traces[i]
        states = physics_states(scenario, quake, trace)
        stories = scenario.specimen.stories
        table, floors = states[:, :4], states[:, 4 : 4 + stories]
        reference = states[:, 4 + 2 * stories : 4 + 3 * stories]
        responses.append(
            Motion(
                quake.name,
                trace.time,
                {
                    "target_acceleration": trace.target_acceleration,
                    "table_acceleration": trace.table_acceleration,
                    "reference_base_shear": trace.reference_base_shear,
                    "base_shear": trace.base_shear,
                    "load_pressure": table[:, LOAD_PRESSURE],
                    "table_displacement": table[:, TABLE_DISPLACEMENT],
                    "table_velocity": table[:, TABLE_VELOCITY],
                    "spool_position": table[:, SPOOL_POSITION],
                    "current": np.repeat(trace.current, scenario.substeps),
                    "storey_drift": largest_drift(floors),
                    "reference_drift": largest_drift(reference),
                },
            )
        )
    return responses


def largest_drift(floors: FloatArray) -> FloatArray:
    """Return, at each sample, the size of the largest drift between neighbouring floors [m].

    Parameters
    ----------
    floors
        (samples, stories) displacements relative to the table [m].
    """
    drifts = np.diff(floors, axis=1, prepend=np.zeros((len(floors), 1)))
    largest: FloatArray = np.max(np.abs(drifts), axis=1)
    return largest


def first_sample(scenario: Scenario, quake: Earthquake) -> float:
    """Return the target acceleration at time 0 [m/s^2]; filtered noise begins at rest."""
    if not isinstance(quake.motion, RecordedMotion):
        return 0.0
    return float(target_history(quake.motion, scenario.physics_step).acceleration[0])


def smooth_target(scenario: Scenario, quake: Earthquake, samples: int) -> FloatArray:
    """Return the target at time 0 and after each of `samples` physics steps [m/s^2], fit for a spline.

    A record is taken as it is. Filtered noise is too rough for a curve through its samples: the curve's
    integral would wander off from the ground's velocity by centimetres a second. The curve is therefore
    laid through the velocity, which the same seed gives at every physics step, and its slope is taken.
    """
    step = scenario.physics_step
    if isinstance(quake.motion, RecordedMotion):
        return target_history(quake.motion, step).acceleration[: samples + 1]
    assert isinstance(quake.motion, FilteredNoise)  # a group shakes one motion at a time
    fine = replace(scenario, control_rate=1.0 / step)
    ground = scenario.ground
    excitation = Excitation(fine.discrete, 1, finer=scenario.substeps)
    key = episode_key(earthquake_stream(quake.seed))
    excitation.start([0], [quake.motion], [key])
    velocity = np.zeros(samples + 1)
    for j in range(samples):
        state = excitation.advance().ground[0]
        plain = ground.highpass_frequency is None
        velocity[j + 1] = 2.0 * ground.damping_ratio * ground.omega * state[0] if plain else state[3]
    time = step * np.arange(samples + 1)
    # From rest: the ground filter's state is zero at time 0, and its acceleration with it.
    slope: FloatArray = CubicSpline(time, velocity, bc_type=("clamped", "not-a-knot"))(time, 1)
    return slope


def physics_states(scenario: Scenario, quake: Earthquake, trace: Trajectory) -> FloatArray:
    """Return ``[x_A, x_S, x~_S]`` after each physics step, (samples, n), from the recorded current.

    A trajectory holds the state once a control period, and the oil column swings several times in one.
    Where this linear recomputation does not meet the recorded states, the plant is not the linear one,
    and the recorded states themselves are returned, each held over its period.
    """
    plant = scenario.plant
    scale = plant.state_scale[plant.layout.filter_states :]
    model, B_next = first_order_hold(plant.driven, scenario.physics_step, scale)
    current = np.repeat(trace.current, scenario.substeps)
    target = np.concatenate([[first_sample(scenario, quake)], trace.target_acceleration])
    push = np.outer(current, model.B[:, 0] + B_next[:, 0])
    push += np.outer(target[:-1], model.B[:, 1]) + np.outer(target[1:], B_next[:, 1])
    states = np.zeros((len(push) + 1, len(scale)))
    for j, now in enumerate(push):
        states[j + 1] = model.A @ states[j] + now
    states = states[1:]
    recorded, known = trace.state, 4 + 2 * scenario.specimen.stories
    ends = states[scenario.substeps - 1 :: scenario.substeps, :known]
    size = np.max(np.abs(recorded), axis=0) + np.finfo(float).tiny
    if np.max(np.abs(ends - recorded) / size) > 1e-3:
        held = np.repeat(recorded, scenario.substeps, axis=0)
        return np.hstack([held, states[:, known:]])
    return states


def continuous_loops(scenario: Scenario) -> dict[str, ContinuousClosedLoop]:
    """Return the closed loops of the paper's two weightings, by the number of its table."""
    loops = {}
    for table, (q_1, q_2) in WEIGHTS.items():
        design = continuous_lqr(scenario.plant, q_1=q_1, q_2=q_2)
        loops[table] = closed_loop(scenario.plant, design.gain)
    return loops


def continuous_name(table: str) -> str:
    """Return what a continuous controller is called in tables and figures."""
    return f"continuous {table}"


def continuous_response(
    loop: ContinuousClosedLoop, scenario: Scenario, name: str, target: FloatArray
) -> tuple[Motion, Response]:
    """Return what the validation's full closed loop makes of a target (samples,) at the physics step."""
    step, ground = scenario.physics_step, loop.plant.ground
    response = forced_response(loop.system, ground, target, step, loop.index["table_velocity"])
    signals = {name: response.outputs[:, i] for name, i in loop.index.items() if "drift" not in name}
    signals |= {
        "table_displacement": response.displacement,
        "storey_drift": _largest(response.outputs, loop, "drift_"),
        "reference_drift": _largest(response.outputs, loop, "reference_drift_"),
    }
    return Motion(name, step * np.arange(len(target), dtype=np.float64), signals), response


def _largest(outputs: FloatArray, loop: ContinuousClosedLoop, prefix: str) -> FloatArray:
    columns = [i for name, i in loop.index.items() if name.startswith(prefix)]
    largest: FloatArray = np.max(np.abs(outputs[:, columns]), axis=1)
    return largest


def reduced_response(
    loop: ContinuousClosedLoop,
    reduction: Reduction,
    outputs: Sequence[str],
    scenario: Scenario,
    target: FloatArray,
) -> Response:
    """Return the response of a reduced model, in SI like the full one's columns of `outputs`."""
    place = list(outputs).index("table_velocity")
    response = forced_response(reduction.system, loop.plant.ground, target, scenario.physics_step, place)
    sizes = loop.sizes[[loop.index[name] for name in outputs]]
    return Response(response.outputs * sizes, response.displacement * sizes[place], response.noise)
