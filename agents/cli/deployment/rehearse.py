"""The command ``shake rehearse``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from agents.cli.command_options import Flag, FolderOptions
from agents.progress import display, progress_bar
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions

EVERY_FAULT = "all"


@dataclass(frozen=True, kw_only=True)
class Rehearse(FolderOptions):
    """Rehearse a test in real time: the simulated table and its controller as two processes over UDP.

    The controller is the exported C program, or Python. On an injected fault the table holds the last
    command and then brakes; faults are counted and logged.

    Try:
      shake rehearse lqg --scenario laboratory --seconds 60
      shake rehearse lqg --scenario laboratory --control-rate 1000 --seconds 60
      shake rehearse apg --scenario laboratory --runs python --faults all
      shake rehearse lqg --scenario laboratory --tests 1000 --seconds 2 --faults all --unpaced
    """

    controller: tyro.conf.Positional[str] = "lqg"
    """Name of a controller, policy file or run directory."""
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(
        default_factory=lambda: ScenarioOptions(scenario="laboratory")
    )
    runs: Literal["c", "python"] = "c"
    """What the controller's process is."""
    plant: Literal["c", "python"] = "python"
    """What steps the table: the exported C program, or the simulation."""
    safety_supervisor: Flag = False
    """Put the safety supervisor around the controller, in its process."""
    seconds: float | None = None
    """Length of each test [s] (default: the scenario's motion)."""
    tests: int = 1
    """Number of tests, each with an earthquake of its own."""
    faults: tuple[str, ...] = ()
    """Kinds of faults to inject: lost, late, duplicated, reordered, corrupt, "controller dies",
    "sensor sticks"; or all."""
    fault_rate: float = 0.01
    """Share of datagrams with a fault."""
    hold: int = 2
    """Control periods for which the last command is held, before braking."""
    unpaced: Flag = False
    """Run as fast as possible instead of at the clock's rate."""
    seed: int = 0
    """Of the first earthquake and its faults; the next test takes the next."""

    def run(self, console: Console) -> dict[str, Any]:
        """Rehearse, and print what happened."""
        from agents.deployment.rehearsal.faults import FAULTS
        from agents.deployment.rehearsal.rehearse import RehearsalPlan, rehearse

        scenario = self.scenario.build()
        plan = RehearsalPlan(
            runs=self.runs,
            table=self.plant,
            supervised=self.safety_supervisor,
            seconds=self.seconds,
            tests=self.tests,
            faults=FAULTS if EVERY_FAULT in self.faults else self.faults,
            fault_rate=self.fault_rate,
            hold=self.hold,
            paced=not self.unpaced,
            seed=self.seed,
        )
        folder = self.results_folder("rehearsal")
        if plan.paced:
            tests = "one test" if self.tests == 1 else f"{self.tests} tests"
            length = "its whole motion" if self.seconds is None else f"{self.seconds:g} s"
            with display.silenced(f"rehearsal: {tests} of {length}, by the clock: no progress is shown"):
                result = rehearse(self.controller, scenario, plan, folder)
        else:
            with progress_bar() as progress:
                task = progress.add_task("rehearsal", total=1.0)
                result = rehearse(
                    self.controller,
                    scenario,
                    plan,
                    folder,
                    lambda share: progress.update(task, completed=share),
                )
        print_rehearsal(result, console)
        if folder is not None:
            console.print(f"wrote {folder}")
        return result | {"output": None if folder is None else str(folder)}


def print_rehearsal(result: dict[str, Any], console: Console) -> None:
    """Print what happened, for a person."""
    first = result["first_test"]
    console.print(
        f"{result['controller']} ({result['runs']}): {result['tests']} tests, "
        f"{result['periods']} periods of {1e3 * first['period']:g} ms; "
        f"hard limits broken in {result['hard_limits_broken']}",
        highlight=False,
    )
    names = ("median_us", "p99_us", "worst_us")
    rows = [
        (name, *(f"{first[name][key]:.1f}" for key in names))
        for name in ("latency", "jitter")
        if first[name]
    ]
    print_table(console, ("first test", "median [us]", "99 % [us]", "worst [us]"), rows)
    if first["machine"]:
        console.print(_machine(first), highlight=False)
    counts = [(name, str(count)) for name, count in result["events"].items()]
    print_table(console, ("noticed by the table", "periods"), counts or [("nothing", "0")])
    if result["injected"]:
        given = [(name, str(count)) for name, count in result["injected"].items()]
        print_table(console, ("injected", "number"), given)


def _machine(first: dict[str, Any]) -> str:
    """Return what is known of the machine that ran a test, in words."""
    machine, missed = first["machine"], first["deadline_misses_not_injected"]
    before = (
        f"gaps of up to {machine['clock_gap_us']:.0f} us of a loop that only read the clock before it"
    )
    if not machine["real_time"]:
        return f"first test: without real-time priority, which the system did not permit; {before}"
    table, controller = machine["cores"]
    text = f"first test: real-time priority, table on core {table}, controller on {controller}; {before}"
    if machine["stalls"] is None:
        return f"{text}; not watched in it, for want of a higher priority"
    longest, within = machine["longest_stall_us"], first["while_the_machine_stalled"]
    return (
        f"{text}; {machine['stalls']} stalls of up to {longest:.0f} us in it; of {missed} "
        f"deadline misses not injected, {within} in a stall"
    )
