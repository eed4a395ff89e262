"""Robustness of controllers to errors of the model of table, specimen, loop and motion.

Everything is designed on the scenario's nominal model, or was trained on the scenario. One parameter
of the driven plant is changed at a time, and pairs that aggravate each other. Observations stay in the
units of the nominal model, so that a controller sees a change in the response alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

import shake_env
from agents.evaluation.bound_store import earthquake_bounds
from agents.evaluation.controller_set import (
    ControllerSet,
    PortableController,
    get_controllers,
    values_to_json,
)
from agents.evaluation.perturbations import (
    QUANTITIES,
    Change,
    nominal_value,
    perturbed_pair,
    training_range,
)
from agents.execution.units import Unit, UnitRunner
from agents.plain_values import typed
from agents.policies.own_controller import is_own_controller, own_source
from agents.policies.policy_file import PolicyFile, file_digest
from agents.policies.registry import ORACLE, policies_trained_for, policy_path
from agents.provenance import code_version, machine
from agents.seeds import ROBUSTNESS_SEED
from baselines.tuned_values import TunedValues
from shake_env.controller import Controller
from shake_env.errors import ParameterError, ScenarioError, unknown
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.scenario.digest import known_name
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.metrics import EpisodeMetrics

FORMAT = "shake-robustness-1"
# Pairs that aggravate each other: both make the specimen another one; both take the loop's phase; and
# noise matters where the motion is weak.
PAIRS = (("mass_ratio", "storey_frequency"), ("coulomb_friction", "delay"), ("amplitude", "noise"))
# What is compared unless told otherwise: the reference, what ships, and the best of the classical ones.
DEFAULT_BASELINES = {
    "linear": ("h-infinity",),
    "laboratory": ("lqr-friction-ff", "nmpc", "lqg-searched"),
    "records": ("lqr-friction-ff", "nmpc", "lqg-searched"),
    "unknown-specimen": ("lqg-dac", "h-infinity", "lqg-searched"),
    "yielding": ("h-infinity", "lqg-searched"),
}


@dataclass(frozen=True, kw_only=True)
class Grid:
    """What is changed, and to which values, each in its quantity's unit."""

    sweeps: Mapping[str, tuple[float, ...]]  # by quantity, ascending
    maps: tuple[tuple[str, str], ...]  # pairs of quantities
    coarse: Mapping[str, tuple[float, ...]]  # values of a map's side, among those of the sweep

    @classmethod
    def from_scenario(
        cls, scenario: Scenario, quantities: Sequence[str] = (), maps: bool = True
    ) -> Grid:
        """Return the values for a scenario; its nominal value is always among them.

        Parameters
        ----------
        scenario
            What controllers are made for.
        quantities
            Names of `QUANTITIES`; none: all that the scenario's equations have.
        maps
            Whether pairs of them are changed together, too.

        Raises
        ------
        ScenarioError
            If there is no such quantity.
        """
        for name in quantities:
            if name not in QUANTITIES:
                raise unknown(ScenarioError, "quantity", name, QUANTITIES)
        chosen = [
            name
            for name, quantity in QUANTITIES.items()
            if name in quantities or (not quantities and quantity.suits(scenario))
        ]
        sweeps = {name: QUANTITIES[name].around(scenario) for name in chosen}
        pairs = tuple(p for p in PAIRS if maps and all(name in chosen for name in p))
        sides = {name for pair in pairs for name in pair}
        coarse = {name: QUANTITIES[name].around(scenario, coarse=True) for name in sides}
        return cls(sweeps=sweeps, maps=pairs, coarse=coarse)

    def changes(self, scenario: Scenario) -> list[Change]:
        """Return every change once; the first, empty, leaves the scenario as it is."""
        changes: dict[Change, None] = {(): None}
        for name, values in self.sweeps.items():
            changes |= {without_nominal(scenario, {name: value}): None for value in values}
        for x, y in self.maps:
            for a in self.coarse[x]:
                changes |= {without_nominal(scenario, {x: a, y: b}): None for b in self.coarse[y]}
        return list(changes)


def without_nominal(scenario: Scenario, values: Mapping[str, float]) -> Change:
    """Return a perturbation without the nominal values that are not drawn: they change nothing."""
    return tuple(
        (name, values[name])
        for name in QUANTITIES
        if name in values
        and (training_range(scenario, name) or values[name] != nominal_value(scenario, name))
    )


def default_controllers(scenario: Scenario) -> tuple[str, ...]:
    """Return the policies that ship for a scenario, and the classical ones beside."""
    known = known_name(scenario)
    trained = scenario.train_on or known
    return (*policies_trained_for(trained), *DEFAULT_BASELINES.get(known, ()))


def controllers_with_sources(
    names: Sequence[str], scenario: Scenario, tuned: TunedValues | None = None
) -> tuple[ControllerSet, dict[str, dict[str, Any]]]:
    """Return the controllers, designed on the nominal scenario, and the sources of the learned ones.

    Raises
    ------
    ScenarioError
        If a name is unknown, or means a controller that knows the changed table or repeats its tests.
    PolicyFileError
        If a policy cannot be read or does not fit the scenario.
    """
    chosen = get_controllers(names or default_controllers(scenario), scenario, tuned=tuned)
    if chosen.oracle:
        raise ScenarioError("controller", ORACLE, "knows what is changed: leave it out")
    sources = {}
    for name, controller in chosen.controllers.items():
        if isinstance(controller, PolicyFile):
            config = controller.card.get("config", {})
            sources[name] = {
                "algorithm": config.get("algorithm"),
                "seed": config.get("seed"),
                "sha256": file_digest(policy_path(name, known_name(scenario))),
            }
    return chosen, sources


def robustness_motions(scenario: Scenario, number: int, seed: int) -> list[Earthquake]:
    """Return the recorded motions of a scenario of records, and filtered noise of any other."""
    if number < 1:
        raise ParameterError("earthquakes", number, "ask for at least 1")
    if scenario.reserved_for_testing:
        return recorded_earthquakes(scenario)
    return noise_earthquakes(scenario, number, seed)


def robustness(
    scenario: Scenario,
    names: Sequence[str] = (),
    *,
    grid: Grid | None = None,
    earthquakes: int = 8,
    seed: int = ROBUSTNESS_SEED,
    tuned: TunedValues | None = None,
    runner: UnitRunner | None = None,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> dict[str, Any]:
    """Return costs and failures of every controller under every change, as plain JSON values.

    The bound is of the earthquakes where nothing is changed.

    Parameters
    ----------
    scenario
        What controllers are made for.
    names
        As `controller_set.get_controllers` takes them; none: `default_controllers`. The reference is
        run in any case.
    grid
        What is changed; None: everything, see `Grid.from_scenario`.
    earthquakes
        Number of filtered-noise earthquakes, the same under every change and for every controller.
    seed
        Of the first of them.
    tuned
        Tuned values of a file that was named. They, and those that come with the package, are looked up
        for the scenario as it stands: what is changed in it, no controller knows.
    runner
        Runs the parts of the map; None: this process.
    on_progress
        Told the controller that runs and its share done, 0 to 1.

    Raises
    ------
    ParameterError
        If no earthquake is asked for, or a value does not suit the scenario.
    ScenarioError
        If a controller is unknown or does not suit.
    """
    grid, code = (
        Grid.from_scenario(scenario) if grid is None else grid,
        code_version(),
    )  # that runs, not that ends
    quakes = robustness_motions(scenario, earthquakes, seed)
    chosen, sources = controllers_with_sources(names, scenario, tuned)
    controllers = chosen.controllers
    reference = next(iter(controllers))
    changes = grid.changes(scenario)
    designs = {
        name: (
            controller if isinstance(controller, PolicyFile) else name,
            chosen.values[name].parameters if name in chosen.values else None,
            own_source(name) if is_own_controller(name) else None,
        )
        for name, controller in controllers.items()
    }
    episodes = evaluate_perturbations(
        controllers, scenario, quakes, changes, designs, runner or UnitRunner(), on_progress
    )
    cost = {name: np.array([[m.cost for m in row] for row in rows]) for name, rows in episodes.items()}
    failures = {name: [sum(map(failed, row)) for row in rows] for name, rows in episodes.items()}
    return {
        "format": FORMAT,
        "scenario": scenario.name,
        "version": shake_env.__version__,
        "code": code,
        "machine": machine(),
        "seed": None if scenario.reserved_for_testing else seed,
        "earthquakes": [quake.name for quake in quakes],
        "reference": reference,
        "bound": earthquake_bounds(
            scenario, quakes, on_progress=lambda share: on_progress("bound", share)
        ).to_json(),
        "skipped": chosen.skipped,
        "warnings": chosen.warnings,
        "values": values_to_json(chosen.values),
        "controllers": [{"name": n, "source": sources.get(n)} for n in controllers],
        "quantities": [_quantity(scenario, name, values) for name, values in grid.sweeps.items()],
        "maps": [
            {"x": x, "y": y, "xs": list(grid.coarse[x]), "ys": list(grid.coarse[y])}
            for x, y in grid.maps
        ],
        "points": [
            {
                "changes": dict(change),
                "cost": {name: float(table[i].mean()) for name, table in cost.items()},
                "relative_cost": {
                    name: float(table[i].sum() / cost[reference][i].sum())
                    for name, table in cost.items()
                },
                "failures": {name: failures[name][i] for name in cost},
            }
            for i, change in enumerate(changes)
        ],
    }


def _quantity(scenario: Scenario, name: str, values: Sequence[float]) -> dict[str, Any]:
    return {
        "name": name,
        "title": QUANTITIES[name].title_for(scenario),
        "unit": QUANTITIES[name].unit_for(scenario),
        "nominal": nominal_value(scenario, name),
        "trained": training_range(scenario, name),
        "values": list(values),
    }


def failed(metrics: EpisodeMetrics) -> bool:
    """Return whether a perturbed test failed: a limit ended it, or standing still would have cost less.

    A scenario without limits lets an unstable loop go on; a motionless table's acceleration error is 1.
    """
    return metrics.broken_limit is not None or not metrics.acceleration_rms_error <= 1.0


def evaluate_perturbations(
    controllers: Mapping[str, Controller],
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    changes: Sequence[Change],
    designs: Mapping[str, tuple[Any, Mapping[str, float] | None, str | None]] | None = None,
    runner: UnitRunner | None = None,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> dict[str, list[list[EpisodeMetrics]]]:
    """Return the figures of controllers on every earthquake, under every change.

    Changes that differ by nothing but the motion's amplitude run side by side, a unit of a controller.

    Parameters
    ----------
    controllers, scenario, earthquakes, changes
        What is driven by what.
    designs
        What decides each controller: its name or policy, its parameters, a digest of own code. Needed by
        a runner that keeps units or has workers.
    runner
        Runs the units; None: this process.
    on_progress
        Told a controller and its share done, 0 to 1.
    """
    groups: dict[Change, list[int]] = {}
    for index, change in enumerate(changes):
        groups.setdefault(tuple(c for c in change if c[0] != "amplitude"), []).append(index)
    units = []
    for name, controller in controllers.items():
        for change, members in groups.items():
            amplitudes = [dict(changes[i]).get("amplitude", 1.0) for i in members]
            driven = (scenario, tuple(earthquakes), change, tuple(amplitudes))
            identity = None if designs is None else (designs[name], *driven)
            parameters = None if designs is None else designs[name][1]
            portable = PortableController(controller, name, scenario, parameters)
            units.append(Unit(name, _perturbed, (portable, *driven), identity))
    done = dict.fromkeys(controllers, 0)

    def on_share(index: int, share: float) -> None:
        if share == 1.0:
            done[units[index].name] += 1
            on_progress(units[index].name, done[units[index].name] / len(groups))

    results = iter((runner or UnitRunner()).run(units, on_share))
    metrics: dict[str, list[list[EpisodeMetrics]]] = {
        name: [[] for _ in changes] for name in controllers
    }
    for name in controllers:
        for members in groups.values():
            for index, rows in zip(members, next(results), strict=True):
                metrics[name][index] = [typed(EpisodeMetrics, row) for row in rows]
    return metrics


def _perturbed(
    driver: PortableController,
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    change: Change,
    amplitudes: Sequence[float],
) -> list[list[dict[str, Any]]]:
    """Return the figures on every earthquake at every amplitude, under one change."""
    quakes = [
        replace(q, motion=replace(q.motion, amplitude=factor * q.motion.amplitude))
        for factor in amplitudes
        for q in earthquakes
    ]
    true, unaware = perturbed_pair(driver.controller, scenario, dict(change), [q.seed for q in quakes])
    metrics, _ = rollout(unaware, true, quakes)
    rows, number = [asdict(each) for each in metrics], len(earthquakes)
    return [rows[i : i + number] for i in range(0, len(rows), number)]
