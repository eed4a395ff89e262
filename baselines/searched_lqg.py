"""A linear design with everything left free: what an independent search tries against the catalogue.

Controllers of the catalogue keep the scenario's own objective and nominal model, and leave one to three
values free. Here the law's objective, the specimen that it is designed for, what its filter believes of
the model's errors, the gain of the disturbance compensation, and the loop delay are free at
once. What a scenario does not have (a filter, where all is seen) has no parameter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from baselines.batch_controllers import rescaling
from baselines.catalogue import Baseline, Tunable
from baselines.estimation.estimator_model import ModelError
from baselines.estimation.lqg import estimated
from baselines.lqr.preview import PreviewFeedback, preview_lqr
from baselines.registry import parameter_values
from shake_env.controller import Controller
from shake_env.errors import ScenarioError, unknown
from shake_env.scenario.scenario import Scenario

FREE, FREE_FORCE = "free", "free-force"  # their names, where controllers have one
# What was found, and the same with the force weighed so many times more than the objective does: near
# its minimum the cost is flat in the force, and a specimen feels nothing else.
FOUND = {FREE: 1.0, FREE_FORCE: 20.0}

LAW = {
    "acceleration": Tunable(0.1, 10.0, 1.0),  # weight of the acceleration error, times the objective's
    "effort": Tunable(0.03, 30.0, 1.0),  # weight of the current, likewise
    "mass": Tunable(0.5, 2.0, 1.0),  # of the specimen that the law is designed for, times the nominal
    "frequency": Tunable(0.6, 1.4, 1.0),  # likewise
    "damping": Tunable(0.3, 10.0, 1.0),  # likewise
}
PLACE = {"position": Tunable(0.001, 1.0, 0.03, natural="high")}  # [m]
FILTER = {
    "force": Tunable(0.03, 30.0, 1.0),  # believed error of the model, times the nominal belief
    "flow": Tunable(0.03, 30.0, 1.0),
    "time": Tunable(0.1, 10.0, 1.0),  # correlation time of both, likewise
    "accommodation": Tunable(0.0, 2.0, 1.0, logarithmic=False),
    "lateness": Tunable(-1.0, 1.0, 0.0, logarithmic=False),  # [physics steps] on the delay
}


def free_parameters(scenario: Scenario) -> dict[str, Tunable]:
    """Return what the design leaves free on a scenario."""
    place = {} if scenario.ground.highpass_frequency is None else PLACE
    seen = scenario.sensing.full_state and not scenario.delay
    return LAW | place | ({} if seen else FILTER)


def free_baseline(scenario: Scenario) -> Baseline:
    """Return the design as an entry of a catalogue, for a scenario whose parts fix what is free."""
    return Baseline(free_design, "everything of a linear design left free", free_parameters(scenario))


def as_free(scenario: Scenario, tuned: Mapping[str, float], *, accommodates: bool) -> dict[str, float]:
    """Return the free parameters of a preview LQR or LQG with `tuned` position and doubt."""
    free = free_parameters(scenario)
    values = {name: tunable.default for name, tunable in free.items()}
    doubt = tuned.get("doubt", 1.0)
    same = {"position": tuned.get("position"), "force": doubt, "flow": doubt}
    same["accommodation"] = float(accommodates)
    return values | {name: value for name, value in same.items() if name in free and value is not None}


def free_design(scenario: Scenario, **values: float) -> Controller:
    """Return the controller of `free_parameters` values."""

    def make(full: Scenario) -> Controller:
        mass, frequency = values["mass"], values["frequency"]
        other = full.specimen.scaled(mass=mass, frequency=frequency, damping=values["damping"])
        imagined = replace(full, specimen=other)
        cost = imagined.stage_cost
        cost = replace(
            cost,
            acceleration=values["acceleration"] * cost.acceleration,
            current=values["effort"] * cost.current,
        )
        sensing = full.sensing
        design = preview_lqr(
            imagined.discrete, cost, sensing.preview, sensing.preview_spacing, values.get("position")
        )
        law = PreviewFeedback(imagined, design)
        law.row = law.row * rescaling(full, imagined)  # it reads the nominal specimen's observation
        return law

    if "accommodation" not in values:
        return make(scenario)
    error = ModelError.of(scenario)
    error = replace(
        error,
        force=values["force"] * error.force,
        flow=values["flow"] * error.flow,
        force_time=values["time"] * error.force_time,
        flow_time=values["time"] * error.flow_time,
    )
    believed = replace(scenario, delay=max(scenario.delay + values["lateness"], 0.0))
    return estimated(believed, make, error, accommodate=values["accommodation"])


def found_by_search(
    scenario: Scenario, name: str = FREE, parameters: Mapping[str, float] | None = None
) -> Controller:
    """Return the free design of a search.

    Parameters
    ----------
    scenario
        What it drives.
    name
        Of `FOUND`: whether the force is weighed as the objective does, or more.
    parameters
        What was found, defaults for what is left out; None takes what `shake tune free` found for
        exactly this scenario, and the defaults else.

    Raises
    ------
    ScenarioError
        If the design has no such parameter on this scenario.
    """
    values = as_free(scenario, {}, accommodates=True)
    given = parameter_values(FREE, scenario).parameters if parameters is None else parameters
    for each in given:
        if each not in values:
            raise unknown(ScenarioError, f"parameter of {FREE}", each, values)
    values |= given
    objective = scenario.objective
    objective = replace(objective, force_weight=FOUND[name] * objective.force_weight)
    return free_design(replace(scenario, objective=objective), **values)
