"""The command ``shake sequence``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from agents.cli.command_options import CommandOptions, Flag
from agents.cli.output_path import require_writable_file
from agents.execution.options import ExecutionOptions
from agents.plain_values import typed
from agents.progress import progress_by_name
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from shake_env.errors import FileError, ParameterError


def covered_words(covered: tuple[float, float]) -> str:
    """Return what it means that a log holds some seconds of a motion's, in words."""
    return (
        f"the log covers {covered[0]:.2f} of {covered[1]:.2f} s of the motion: the belief is updated, "
        "and the figures are not compared with the forecast, which is of the whole motion"
    )


@dataclass(frozen=True, kw_only=True)
class SequenceCommand(CommandOptions):
    """A sequence of shakes of rising amplitude on one specimen: plan, next, close; rehearse.

    plan begins one in --folder. next forecasts the next shake and writes the scenario that its
    controller is designed on; a shake that the forecast calls unsafe is refused. close reads its log,
    compares the forecast with it, and updates the belief. rehearse runs all of it on hidden plants.

    Try:
      shake sequence plan --scenario test.toml --folder specimen-7 --controllers lqg tvc
      shake sequence next --folder specimen-7
      shake sequence close --folder specimen-7 --log shake1.h5
      shake sequence rehearse --scenario unknown-specimen --truths 3 --output rehearsal.json
    """

    action: tyro.conf.Positional[Literal["plan", "next", "close", "status", "rehearse"]]
    """What to do."""
    folder: Path = Path("sequence")
    """Folder of the sequence."""
    scenario: str = "unknown-specimen"
    """plan, rehearse: file of the test with its full motion, or a scenario's name."""
    amplitudes: tuple[float, ...] = (0.1, 0.25, 0.5, 0.75, 1.0)
    """plan, rehearse: factors on the motion, rising."""
    controllers: tuple[str, ...] = ("lqg",)
    """plan, rehearse: controllers that the forecasts choose from."""
    prior: Path | None = None
    """plan: first belief, a posterior.json or a TOML file of medians and factors."""
    required_probability: float = 0.95
    """plan: probability with which every limit must be kept."""
    samples: int = 200
    """plan, rehearse: samples of each forecast."""
    override: str | None = None
    """next: reason why an unsafe shake is made all the same."""
    log: Path | None = None
    """close: file of the log."""
    mapping: Path | None = None
    """close: TOML file that says what the columns of a foreign log are."""
    without: tuple[str, ...] = ()
    """close: measured channels that are not used."""
    band: tuple[float, float] | None = None
    """close: lowest and highest frequency that are fitted [Hz]."""
    truths: int = 3
    """rehearse: number of hidden plants."""
    well_specified: Flag = False
    """rehearse: draw them from the prior, not from a wider class of plants."""
    discrepancy: bool = True
    """close, rehearse: whether an error of the model is estimated."""
    output: Path | None = None
    """rehearse: JSON file for the figures; truths that it holds already are not made anew."""
    seed: int = 0
    """plan, rehearse: seed of everything drawn."""
    execution: Annotated[ExecutionOptions, tyro.conf.arg(name="")] = field(
        default_factory=ExecutionOptions
    )

    def run(self, console: Console) -> dict[str, Any]:
        """Do the action and print what came of it."""
        action = {
            "plan": self._plan, "next": self._next, "close": self._close, "status": self._status,
            "rehearse": self._rehearse,
        }[self.action]  # fmt: skip
        return action(console)

    def _plan(self, console: Console) -> dict[str, Any]:
        from agents.laboratory.identification.identify import read_prior
        from agents.laboratory.sequence.steps import plan_sequence

        scenario = ScenarioOptions(self.scenario).build()
        plan_sequence(
            self.folder,
            scenario,
            amplitudes=self.amplitudes,
            controllers=self.controllers,
            prior=None if self.prior is None else read_prior(self.prior, scenario),
            required_probability=self.required_probability,
            samples=self.samples,
            seed=self.seed,
        )
        return self._status(console)

    def _next(self, console: Console) -> dict[str, Any]:
        from agents.laboratory.forecasting.page import forecast_cells, forecast_headings
        from agents.laboratory.sequence.state import read_sequence
        from agents.laboratory.sequence.steps import next_shake

        sequence = read_sequence(self.folder)
        with self.execution.open_runner() as runner, progress_by_name() as on_progress:
            sequence, forecasts = next_shake(
                sequence, override=self.override, runner=runner, on_progress=on_progress
            )
        print_table(console, forecast_headings(), [forecast_cells(each) for each in forecasts], names=2)
        where = self.folder / f"shake_{sequence.number + 1}"
        number, controller = sequence.number + 1, sequence.next.controller
        text = f"Shake {number}: use {controller}, designed on {where}/test.toml"
        console.print(escape(text), soft_wrap=True)
        return self._status(console)

    def _close(self, console: Console) -> dict[str, Any]:
        from agents.laboratory.logs.log_file import read_log
        from agents.laboratory.logs.mapping import read_mapping
        from agents.laboratory.sequence.state import read_sequence
        from agents.laboratory.sequence.steps import close_shake

        if self.log is None:
            raise ParameterError("log", None, "name the file of the shake's log")
        mapping = None if self.mapping is None else read_mapping(self.mapping)
        with progress_by_name() as on_progress:
            sequence, result = close_shake(
                read_sequence(self.folder),
                read_log(self.log, mapping),
                without=self.without,
                band=self.band,
                discrepancy=self.discrepancy,
                on_progress=on_progress,
            )
        last = sequence.shakes[sequence.number - 1]
        assert last.forecast is not None and last.measured is not None and last.inside is not None
        rows = []
        for name, value in last.measured.items():
            low, _, high = last.forecast["intervals"].get(name, (float("nan"),) * 3)
            verdict = {True: "inside", False: "outside", None: "not compared"}[last.inside.get(name)]
            rows.append((name, f"{value:.4g}", f"{low:.4g} to {high:.4g}", verdict))
        print_table(console, ("figure", "measured", "forecast", ""), rows, left=(2, 3))
        if last.covered is not None:
            console.print(escape(covered_words(last.covered)), style="yellow", soft_wrap=True)
        for each in result.unidentified:
            console.print(f"Not identified by the log: {each}", highlight=False, soft_wrap=True)
        return self._status(console)

    def _status(self, console: Console) -> dict[str, Any]:
        from agents.laboratory.sequence.state import read_sequence, state_of

        state = state_of(read_sequence(self.folder))
        rows = [
            (
                str(i),
                f"{each['amplitude']:g}",
                each["controller"] or "",
                each["log"] or "",
                each["override"] or "",
            )
            for i, each in enumerate(state["shakes"], start=1)
        ]
        print_table(console, ("shake", "amplitude", "controller", "log", "override"), rows)
        for i, each in enumerate(state["shakes"], start=1):
            if each["covered"] is not None:
                text = f"Shake {i}: {covered_words(each['covered'])}"
                console.print(escape(text), style="yellow", soft_wrap=True)
        if state["calibration"] is not None:
            share = 100.0 * state["calibration"]
            console.print(
                f"Measured figures within their intervals so far: {share:.0f} %", highlight=False
            )
        return state

    def _rehearse(self, console: Console) -> dict[str, Any]:
        from agents.laboratory.result_files import ResultFile
        from agents.laboratory.sequence.rehearsal import Rehearsal, rehearsal_summary, rehearse_sequences

        scenario = ScenarioOptions(self.scenario).build()
        options: dict[str, Any] = {
            "seed": self.seed,
            "amplitudes": self.amplitudes,
            "controllers": self.controllers,
            "samples": self.samples,
            "wider": not self.well_specified,
            "discrepancy": self.discrepancy,
        }
        if self.output is not None:
            require_writable_file(self.output, "output")
        file = ResultFile(self.output, "shake sequence rehearse", scenario, options)
        try:
            done = [typed(Rehearsal, row) for row in file.rows]
        except ValueError as error:
            remedy = f"holds rows of another version ({error}): name another file"
            raise FileError("output", str(self.output), remedy) from None
        with self.execution.open_runner() as runner, progress_by_name() as on_progress:
            rehearsals = rehearse_sequences(
                scenario,
                truths=self.truths,
                runner=runner,
                done=done,
                on_row=lambda rehearsals: file.write_rows([asdict(each) for each in rehearsals]),
                on_progress=on_progress,
                **options,
            )
        result = rehearsal_summary(rehearsals)
        names = ("coverage", "error_over_informed", "error_over_nominal", "limits_broken", "overridden")
        for name in names:
            console.print(f"{name}: {result[name]}", highlight=False)
        for number, text in result["failed"]:
            console.print(escape(f"truth {number} ended early: {text}"), soft_wrap=True)
        if self.output is not None:
            file.write(result)
            console.print(escape(f"wrote {self.output}"))
        return result
