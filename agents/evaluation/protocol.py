"""The protocol of `docs/protocol.md`: policies and controllers on the same test earthquakes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

import shake_env
from agents.evaluation.bound import causal_bound, optimal_cost
from agents.evaluation.bound_store import Bounds, earthquake_bounds, search_code
from agents.evaluation.controller_set import values_to_json
from agents.evaluation.entries import Entry
from agents.evaluation.fidelity import fidelity
from agents.evaluation.latency import decision_time
from agents.evaluation.scores import Episodes, below_bound, cost_figures, result_row
from agents.evaluation.training_distance import training_warning
from agents.execution.units import Unit, UnitRunner, report
from agents.plain_values import plain_row
from agents.policies.own_controller import is_own_controller, own_source
from agents.policies.policy_file import PolicyFile
from agents.policies.registry import (
    CLASSICAL,
    SHIPPED,
    find_controller,
    get_controller,
    get_driven,
    information_of,
    values_for,
)
from agents.provenance import code_version, machine
from agents.seeds import TEST_SEED
from baselines.information import scenario_information
from baselines.registry import ParameterValues, reference_name
from baselines.tuned_values import TunedValues
from shake_env.errors import ParameterError, ScenarioError
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.scenario import Scenario

FORMAT = "shake-evaluation-1"
LANES = 64  # earthquakes side by side where figures are made of their trajectories, which need memory
MANY_LANES = 512  # where they are not
MOST_BOUNDS = 200  # test earthquakes, the first ones, whose bound is computed
BOUND = "bound"  # what costs are divided by where there is one
SANITY_CONTROLLER = "none"  # whose costs tell whether table and earthquakes are what they were


def evaluate(
    scenario: Scenario,
    entries: Sequence[Entry],
    *,
    earthquakes: int = 200,
    repeats: bool = True,
    resamples: int = 2000,
    known: dict[str, Any] | None = None,
    tuned: TunedValues | None = None,
    motions: Sequence[Earthquake] = (),
    events: Sequence[str] = (),
    runner: UnitRunner | None = None,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> dict[str, Any]:
    """Return the result of the evaluation protocol as plain JSON values.

    Parameters
    ----------
    scenario
        What is driven; `records` on its own motions, any other on filtered noise.
    entries
        Rows of the result. The reference is run in any case.
    earthquakes
        Number of test earthquakes; each draws its specimen and noise from a seed of its own.
    repeats
        Whether figures of fidelity (spectrum, drift, energy) are made, which takes longest.
    resamples
        Draws of the bootstrap.
    known
        A result of the same scenario and earthquakes: its rows that are not run now are taken over,
        their costs held against the reference as it is now, and so are its bounds.
    tuned
        Tuned values of a file that was named; see `baselines.registry.parameter_values`.
    motions, events
        Recorded motions to evaluate on in place of the scenario's own, and the event of each.
    runner
        Runs the parts of the evaluation; None: this process.
    on_progress
        Told the controller that runs, or ``bound``, and its share done, 0 to 1.

    Raises
    ------
    ParameterError
        If fewer than two earthquakes are asked for, two rows have one name or one a controller's, or
        the costs of the uncontrolled table differ from those of the `known` result.
    """
    if earthquakes < 2 or len(motions) == 1:
        number = 1 if motions else earthquakes
        raise ParameterError("earthquakes", number, "an interval needs at least 2")
    code = code_version()  # that runs, not that ends
    recorded = scenario.reserved_for_testing or bool(motions)
    if motions:
        quakes = [*motions]
    elif recorded:
        quakes = recorded_earthquakes(scenario)
    else:
        quakes = noise_earthquakes(scenario, earthquakes, TEST_SEED)
    reference, optimum = reference_name(scenario), optimal_cost(scenario)
    for each in entries:
        if each.policies and each.name in (BOUND, reference, *CLASSICAL):
            raise ParameterError(
                "entry", each.name, "is a controller's name: call the policies by NAME=PATH"
            )
    given = {each.name: each for each in entries}
    if len(given) < len(entries):
        raise ParameterError(
            "entries", [c.name for c in entries], "two rows have one name: give others by NAME=PATH"
        )
    always = (reference,) if known is None else (reference, SANITY_CONTROLLER)
    rows = {name: given.pop(name, Entry(name)) for name in dict.fromkeys(always)} | given
    values = {
        name: known_values
        for name, each in rows.items()
        if not each.policies and (known_values := values_for(name, scenario, tuned)) is not None
    }
    warnings = [
        f"{name} {text}"
        for name, each in rows.items()
        for text in dict.fromkeys(training_warning(policy, scenario) for policy in each.policies)
        if text
    ]
    episodes = _all_episodes(
        rows.values(), scenario, quakes, repeats, values, runner or UnitRunner(), on_progress
    )
    supervised = _supervised_episodes(
        [each for each in rows.values() if each.policies], scenario, quakes, runner, on_progress
    )
    latency = {
        name: _latency(each, scenario, values[name].parameters if name in values else None)
        for name, each in rows.items()
    }
    plain = {name: table.to_json() for name, table in episodes.items()}
    if known is not None:
        _check_same(plain[SANITY_CONTROLLER], known["episodes"].get(SANITY_CONTROLLER))
    bounds = _bounds(scenario, quakes, known, lambda share: on_progress(BOUND, share))
    normaliser = reference if bounds["reason"] else BOUND
    least = np.array([bounds["costs"]]) if normaliser == BOUND else episodes[reference].cost
    yardsticks: dict[str, Any] = {
        "normaliser": least,
        "reference": episodes[reference].cost,
        "optimum": optimum,
        "resamples": resamples,
    }
    summaries = [
        result_row(name, table, **yardsticks)
        | {
            "information": information_of(_shown_name(rows[name]), scenario),
            "decision_time": latency[name],
            "sources": list(rows[name].sources),
            "code": code,
            "machine": machine(),
        }
        | _supervised_row(supervised.get(name), yardsticks)
        for name, table in episodes.items()
    ]
    if known is not None:
        for row in known["rows"]:
            if (name := row["controller"]) not in plain:
                cost = np.array(known["episodes"][name]["cost"])
                kept = row | cost_figures(cost, **yardsticks)
                if known.get("bound", {}).get("code") != bounds["code"]:  # it is over those of then
                    kept.pop("supervised", None)
                summaries.append(kept)
        plain = known["episodes"] | plain
    if normaliser == BOUND:
        bounds["below"] = [
            {"controller": name, **each}
            for name, table in plain.items()
            for each in below_bound(table["cost"], bounds["costs"], bounds["disagreements"])
        ]
    return {
        "format": FORMAT,
        "scenario": scenario.name,
        "version": shake_env.__version__,
        "code": code,
        "machine": machine(),
        "seed": None if recorded else TEST_SEED,
        "earthquakes": [quake.name for quake in quakes],
        "events": list(events),
        "reference": reference,
        "normaliser": normaliser,
        "optimal_cost": optimum,
        "bound": bounds,
        "causal_bound": causal_bound(scenario),
        "information": scenario_information(scenario),
        "resamples": resamples,
        "values": ({} if known is None else known.get("values", {})) | values_to_json(values),
        "warnings": warnings,
        "rows": summaries,
        "episodes": plain,
    }


def can_supervise(scenario: Scenario) -> bool:
    """Return whether the safety supervisor applies: it needs limits to keep, and the table's signals."""
    try:
        Supervised(get_controller(SANITY_CONTROLLER, scenario), scenario)
    except ScenarioError:
        return False
    return True


def _supervised_episodes(
    entries: Sequence[Entry],
    scenario: Scenario,
    quakes: Sequence[Earthquake],
    runner: UnitRunner | None,
    on_progress: Callable[[str, float], None],
) -> dict[str, Episodes]:
    """Return the episodes of policies within the safety supervisor; none where it does not apply."""
    if not entries or not can_supervise(scenario):
        return {}
    return _all_episodes(
        entries, scenario, quakes, False, {}, runner or UnitRunner(),
        lambda name, share: on_progress(f"{name}, supervised", share), supervised=True,
    )  # fmt: skip


def _supervised_row(table: Episodes | None, yardsticks: dict[str, Any]) -> dict[str, Any]:
    """Return what a row says of its policies within the safety supervisor."""
    if table is None:
        return {}
    figures = cost_figures(table.cost, **yardsticks)
    acted = float(table.figures["supervised_share"].mean())
    cost = figures["relative_cost"]
    return {"supervised": {"relative_cost": cost, "failures": table.failures, "acted": acted}}


def _shown_name(entry: Entry) -> str:
    """Return a name that the registry knows: of policies that of a shipped one, which stands for any."""
    return SHIPPED[0] if entry.policies else entry.name


def _bounds(
    scenario: Scenario,
    quakes: Sequence[Earthquake],
    known: dict[str, Any] | None,
    on_progress: Callable[[float], None],
) -> dict[str, Any]:
    """Return the bounds of the first `MOST_BOUNDS` earthquakes, those of a known result if they hold."""
    before = (known or {}).get("bound")
    if before is not None and before["code"] == search_code():
        return {key: value for key, value in before.items() if key != "below"}
    bounds: Bounds = earthquake_bounds(scenario, quakes[:MOST_BOUNDS], on_progress=on_progress)
    return bounds.to_json()


def _check_same(episodes: dict[str, Any], before: dict[str, Any] | None) -> None:
    # Processors round differently, and 7 digits are written.
    if before is None or not np.allclose(episodes["cost"], before["cost"], rtol=1e-5):
        raise ParameterError(
            "known",
            SANITY_CONTROLLER,
            "its costs differ from the stored ones: evaluate all rows again (--rerun)",
        )


def _all_episodes(
    entries: Iterable[Entry],
    scenario: Scenario,
    quakes: Sequence[Earthquake],
    repeats: bool,
    values: Mapping[str, ParameterValues],
    runner: UnitRunner,
    on_progress: Callable[[str, float], None],
    supervised: bool = False,
) -> dict[str, Episodes]:
    """Return the episodes of every entry; a policy on some earthquakes side by side is a unit."""
    lanes = LANES if repeats else MANY_LANES
    parts = [quakes[i : i + lanes] for i in range(0, len(quakes), lanes)]
    units: list[Unit] = []
    members: list[tuple[str, int]] = []  # name and run of each unit
    for each in entries:
        parameters = values[each.name].parameters if each.name in values else None
        own = own_source(each.name) if is_own_controller(each.name) and not each.policies else None
        for run in range(each.runs):
            policy = each.policies[run] if each.policies else None
            for part in parts:
                arguments = (each.name, policy, scenario, part, repeats, parameters, supervised)
                name = f"{each.name} {run + 1}" if each.runs > 1 else each.name
                units.append(Unit(name, _part, arguments, (arguments, own)))
                members.append((each.name, run))
    done = dict.fromkeys(range(len(units)), 0.0)

    def on_share(index: int, share: float) -> None:
        done[index] = share
        name = members[index][0]
        own = [done[i] for i, member in enumerate(members) if member[0] == name]
        on_progress(name, sum(own) / len(own))

    rows: dict[str, dict[int, list[dict[str, Any]]]] = {}
    for (name, run), part in zip(members, runner.run(units, on_share), strict=True):
        rows.setdefault(name, {}).setdefault(run, []).extend(part)
    return {name: Episodes.from_rows([*runs.values()]) for name, runs in rows.items()}


def _part(
    name: str,
    policy: PolicyFile | None,
    scenario: Scenario,
    quakes: Sequence[Earthquake],
    repeats: bool,
    parameters: Mapping[str, float] | None,
    supervised: bool = False,
) -> list[dict[str, Any]]:
    """Return the figures of a controller on some earthquakes."""
    driven, controller = (
        get_driven(name, scenario, quakes, parameters) if policy is None else (scenario, policy)
    )
    if supervised:
        controller = Supervised(controller, driven)
    record = range(len(quakes)) if repeats else ()
    metrics, traces = rollout(controller, driven, quakes, record=record, on_step=report)
    rows = []
    for lane, figures in enumerate(metrics):
        row = asdict(figures)
        if repeats:
            row |= asdict(fidelity(traces[lane], scenario.physics_step))
        if isinstance(controller, Supervised):
            row["supervised_share"] = controller.interventions().share
        rows.append(plain_row(row))
    return rows


def _latency(each: Entry, scenario: Scenario, parameters: Mapping[str, float] | None) -> float | None:
    """Return the median time [s] of one decision; None for what is made for its own earthquakes."""
    if each.policies:
        return decision_time(each.policies[0], scenario)
    if find_controller(each.name).needs_earthquakes:
        return None
    return decision_time(get_controller(each.name, scenario, None, parameters), scenario)
