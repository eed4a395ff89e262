"""`shake design`: what fidelity to expect of the scenario's own controller, before the test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agents.evaluation.bound import optimal_cost
from agents.evaluation.controller_set import values_to_json
from agents.seeds import COMPARISON_SEED
from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import sampled_lqr
from baselines.registry import make_baseline, parameter_values, reference_name
from baselines.tuned_values import TunedValues
from shake_env.errors import ParameterError
from shake_env.motion.targets import MotionSet, RecordedMotion
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.scenario.scenario import Scenario

PROBLEM = "linear table, full state without delay, stationary unit motion"


def design(
    scenario: Scenario,
    earthquakes: int = 16,
    tuned: TunedValues | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Return a controller's expected errors and its full-state LQR, as `shake design` shows them.

    The controller is the scenario's reference (`baselines.registry.reference_name`). Where theory gives
    its performance exactly it is calculated; else it is simulated on the scenario's own motion.

    Parameters
    ----------
    scenario
        What is driven.
    earthquakes
        Number of filtered-noise earthquakes of a simulation.
    tuned
        Tuned values of a file that was named; see `baselines.registry.parameter_values`.
    tell
        Told that a simulation begins.

    Returns
    -------
    ``controller``, ``method`` (analysis or simulation), ``earthquakes`` (None: none was simulated),
    ``broken_limits``, ``cost`` [-], ``acceleration_rms_ratio`` and ``base_shear_rms_ratio`` (rms error
    over the target's rms, of a simulation the mean over earthquakes), ``current_rms`` [A] (None where it
    was simulated) of what runs; ``values`` (source of its parameters); ``bound``: errors and current of
    the full-state LQR with the same preview on the linear table under stationary motion of amplitude 1;
    ``analytic_cost`` J* [-], ``gain`` (n,) [A per SI unit of each state] and ``states`` (names and
    units) of the LQR without preview; ``natural_frequencies`` [Hz] (undamped, table and specimen
    coupled).

    Raises
    ------
    ParameterError
        If no earthquake is asked for.
    """
    if earthquakes < 1:
        raise ParameterError("earthquakes", earthquakes, "ask for at least 1")
    result = sampled_lqr(scenario.discrete, scenario.stage_cost)
    name, performance = "lqr", result.performance
    if preview := scenario.sensing.preview:
        spacing = scenario.sensing.preview_spacing
        preview_design = preview_lqr(scenario.discrete, scenario.stage_cost, preview, spacing)
        name, performance = "preview-lqr", preview_design.performance
    bound = {
        "controller": name,
        "acceleration_rms_ratio": performance.acceleration_rms_ratio,
        "base_shear_rms_ratio": performance.base_shear_rms_ratio,
        "current_rms": performance.current_rms,
    }
    if optimal_cost(scenario) is not None:
        expected = {
            **bound,
            "cost": performance.cost,
            "method": "analysis",
            "earthquakes": None,
            "broken_limits": 0,
        }
        values = {name: parameter_values(name, scenario, tuned)}
    else:
        name = reference_name(scenario)
        values = {name: parameter_values(name, scenario, tuned)}
        quakes = _own_earthquakes(scenario, earthquakes)
        tell(f"simulating {name} on {len(quakes)} earthquakes ...")
        rows, _ = rollout(make_baseline(name, scenario, values[name].parameters), scenario, quakes)
        expected = {
            "controller": name,
            "cost": float(np.mean([row.cost for row in rows])),
            "acceleration_rms_ratio": float(np.mean([row.acceleration_rms_error for row in rows])),
            "base_shear_rms_ratio": float(np.mean([row.base_shear_rms_error for row in rows])),
            "current_rms": None,
            "method": "simulation",
            "earthquakes": len(quakes),
            "broken_limits": sum(row.broken_limit is not None for row in rows),
        }
    return {
        **expected,
        "values": values_to_json(values),
        "bound": bound,
        "analytic_cost": result.analytic_cost,
        "natural_frequencies": scenario.plant.natural_frequencies.tolist(),
        "gain": result.gain.tolist(),
        "states": list(scenario.plant.layout.names),
    }


def _own_earthquakes(scenario: Scenario, number: int) -> list[Earthquake]:
    """Return earthquakes of the scenario's own motion: its records, or seeded filtered noise."""
    motion = scenario.motion
    if isinstance(motion, RecordedMotion):
        return [Earthquake(motion.source.name, motion)]
    recorded = recorded_earthquakes(scenario) if isinstance(motion, MotionSet) else []
    return recorded or noise_earthquakes(scenario, number, COMPARISON_SEED)
