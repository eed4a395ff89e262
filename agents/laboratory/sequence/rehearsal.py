"""The whole loop against simulated laboratories with hidden plants."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from collections.abc import Sequence as Items
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.perturbations import observation_rescaling
from agents.execution.units import Unit, UnitRunner, report
from agents.laboratory.forecasting.forecast import check_forecast
from agents.laboratory.forecasting.quantities import OutcomeRecorder, Outcomes
from agents.laboratory.identification.parameters import default_prior, plants_at
from agents.laboratory.logs.recorder import LogRecorder
from agents.laboratory.logs.test_log import TestLog
from agents.laboratory.sequence.steps import close_shake, designed_on, next_shake, plan_sequence
from agents.plain_values import typed
from agents.policies.own_controller import is_own_controller, own_source
from agents.policies.registry import get_controller
from agents.seeds import require_seed
from baselines.batch_controllers import Rescaled
from baselines.iterative.transfer_function_iteration import transfer_function_iteration
from shake_env.controller import Controller
from shake_env.errors import ParameterError, ShakeError
from shake_env.model.parameters import FloatArray, Specimen
from shake_env.model.specimen_state import NEW, SpecimenState
from shake_env.model.specimens import specimen_from_matrices
from shake_env.rollout import Earthquake, begin_rollout, run_rollout
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.plants.values import specimen_names
from shake_env.scenario.scenario import UNIFORM, Scenario
from shake_env.scenario.uncertainty import Uncertainty
from shake_env.sequence_env import rising_amplitudes
from shake_env.simulation.engine import BoolArray, StepResult
from shake_env.simulation.simulation import Simulation

UNEQUAL = 0.15  # standard deviation of the logarithm of a storey's stiffness about the others'
STICTION = (1.0, 1.5)  # static over Coulomb friction
SAG = (0.85, 1.0)  # supply pressure over the nominal one
BIAS = 3.0  # of the sensors' own offsets


def hidden_truth(scenario: Scenario, stream: np.random.Generator, *, wider: bool = True) -> Scenario:
    """Return a hidden plant for identification; its sensors are the scenario's.

    Drawn from the scenario's prior. With `wider` what the scenario's uncertainty names is drawn from its
    ranges instead, and the plant lies outside of the model: unequal storeys with Rayleigh damping,
    Stribeck friction, a valve of second order, a supply pressure that sags, and larger offsets of the
    sensors.
    """
    prior = default_prior(scenario)
    plain = replace(scenario, uncertainty=Uncertainty())
    known, ranges = scenario.uncertainty, {}
    if wider and isinstance(known, Uncertainty):
        ranges = known.sample(stream, plain.specimen.stories)
    of_specimen = set(specimen_names(plain.specimen)) if set(ranges) & set(UNIFORM) else set()
    ours = [i for i, name in enumerate(prior.names) if name not in {*ranges, *of_specimen}]
    names = tuple(prior.names[i] for i in ours)
    truth = None
    while truth is None:
        (truth,) = plants_at(plain.with_plant(ranges), names, prior.draw(1, stream)[:, ours])
    if not wider:
        return truth
    specimen = truth.specimen
    factors = np.exp(UNEQUAL * stream.standard_normal(specimen.stories))
    stiffnesses = tuple((np.array(specimen.stiffnesses) * factors).tolist())
    unequal = replace(specimen, stiffnesses=stiffnesses)
    parts, supply = truth.nonlinearity, truth.nonlinearity.valve.supply_pressure
    coulomb = parts.friction.coulomb
    friction = replace(parts.friction, static=coulomb * stream.uniform(*STICTION))
    valve = replace(
        parts.valve.with_pilot_stage(truth.actuator.valve_time_constant),
        supply_pressure=supply * stream.uniform(*SAG),
    )
    sensors = tuple(replace(s, bias=BIAS * s.bias) for s in truth.sensing.sensors or ())
    # Yielding storeys are no matrices: they keep their dampers.
    return replace(
        truth,
        specimen=unequal if parts.yielding.active else _rayleigh(unequal),
        nonlinearity=replace(parts, friction=friction, valve=valve),
        sensing=replace(truth.sensing, sensors=sensors or None),
    )


def _rayleigh(specimen: Specimen) -> Specimen:
    """Return storeys with Rayleigh damping that has their first two modes' ratio."""
    if specimen.stories < 2:
        return specimen
    frequencies = specimen.fixed_base_frequencies[:2].tolist()
    m, k, c = specimen.masses[0], specimen.stiffnesses[0], specimen.dampings[0]
    ratio = c / (2.0 * (m * k) ** 0.5)
    pairs = [(frequency, ratio) for frequency in frequencies]
    return specimen_from_matrices(specimen.mass_matrix, specimen.stiffness_matrix, rayleigh=pairs)


@dataclass(frozen=True)
class Rehearsal:
    """One truth's sequence."""

    truth: int
    values: dict[str, float]  # of the hidden plant
    inside: dict[str, bool]  # outcome of the forecast quantities of every shake, by shake and name
    errors: list[float]  # base-shear error of each shake
    informed: float  # of the full shake under the same controller told the truth
    nominal: float  # of the full shake under the same controller on the nominal specimen
    limits_broken: int
    overridden: int
    damage: float  # energy of the specimen before the last shake, over that of one perfect test [-]
    iteration_damage: float | None  # the same before the last test of a transfer-function iteration
    iteration_error: float | None  # base-shear error of that test; None: it could not be done
    failure: str | None = None


def rehearse_sequences(
    scenario: Scenario,
    *,
    truths: int,
    seed: int = 0,
    amplitudes: Items[float] = (0.1, 0.25, 0.5, 0.75, 1.0),
    controllers: Items[str] = ("lqg",),
    samples: int = 100,
    wider: bool = True,
    discrepancy: bool = True,
    runner: UnitRunner | None = None,
    done: Items[Rehearsal] = (),
    on_row: Callable[[Items[Rehearsal]], None] = lambda rehearsals: None,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> list[Rehearsal]:
    """Run the whole loop on hidden truths; every shake under the supervisor.

    Parameters
    ----------
    scenario
        What the laboratory knows: nominal model, uncertainty, motion of the full shake.
    truths, seed
        Number of hidden plants, and the seed of all that is drawn.
    amplitudes, controllers, samples
        See `plan_sequence`.
    wider
        Whether truths lie outside of the model; False: drawn from the prior.
    discrepancy
        Whether the update knows that its model lacks something.
    runner
        Runs the truths, each a unit; None: this process.
    done
        Of an earlier call with the same arguments, ``truths`` apart; they are not made anew.
    on_row
        Told all rehearsals after each, or, where an executor runs them, at the end.
    on_progress
        Told the share of all shakes done.

    Raises
    ------
    ParameterError
        If `truths` is below 1 or the seed negative, or as `plan_sequence` says.
    ScenarioError
        If a controller is unknown.
    """
    if truths < 1:
        raise ParameterError("truths", truths, "must be at least 1")
    require_seed(seed)
    check_forecast(controllers, rising_amplitudes(amplitudes), samples, 0.9)
    own = [own_source(name) if is_own_controller(name) else None for name in controllers]
    options = (tuple(amplitudes), tuple(controllers), samples, seed, discrepancy, wider)
    rehearsals = list(done)
    numbers = sorted(set(range(truths)) - {each.truth for each in rehearsals})
    units = [
        Unit(f"truth {number + 1}", _one, (scenario, number, options), (scenario, number, options, own))
        for number in numbers
    ]
    shares = dict.fromkeys(numbers, 0.0)

    def on_share_of(number: int, share: float) -> None:
        shares[number] = share
        on_progress("rehearsal", 1.0 - (len(numbers) - sum(shares.values())) / truths)

    runner = runner or UnitRunner()
    alone = runner.executor is None
    parts = [[index] for index in range(len(units))] if alone else [[*range(len(units))]]
    for part in parts if units else []:
        own_numbers = [numbers[index] for index in part]

        def on_share(index: int, share: float, members: list[int] = own_numbers) -> None:
            on_share_of(members[index], share)

        results = runner.run([units[index] for index in part], on_share)
        rehearsals += [typed(Rehearsal, each) for each in results]
        on_row(rehearsals)
    return rehearsals


def _one(
    scenario: Scenario,
    number: int,
    options: tuple[tuple[float, ...], tuple[str, ...], int, int, bool, bool],
) -> dict[str, Any]:
    """Return the rehearsal of one truth by its fields."""
    with tempfile.TemporaryDirectory() as folder:
        return asdict(_rehearsed(scenario, number, Path(folder), *options))


def _rehearsed(
    scenario: Scenario,
    number: int,
    folder: Path,
    amplitudes: Items[float],
    controllers: Items[str],
    samples: int,
    seed: int,
    discrepancy: bool,
    wider: bool,
) -> Rehearsal:
    truth = hidden_truth(scenario, np.random.default_rng([seed, number]), wider=wider)
    sequence = plan_sequence(
        folder / "sequence", scenario, amplitudes=amplitudes, controllers=controllers, samples=samples
    )
    inside: dict[str, bool] = {}
    errors: list[float] = []
    broken = overridden = 0
    specimen, before, energies = NEW, NEW, []
    failure, name = None, controllers[0]
    try:
        for step in range(len(amplitudes)):
            reason = "rehearsal: the truth is simulated"
            sequence, forecasts = next_shake(sequence, override=reason, page=False)
            name = sequence.next.controller or controllers[0]
            overridden += sequence.next.override is not None
            belief = next(each for each in forecasts if each.controller == name)
            design = designed_on(sequence)
            before = specimen
            log, outcomes, specimen = simulate_shake(
                design, truth, name, seed + 100 * number + step, before
            )
            for quantity, column in outcomes.values.items():
                low, _, high = belief.interval(quantity)
                inside[f"{step + 1} {quantity}"] = bool(low <= column[0] <= high)
            energies.append(float(outcomes.values["energy"][0]))
            perfect = energies[-1] / float(outcomes.values["energy_ratio"][0])
            errors.append(float(outcomes.values["base_shear_error"][0]))
            broken += bool(outcomes.broken[0])
            sequence, _ = close_shake(sequence, log, discrepancy=discrepancy)
            report((step + 1) / (len(amplitudes) + 1))
    except ShakeError as error:
        failure = str(error)
    # The same shake on the same specimen: the last one, with the damage that it began with.
    last = seed + 100 * number + len(errors) - 1
    full = {
        which: float(simulate_shake(design, truth, name, last, before)[1].values["base_shear_error"][0])
        for which, design in (("informed", _informed(scenario, truth)), ("nominal", scenario))
    }
    iterated = _iterated(replace(truth, motion=scenario.motion), last)
    return Rehearsal(
        truth=number,
        values=_values(truth),
        inside=inside,
        errors=errors,
        informed=full["informed"],
        nominal=full["nominal"],
        limits_broken=broken,
        overridden=overridden,
        damage=sum(energies[:-1]) / perfect if energies else 0.0,
        iteration_damage=iterated[0],
        iteration_error=iterated[1],
        failure=failure,
    )


def _iterated(truth: Scenario, seed: int) -> tuple[float, float] | tuple[None, None]:
    """Return damage before the last test of a transfer-function iteration, and that test's error.

    The identification and all repeats but the last one are made with the full motion, each on a specimen
    as new. None where a limit stops the identification.
    """
    quake = [Earthquake("shake", truth.motion, seed)]
    try:
        made = transfer_function_iteration(truth, quake)
    except ShakeError:
        return None, None
    *before, last = made.tests.repeats
    measured = [] if made.identification is None else [made.identification]
    taken = sum(float(test.energy[0]) for test in [*measured, *before])
    return taken / float(last.perfect_energy[0]), float(last.shear_error[0])


def simulate_shake(
    design: Scenario, truth: Scenario, name: str, seed: int, specimen: SpecimenState = NEW
) -> tuple[TestLog, Outcomes, SpecimenState]:
    """Run a supervised test of a controller on a hidden plant.

    Parameters
    ----------
    design
        What the controller is designed on, with the motion.
    truth
        The plant.
    name
        Of the controller.
    seed
        Of the noise.
    specimen
        Damage at the start.

    Returns
    -------
    log, outcomes, specimen
        Of one test, and the damage after it.
    """
    design = replace(design, uncertainty=Uncertainty())
    plant = replace(truth, motion=design.motion)
    quakes = [Earthquake("shake", design.motion, seed, specimen)]
    controller: Controller = Supervised(get_controller(name, design), design)
    recorder = LogRecorder(design, quakes, plant=plant)
    driver = Rescaled(controller, observation_rescaling(plant, design))
    simulation, observation = begin_rollout(plant, quakes)
    outcome = OutcomeRecorder(design, 1, plant=plant, drifts=simulation.first_drifts)
    end = EndOfTest(simulation)
    run_rollout(driver, simulation, observation, [recorder, outcome, end])
    after = specimen.after(*end.specimens, *outcome.energy[:, 0])
    return recorder.logs()[0], outcome.outcomes(), after


class EndOfTest:
    """Holds ``[x_r, x_r', s]`` of the one specimen and its reference when their test ends."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.specimens: tuple[FloatArray, FloatArray] = (np.zeros(0), np.zeros(0))

    def add(self, result: StepResult, running: BoolArray) -> None:
        """Look at the specimens where the period was the last."""
        if result.ended and running[0]:
            own, reference = self._simulation.specimens
            self.specimens = own[0], reference[0]


def _informed(scenario: Scenario, truth: Scenario) -> Scenario:
    """Return the truth as a design takes it: with the laboratory's motion and sensors."""
    return replace(truth, motion=scenario.motion, sensing=scenario.sensing)


def _values(truth: Scenario) -> dict[str, float]:
    specimen = truth.specimen
    return {
        "mass_ratio": specimen.mass / truth.actuator.table_mass,
        "first_frequency": float(specimen.fixed_base_frequencies[0]),
        "coulomb_friction": truth.nonlinearity.friction.coulomb,
    }


def rehearsal_summary(rehearsals: Items[Rehearsal]) -> dict[str, Any]:
    """Return the figures of rehearsals as plain JSON values."""
    done = [each for each in rehearsals if each.failure is None]
    by_quantity: dict[str, list[bool]] = {}
    for each in done:
        for key, flag in each.inside.items():
            by_quantity.setdefault(key.partition(" ")[2], []).append(flag)
    flags = [flag for column in by_quantity.values() for flag in column]
    ratios = [each.errors[-1] / each.informed for each in done]
    against = [each.errors[-1] / each.nominal for each in done]
    return {
        "truths": len(rehearsals),
        "failed": [[each.truth, each.failure] for each in rehearsals if each.failure is not None],
        "coverage": float(np.mean(flags)) if flags else None,
        "coverage_by_quantity": {name: float(np.mean(column)) for name, column in by_quantity.items()},
        "error_over_informed": _quantiles(ratios),
        "error_over_nominal": _quantiles(against),
        "limits_broken": sum(each.limits_broken for each in rehearsals),
        "damage": _quantiles([each.damage for each in done]),
        "iteration_damage": _quantiles(
            [each.iteration_damage for each in done if each.iteration_damage is not None]
        ),
        "iteration_error": _quantiles(
            [each.iteration_error for each in done if each.iteration_error is not None]
        ),
        "error": _quantiles([each.errors[-1] for each in done]),
        "overridden": sum(each.overridden for each in rehearsals),
        "rows": [asdict(each) for each in rehearsals],
    }


def _quantiles(values: list[float]) -> list[float] | None:
    return np.quantile(values, [0.05, 0.5, 0.95]).tolist() if values else None
