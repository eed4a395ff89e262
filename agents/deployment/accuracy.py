"""An exported program beside its Python controller: decisions, costs, refusals, memory checks."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.deployment.c_source import write_program
from agents.deployment.compiled import CompiledController, CompiledProgram, build_test
from agents.deployment.controller_program import controller_program
from agents.deployment.program import Program
from agents.deployment.recorded import RecordedDecisions, record_decisions
from agents.deployment.widened import to_float64
from shake_env.controller import Controller, decide
from shake_env.errors import NumericalError
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.scenario.scenario import Scenario

EXACT, SINGLE, COST = 1e-9, 1e-4, 1e-3  # of the action's range, and of a test's cost
# Sensors that round, a supervisor that leaves out a reading where chi^2 > 36, and friction that holds a
# table make loops in which runs that differ in the last bit of an action part, in double precision too.
# Where a cost in single precision differs by more than `COST`, it must lie in the range of the costs of
# such runs within `COST`. One run more lies outside of the range of n such runs with probability
# 2 / (n + 1): of 12 every seventh would, of 99 every fiftieth.
LAST_BIT, PERTURBED = 1e-7, 99  # relative change of an action, and number of such runs
# A result within rounding of the middle between two float32 numbers may fall to either side, in Python
# and in C. Such an action differs by one step of float32, and is the exception.
STEP, EXCEPTIONS = 1.2e-7, 1e-4
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
COMPILERS = ("gcc", "clang")
EARTHQUAKES = 10
PERIODS, RECORDS_PERIODS = 2000, 6000  # that are compared: 10 s at 200 Hz, of a scenario of records 30 s


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """A program beside its controller in one scenario; differences are of the action's range."""

    scenario: str
    controller: str
    decisions: int  # compared on earthquakes
    largest: float  # difference in double precision
    exceptions: int  # decisions that differ by more than `EXACT`
    single: float  # largest difference in single precision
    cost: float  # largest relative difference of a test's cost, single precision in the loop
    nearest: (
        float  # likewise from the nearest of the runs perturbed by `LAST_BIT`, Python's own included
    )
    costs: int  # earthquakes whose costs are compared
    parted: float  # largest relative difference of a perturbed run's cost; 0 where none was needed
    random: int  # random observations, with NaN and infinities
    random_largest: float  # difference on the finite ones
    random_refused: int
    checked: tuple[str, ...]  # sanitized compilers and valgrind, under which it ran without a finding

    @property
    def good(self) -> bool:
        """Whether every difference is within its bound."""
        return (
            max(self.largest, self.random_largest) <= STEP
            and self.exceptions <= EXCEPTIONS * self.decisions
            and self.single < SINGLE
            and self.nearest < COST
        )


def agreement(
    name: str,
    scenario: Scenario,
    *,
    supervised: bool = False,
    earthquakes: int = EARTHQUAKES,
    looped: int = EARTHQUAKES,
    random: int = 3000,
) -> Agreement:
    """Compare a controller's program with the controller.

    Parameters
    ----------
    name, scenario, supervised
        As for `controller_program`.
    earthquakes
        On which decisions are compared: filtered noise and the embedded records.
    random
        Number of random observations.

    Raises
    ------
    ScenarioError
        If the controller does not suit the scenario, or has no form in C.
    NumericalError
        If the program refuses what it must take, takes what it must refuse, or a memory check has a
        finding.
    """
    program, controller = controller_program(name, scenario, supervised=supervised)
    quakes = compared_earthquakes(scenario, earthquakes)
    single = CompiledController(replace(program, precision="float32"))
    costs = compared_costs(program, controller, scenario, quakes[:looped])
    reference = to_float64(controller)
    periods = RECORDS_PERIODS if scenario.reserved_for_testing else PERIODS
    decisions = record_decisions(reference, scenario, quakes, periods)
    double = CompiledProgram(program)
    difference = action_differences(double, decisions)
    rows = random_observations(scenario, random)
    outputs, codes = double.step(double.begin(random), rows)
    finite = np.isfinite(rows).all(axis=1)
    expected = np.zeros(random, dtype=int) if supervised else np.where(finite, 0, 1)
    if (codes != expected).any() or outputs[codes != 0].any():
        raise NumericalError(program.name, codes.tolist()[:20], "refused or took the wrong observations")
    with np.errstate(all="ignore"):
        actions, _ = decide(reference, rows)
    taken = codes == 0
    return Agreement(
        scenario=scenario.name,
        controller=name + (" + supervisor" if supervised else ""),
        decisions=difference.size,
        largest=float(difference.max()),
        exceptions=int(np.sum(difference > EXACT)),
        single=float(action_differences(single, decisions).max()),
        random=random,
        random_largest=float(np.abs(outputs[taken] - actions[taken]).max()),
        random_refused=int(np.sum(~taken)),
        checked=memory_checks(program, decisions, rows[:: max(random // 300, 1)]),
        **costs,
    )


@dataclass
class LastBit:
    """A controller whose actions are changed at random by about their last bit in float32."""

    controller: Controller
    rng: np.random.Generator

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the controller's action (..., 1) times 1 + `LAST_BIT` normal numbers, and its state."""
        action, state = self.controller.predict(observation, state, episode_start, deterministic)
        change = 1.0 + LAST_BIT * self.rng.standard_normal(action.shape)
        return (action * change).astype(np.float32), state


def compared_earthquakes(scenario: Scenario, number: int) -> list[Earthquake]:
    """Return filtered noise, as much as is needed, and the embedded records."""
    records = recorded_earthquakes(scenario)
    return [*noise_earthquakes(scenario, max(number - len(records), 0)), *records][:number]


def compared_costs(
    program: Program, controller: Controller, scenario: Scenario, earthquakes: Sequence[Earthquake]
) -> dict[str, Any]:
    """Return `cost`, `nearest`, `parted` and `costs` of an `Agreement`; arguments as there."""
    single = CompiledController(replace(program, precision="float32"))
    given, own = (
        np.array([row.cost for row in rollout(each, scenario, earthquakes)[0]])
        for each in (single, controller)
    )
    cost = nearest = np.abs(given / own - 1.0)
    parted = np.zeros(1)
    if cost.max() >= COST:
        perturbed = perturbed_costs(controller, scenario, earthquakes)
        every = np.vstack([own, perturbed])
        nearest = np.abs(given - np.clip(given, every.min(axis=0), every.max(axis=0))) / own
        parted = np.abs(perturbed / own - 1.0)
    largest = {"cost": cost, "nearest": nearest, "parted": parted}
    return {name: float(each.max()) for name, each in largest.items()} | {"costs": len(own)}


def perturbed_costs(
    controller: Controller, scenario: Scenario, earthquakes: Sequence[Earthquake]
) -> FloatArray:
    """Return costs (`PERTURBED`, earthquakes) of a controller whose actions differ in the last bit."""
    perturbed = LastBit(controller, np.random.default_rng(0))
    tests, _ = rollout(perturbed, scenario, [*earthquakes] * PERTURBED)
    return np.array([row.cost for row in tests]).reshape(PERTURBED, len(earthquakes))


def action_differences(compiled: CompiledProgram, decisions: RecordedDecisions) -> FloatArray:
    """Return the difference of each decision (periods, tables) from the recorded one."""
    memory = compiled.begin(decisions.actions.shape[1])
    difference = np.empty(decisions.actions.shape)
    for k, (fresh, shown) in enumerate(zip(decisions.fresh, decisions.observations, strict=True)):
        outputs, codes = compiled.step(memory, shown, fresh)
        if codes.any():
            raise NumericalError(compiled.program.name, codes.tolist(), f"refused period {k}")
        difference[k] = np.abs(outputs[:, 0] - decisions.actions[k])
    return difference


def random_observations(scenario: Scenario, number: int, seed: int = 0) -> NDArray[np.float32]:
    """Return random observations (number, n): ordinary, at the bounds, NaN, infinite, subnormal."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((number, scenario.observation.size)).astype(np.float32)
    n = number // 6
    rows[:n] *= OBSERVATION_BOUND
    rows[n : 2 * n] = np.sign(rows[n : 2 * n]) * OBSERVATION_BOUND
    rows[2 * n : 3 * n] *= 1e-40
    for block, value in ((3, np.nan), (4, np.inf), (5, -np.inf)):
        for row in rows[block * n : (block + 1) * n]:
            row[rng.integers(0, len(row), 1 + rng.integers(3))] = value
    return np.clip(rows, -OBSERVATION_BOUND, OBSERVATION_BOUND, where=np.isfinite(rows), out=rows)


def run_test_program(
    test: Sequence[str | Path], fresh: NDArray[Any], observations: NDArray[Any], outputs: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Return codes (periods,) and outputs (periods, outputs) of a compiled test program.

    Parameters
    ----------
    test
        Command of the test program.
    fresh, observations
        (periods,) and (periods, n) of one table.
    outputs
        Number of the program's outputs.

    Raises
    ------
    NumericalError
        If it ends with an error, as it does on a finding of a sanitizer or of valgrind.
    """
    rows = np.column_stack([fresh, observations]).astype(np.float64)
    command = [*map(str, test), "--stream"]
    done = subprocess.run(command, input=rows.tobytes(), capture_output=True, check=False)
    if done.returncode:
        output = done.stderr.decode(errors="replace")[-3000:]
        raise NumericalError("test program", Path(command[-2]).name, f"failed: {output}")
    answer = np.frombuffer(done.stdout).reshape(len(rows), outputs + 1)
    return answer[:, 0], answer[:, 1:]


def memory_checks(
    program: Program, decisions: RecordedDecisions, rows: NDArray[np.float32], periods: int = 400
) -> tuple[str, ...]:
    """Run a program's test under sanitizers and valgrind; return the names of those that were there.

    It repeats its recording, then takes periods of the first table and random observations.

    Raises
    ------
    NumericalError
        If there is a finding.
    """
    checked = []
    shown, actions = decisions.observations[:, 0], decisions.actions[:, :1]
    stream = np.concatenate([shown[:periods], rows])
    fresh = np.concatenate([decisions.fresh[:periods, 0], np.zeros(len(rows), dtype=bool)])
    with tempfile.TemporaryDirectory() as folder:
        write_program(program, folder, shown[:9].astype(float), actions[:9].astype(float))
        for cc in COMPILERS:
            if path := shutil.which(cc):
                test = build_test(folder, program.name, SANITIZED, path)
                done = subprocess.run([str(test)], capture_output=True, text=True, check=False)
                if done.returncode or not done.stdout.startswith("ok"):
                    raise NumericalError(cc, program.name, (done.stdout + done.stderr)[-2000:])
                run_test_program([test], fresh, stream)
                checked.append(cc)
        if shutil.which("valgrind"):
            test = build_test(folder, program.name, ("-O1", "-g"))
            command: list[str | Path] = [
                "valgrind",
                "--error-exitcode=9",
                "--leak-check=full",
                "-q",
                test,
            ]
            run_test_program(command, fresh, stream)
            checked.append("valgrind")
    return tuple(checked)
