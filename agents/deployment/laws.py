"""Controllers as blocks: from the objects that drive a table in Python to what is written as C.

The constants are taken from the controllers themselves, designed as the registry designs them, so that
there is one design. `tests/agents/deployment/` holds both equal, decision by decision.
"""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np

from agents.deployment.program import Block, flat
from agents.policies.estimated_law import EstimatedLaw
from agents.policies.policy_file import PolicyFile
from baselines.estimation.adaptive import CertaintyEquivalence
from baselines.estimation.lqg import EstimatedState, full_state
from baselines.lqr.feedforward import NODES, WEIGHTS, FeedforwardLQR
from baselines.lqr.integral import IntegralFeedback
from baselines.lqr.preview import PreviewFeedback
from baselines.lqr.sampled import LinearFeedback
from baselines.planning.nonlinear_estimate import NonlinearEstimate
from baselines.servo.disturbance_observer import DisturbanceObserver
from baselines.servo.inverse_model import InverseFeedForward
from baselines.servo.mcs import MCS
from baselines.servo.output_feedback import OutputFeedback
from baselines.servo.signals import SignalReader
from shake_env.controller import NoControl
from shake_env.errors import ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.scenario import Scenario

NONLINEAR_FILTER = (
    "has no C form where signals are measured: its filter steps the nonlinear model; "
    "lqg and lqg-dac have one"
)


@singledispatch
def block_of(controller: Any, scenario: Scenario) -> Block:
    """Return a controller as a block that reads the scenario's observation.

    Raises
    ------
    ScenarioError
        If the controller needs more than one decision's arithmetic, or its form is not known here.
    """
    raise ScenarioError(
        "controller",
        type(controller).__name__,
        "has no C form: it solves, plans or learns while it runs, or no block describes its class",
    )


def _linear(row: Any) -> Block:
    return Block("linear", "linear feedback of the observation", arrays={"row": flat(row)})


@block_of.register
def _(controller: NoControl, scenario: Scenario) -> Block:
    return _linear(np.zeros(scenario.observation.size))


@block_of.register
def _(controller: LinearFeedback, scenario: Scenario) -> Block:
    return _linear(controller.row)


@block_of.register
def _(controller: PreviewFeedback, scenario: Scenario) -> Block:
    return _linear(controller.row)


@block_of.register
def _(controller: IntegralFeedback, scenario: Scenario) -> Block:
    return Block(
        "integral",
        "linear feedback with integral action on the displacement",
        arrays={"row": flat(controller.row), "error": flat(controller.error_row)},
        numbers={"gain": controller.integral_gain},
    )


@block_of.register
def _(controller: FeedforwardLQR, scenario: Scenario) -> Block:
    friction, orifice = controller.friction, controller.valve is not None
    if controller.load:
        raise ScenarioError("orifice", "present", "only its preview is exported")
    arrays = {"row": flat(controller.row)}
    numbers: dict[str, Any] = {
        "friction": friction is not None, "orifice": orifice, "order": controller.order,
        "limit": controller.limit,
    }  # fmt: skip
    if friction is not None or orifice:
        preview = controller.preview
        numbers["times"] = preview.rows.shape[1]
    if friction is not None:
        numbers |= vars(friction)
        arrays |= {
            "velocity": flat(preview.rows[1]), "spread": flat(preview.velocity_spread),
            "force_row": flat(preview.force_row), "nodes": NODES, "weights": WEIGHTS,
        }  # fmt: skip
    if orifice:
        arrays |= {
            "pressure": flat(preview.rows[0]), "spool": flat(preview.rows[2]),
            "flow_row": flat(preview.flow_row),
        }  # fmt: skip
    summary = "preview LQR with friction and orifice feed-forward"
    return Block("friction_feedforward", summary, arrays=arrays, numbers=numbers)


@block_of.register
def _(controller: NonlinearEstimate, scenario: Scenario) -> Block:
    raise ScenarioError("controller", type(controller).__name__, NONLINEAR_FILTER)


@block_of.register
def _(controller: EstimatedState, scenario: Scenario) -> Block:
    model, recursion = controller.estimator.model, controller.recursion
    shown, layout, full = scenario.observation, scenario.plant.layout, scenario.sensing.full_state
    inner = full_state(scenario)
    gains = controller.estimator.gains
    arrays = {
        "A": model.A, "B": model.B, "C": model.C, "ahead": model.ahead, "gains": gains,
        "S": recursion.S, "W_before": recursion.W_before, "W_now": recursion.W_now,
        "predicted_ground": controller.predicted_ground,
    }  # fmt: skip
    numbers = {
        "states": model.order,
        "actions": model.commands + 1,
        "readings": len(model.C),
        "periods": len(gains),
        "w": layout.filter_states,
        "r": 2 * layout.stories,
        "first_reading": layout.controlled.start if full else shown.readings.start,
        "first_reference": layout.reference.start if full else None,
        "preview": shown.preview_samples,
        "first_preview": shown.preview.start,
        "last_action": shown.last_action.start if shown.sensing.last_action else None,
        "believed": inner.observation.size,
    }
    return Block(
        "estimator",
        "Kalman filter, and prediction over the loop delay, in front of a full-state law",
        arrays={name: flat(array) for name, array in arrays.items()},
        numbers=numbers,
        inner=block_of(controller.law, inner),
    )


@block_of.register
def _(controller: CertaintyEquivalence, scenario: Scenario) -> Block:
    bank, observer = controller.bank, controller.observer
    shown, layout = scenario.observation, scenario.plant.layout
    scale = scenario.plant.state_scale
    arrays = {name: getattr(bank, name) for name in ("laws", "shear")}
    arrays["scale"] = scale[: shown.head]
    integers: dict[str, Any] = {}
    mean, variance = controller.prior
    numbers: dict[str, Any] = {
        "observed": observer is not None,
        "F": len(bank.frequencies), "M": len(bank.mass_ratios), "n": bank.shear.shape[1],
        "low": bank.mass_ratios[0], "high": bank.mass_ratios[-1], "entries": bank.laws.shape[-1],
        "forget": controller.forget, "variance": controller.variance,
        "prior_mean": mean, "prior_variance": variance, "limit": scenario.current_limit,
        "w": layout.filter_states, "first_specimen": layout.specimen.start,
        "first_reference": layout.reference.start, "preview": shown.preview_samples,
        "first_preview": shown.preview.start,
        "preview_scale": float(np.sqrt(scenario.plant.target_variance)),
        "last_action": shown.last_action.start if shown.sensing.last_action else None,
    }  # fmt: skip
    if observer is None:
        arrays["impulse"] = controller.impulse
    else:
        arrays |= {name: getattr(bank, name) for name in ("advance", "now", "following")}
        arrays |= {
            "source": controller.source, "balance": controller.balance,
            "reading_scale": shown.reading_scale[controller.places], "table_A": observer.A,
            "table_C": observer.C, "table_now": observer.now, "table_following": observer.following,
            "table_gain": observer.gain, "on_last": observer.on_last,
            "on_previous": observer.on_previous,
        }  # fmt: skip
        integers["places"] = [shown.readings.start + place for place in controller.places]
        numbers |= {"lead": controller.lead, "table_mass": observer.mass}
    return Block(
        "adaptive",
        "preview LQR of the specimen that is identified while the table moves",
        {name: flat(array) for name, array in arrays.items()},
        integers=integers,
        numbers=numbers,
    )


def _signals(reader: SignalReader) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays and numbers of the part that takes signals from an observation."""
    numbers = {"integrates": reader.integrates, "half_period": reader.half_period}
    return {"signals": flat(reader.rows.T)}, numbers


@block_of.register
def _(controller: OutputFeedback, scenario: Scenario) -> Block:
    arrays, numbers = _signals(controller.reader)
    law, r = controller.law, len(controller.law.C)
    arrays["D"] = law.D
    if r:
        arrays |= {"A": law.A, "B": law.B, "C": law.C, "W": law.W}
    numbers |= {"r": r, "limit": controller.limit}
    return Block("output_feedback", "linear feedback of measured signals", arrays, numbers=numbers)


@block_of.register
def _(controller: InverseFeedForward, scenario: Scenario) -> Block:
    arrays, numbers = _signals(controller.reader)
    law = controller.law
    arrays |= {"taps": law.taps, "feedback": law.feedback}
    numbers |= {
        "past": controller.past, "preview": law.preview, "limit": controller.limit,
        "samples": law.samples, "half_sample": 0.5 * controller.sample,
        "first_preview": scenario.observation.preview.start,
        "preview_scale": controller.preview_scale, "acceleration_tap": law.acceleration_tap,
    }  # fmt: skip
    return Block("inverse_model", "inverse-model feed-forward", arrays, numbers=numbers)


@block_of.register
def _(controller: MCS, scenario: Scenario) -> Block:
    arrays, numbers = _signals(controller.reader)
    d = controller.design
    arrays["D"] = controller.inner_row
    numbers |= {
        name: getattr(d, name)
        for name in ("damping_ratio", "displacement", "alpha", "beta", "leakage", "bound",
                     "error_integral", "normalised")
    }  # fmt: skip
    numbers |= {
        "omega": controller.omega, "gain_unit": controller.gain_unit, "limit": controller.limit,
        "period": controller.period, "bounded": bool(np.isfinite(d.bound)),
    }  # fmt: skip
    return Block(
        "mcs", "minimal control synthesis around three-variable control", arrays, numbers=numbers
    )


@block_of.register
def _(controller: DisturbanceObserver, scenario: Scenario) -> Block:
    arrays, numbers = _signals(controller.reader)
    shown = scenario.observation
    arrays["arrivals"] = controller.arrivals
    numbers |= {
        "past": len(controller.arrivals), "limit": controller.limit, "lag": controller.lag,
        "velocity_gain": controller.velocity_gain, "follow": controller.follow,
        "last_action": shown.last_action.start if shown.sensing.last_action else None,
    }  # fmt: skip
    inner = block_of(controller.controller, scenario)
    summary = "disturbance observer around another controller"
    return Block("disturbance_observer", summary, arrays, numbers=numbers, inner=inner)


@block_of.register
def _(controller: PolicyFile, scenario: Scenario) -> Block:
    arrays: dict[str, Any] = {"matrix": controller.matrix, "base": controller.base}
    for number, (weight, bias) in enumerate(zip(controller.weights, controller.biases, strict=True)):
        arrays[f"weight_{number}"], arrays[f"bias_{number}"] = weight, bias
    memory, law = controller.memory, controller.law
    if memory is not None:
        arrays |= memory.parts
    numbers = {
        "n": controller.observation_size,
        "features": len(controller.matrix),
        "feature_clip": controller.feature_clip,
        "widths": [len(bias) for bias in controller.biases],
        "activation": controller.activation,
        "output": controller.output,
        "authority": controller.authority,
        "direct": controller.direct,
        "memory": None if memory is None else memory.kind,
        "units": 0 if memory is None else memory.units,
        "states": () if memory is None else memory.state_widths,
        "dilations": () if memory is None else memory.dilations,
        "law": law is not None,
        "shown": 0,
    }
    if law is not None:
        parts, sizes = _estimated_law(law)
        arrays, numbers = arrays | parts, numbers | sizes
    kind = "feedforward network" if memory is None else f"network with a memory ({memory.kind.upper()})"
    behind = " behind an estimator" if law is not None else ""
    return Block(
        "policy",
        f"learned policy: {kind}{behind}",
        {name: flat(array) for name, array in arrays.items()},
        sparse=tuple(n for n in ("matrix", "advance", "show") if n in arrays and _is_sparse(arrays[n])),
        numbers=numbers,
    )


def _is_sparse(matrix: FloatArray) -> bool:
    """Return whether half of a matrix or more is zero, and it is no small one."""
    return matrix.size >= 200 and float(np.mean(matrix == 0.0)) >= 0.5


def _estimated_law(law: EstimatedLaw) -> tuple[dict[str, Any], dict[str, Any]]:
    periods, estimates, readings = law.gains.shape
    arrays = {name: getattr(law, name) for name in ("advance", "gains", "show", "begins")}
    sizes = {
        "known": law.size, "shown": law.shown, "periods": periods, "estimates": estimates,
        "readings": readings, "actions": law.actions,
    }  # fmt: skip
    return arrays, sizes


@block_of.register
def _(controller: Supervised, scenario: Scenario) -> Block:
    from agents.deployment.supervision import supervisor_block  # long; in a file of its own

    return supervisor_block(controller, block_of(controller.controller, scenario))
