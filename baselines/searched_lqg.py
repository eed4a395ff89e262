"""An LQG with every design parameter free: what an independent search compares the catalogue with.

Controllers of the catalogue keep the scenario's own objective and nominal model, and leave one to three
values free. Here the weights, the specimen of the design, the filter's error model, the gain of the
disturbance compensation and the loop delay are free at once. A scenario without an estimator has no
parameters of an estimator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from baselines.baseline import Baseline, Tunable
from baselines.batch_controllers import rescaling
from baselines.estimation.estimator_model import ModelError
from baselines.estimation.lqg import estimated
from baselines.lqr.preview import PreviewFeedback, preview_lqr
from shake_env.controller import Controller
from shake_env.scenario.scenario import Scenario

LQG_SEARCHED, LQG_SEARCHED_FORCE = "lqg-searched", "lqg-searched-force"
# Factor on the objective's force weight. Near its minimum the cost is flat in the base shear, which is
# all that loads a specimen.
SEARCHED = {LQG_SEARCHED: 1.0, LQG_SEARCHED_FORCE: 20.0}
SUMMARIES = {
    LQG_SEARCHED: "LQG whose parameters an independent search found, all at once",
    LQG_SEARCHED_FORCE: "the same with twenty times the weight of the base shear",
}

# Each scale multiplies the scenario's nominal value.
LAW = {
    "acceleration_weight_scale": Tunable(0.1, 10.0, 1.0),
    "current_weight_scale": Tunable(0.03, 30.0, 1.0),
    "mass_scale": Tunable(0.5, 2.0, 1.0),  # of the specimen that the law is designed for
    "frequency_scale": Tunable(0.6, 1.4, 1.0),  # likewise
    "damping_scale": Tunable(0.3, 10.0, 1.0),  # likewise
}
DISPLACEMENT = {"displacement_tolerance": Tunable(0.001, 1.0, 0.03, natural="high")}  # [m]
ESTIMATOR = {
    "force_error_scale": Tunable(0.03, 30.0, 1.0),  # of the error model, see `ModelError`
    "flow_error_scale": Tunable(0.03, 30.0, 1.0),
    "error_time_scale": Tunable(0.1, 10.0, 1.0),  # correlation time of both
    "disturbance_gain": Tunable(0.0, 2.0, 1.0, logarithmic=False),  # of its compensation; 1: all of it
    "delay_offset": Tunable(-1.0, 1.0, 0.0, logarithmic=False),  # [physics steps] on the loop delay
}


def searched_parameters(scenario: Scenario) -> dict[str, Tunable]:
    """Return what the design leaves free on a scenario."""
    displacement = {} if scenario.ground.highpass_frequency is None else DISPLACEMENT
    full_state = scenario.sensing.full_state and not scenario.delay
    return LAW | displacement | ({} if full_state else ESTIMATOR)


def searched_baseline(scenario: Scenario, name: str = LQG_SEARCHED) -> Baseline:
    """Return the design as an entry of the catalogue; the scenario decides what is free.

    Parameters
    ----------
    scenario
        What it drives.
    name
        Of `SEARCHED`.
    """

    def make(scenario: Scenario, **values: float) -> Controller:
        objective = scenario.objective
        objective = replace(objective, force_weight=SEARCHED[name] * objective.force_weight)
        return searched_design(replace(scenario, objective=objective), **values)

    return Baseline(make, SUMMARIES[name], searched_parameters(scenario))


def searched_values(
    scenario: Scenario, tuned: Mapping[str, float], *, accommodates: bool
) -> dict[str, float]:
    """Return the parameters that make the design equal a `tuned` preview LQR or LQG.

    Parameters
    ----------
    scenario
        What it drives.
    tuned
        Parameters of `preview-lqr`, `lqg` or `lqg-dac`.
    accommodates
        Whether the disturbance is compensated, as by `lqg-dac`.
    """
    free = searched_parameters(scenario)
    error_scale = tuned.get("model_error_scale", 1.0)
    equal = {
        "displacement_tolerance": tuned.get("displacement_tolerance"),
        "force_error_scale": error_scale,
        "flow_error_scale": error_scale,
        "disturbance_gain": float(accommodates),
    }
    return {name: tunable.default for name, tunable in free.items()} | {
        name: value for name, value in equal.items() if name in free and value is not None
    }


def searched_design(scenario: Scenario, **values: float) -> Controller:
    """Return the controller with `searched_parameters` at these values."""

    def make(full: Scenario) -> Controller:
        mass, frequency = values["mass_scale"], values["frequency_scale"]
        damping = values["damping_scale"]
        other = full.specimen.scaled(mass=mass, frequency=frequency, damping=damping)
        design_scenario = replace(full, specimen=other)
        cost = design_scenario.stage_cost
        cost = replace(
            cost,
            acceleration=values["acceleration_weight_scale"] * cost.acceleration,
            current=values["current_weight_scale"] * cost.current,
        )
        sensing, tolerance = full.sensing, values.get("displacement_tolerance")
        design = preview_lqr(
            design_scenario.discrete, cost, sensing.preview, sensing.preview_spacing, tolerance
        )
        law = PreviewFeedback(design_scenario, design)
        law.row = law.row * rescaling(full, design_scenario)  # it reads the nominal observation
        return law

    if "disturbance_gain" not in values:
        return make(scenario)
    error = ModelError.from_scenario(scenario)
    error = replace(
        error,
        force=values["force_error_scale"] * error.force,
        flow=values["flow_error_scale"] * error.flow,
        force_time=values["error_time_scale"] * error.force_time,
        flow_time=values["error_time_scale"] * error.flow_time,
    )
    design_scenario = replace(scenario, delay=max(scenario.delay + values["delay_offset"], 0.0))
    return estimated(design_scenario, make, error, accommodate=values["disturbance_gain"])
