"""The table of the commands, and how their lines are understood. Modules are imported on use."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from agents.cli.command_options import CommandOptions
from agents.scenario_options import SCENARIO_HELP, ScenarioOptions
from shake_env.errors import ParameterError, unknown


@dataclass(frozen=True)
class Command:
    """A command: where its class is, and what it does in a line."""

    module: str
    kind: str  # name of the class
    summary: str

    def load(self) -> type[Any]:
        """Return its class."""
        kind: type[Any] = getattr(importlib.import_module(self.module), self.kind)
        return kind


COMMANDS = {
    "compare": Command(
        "agents.cli.compare", "Compare", "Compare controllers on the same earthquakes."
    ),
    "design": Command("agents.cli.design", "Design", "LQR of a specimen, and its expected errors."),
    "bound": Command(
        "agents.cli.planning.bound", "Bound", "Least cost of an earthquake over all currents, all known."
    ),
    "plan": Command(
        "agents.cli.planning.plan", "Plan", "A record's optimal currents, planned before its test."
    ),
    "identify": Command(
        "agents.cli.laboratory.identify", "Identify", "Identify table and specimen from test logs."
    ),
    "forecast": Command(
        "agents.cli.laboratory.forecast", "ForecastCommand", "Predict errors and peaks of a test."
    ),
    "sequence": Command(
        "agents.cli.laboratory.sequence", "SequenceCommand", "Tests of rising amplitude on one specimen."
    ),
    "calibrate": Command(
        "agents.cli.laboratory.calibrate", "Calibrate", "Test the identification on its own prior."
    ),
    "play": Command("agents.cli.play", "Play", "A simulated test in a window, or as a video."),
    "motion": Command(
        "agents.cli.motion", "Motion", "A recorded motion, and the scale that the table needs."
    ),
    "accept": Command(
        "agents.cli.motion", "Accept", "A measured motion against a required response spectrum."
    ),
    "show-scenario": Command(
        "agents.cli.show_scenario", "ShowScenario", "Every field of a scenario; with --json its file."
    ),
    "list": Command(
        "agents.cli.list_names", "List", "Names of scenarios, controllers, policies and records."
    ),
    "train": Command("agents.cli.train", "Train", "Train a policy."),
    "evaluate": Command(
        "agents.cli.evaluate", "Evaluate", "Policies under the evaluation protocol."
    ),
    "tune": Command("agents.cli.tune", "Tune", "Search a controller's free parameters."),
    "robustness": Command(
        "agents.cli.robustness", "Robustness", "Robustness of controllers to model mismatch."
    ),
    "export": Command(
        "agents.cli.deployment.export", "Export", "A controller as C, as an FMU or as ONNX."
    ),
    "rehearse": Command(
        "agents.cli.deployment.rehearse", "Rehearse", "A controller in real time, with injected faults."
    ),
    "model-card": Command(
        "agents.cli.model_card", "ModelCard", "Model card of a policy: training, evaluation, limits."
    ),
    "benchmark": Command(
        "agents.cli.benchmark", "Benchmark", "Every classical controller on every named scenario."
    ),
    "run-experiments": Command(
        "agents.cli.experiments", "RunExperiments", "Train and evaluate every documented configuration."
    ),
    "update-docs": Command(
        "agents.cli.experiments", "UpdateDocs", "Result files as Markdown tables, or into a page."
    ),
    "tune-training": Command(
        "agents.cli.tune_training", "TuneTraining", "Search a training configuration by short runs."
    ),
    "gradient-noise": Command(
        "agents.cli.studies.gradient_noise",
        "GradientNoiseCommand",
        "How many samples a score-function gradient needs.",
    ),
    "adaptation": Command(
        "agents.cli.studies.adaptation", "Adaptation", "How fast controllers learn a drawn plant."
    ),
    "reproduce": Command(
        "agents.cli.studies.reproduce", "Reproduce", "Tables and figures of Gavin and Hoagg (2009)."
    ),
    "validate-transients": Command(
        "agents.cli.studies.validate_transients",
        "ValidateTransients",
        "Check each response against its physical range.",
    ),
    "plot-components": Command(
        "agents.cli.studies.plot_components",
        "PlotComponents",
        "Figures of yielding, friction and valve.",
    ),
}  # fmt: skip
HELP = ("-h", "--help")
HELP_SCENARIO = "--help-scenario"
COMPLETION = ("--tyro-print-completion", "--tyro-write-completion")
LEADING = ("--json", "--quiet", "--verbose")  # may stand ahead of the command as well


def command_help() -> str:
    """Return the help of ``shake`` itself."""
    width = max(map(len, COMMANDS)) + 2
    lines = [
        "usage: shake [--version] [--help] COMMAND ...",
        "",
        "Shake tables under learned and classical control.",
        "",
        *(f"  {name:<{width}}{command.summary}" for name, command in COMMANDS.items()),
        "",
        "shake COMMAND --help           options of a command, with examples",
        "shake COMMAND --help-scenario  options that change a scenario",
        "shake --tyro-print-completion {bash,zsh,tcsh}   a shell's completion script",
        "",
        "Every command takes --json (one object, nothing else), --quiet and --verbose.",
    ]
    return "\n".join(lines)


def command_of(name: str) -> Command:
    """Return a command by its name.

    Raises
    ------
    ParameterError
        If there is none of that name.
    """
    if name not in COMMANDS:
        raise unknown(ParameterError, "command", name, COMMANDS)
    return COMMANDS[name]


def parse(words: Sequence[str]) -> CommandOptions:
    """Return the command that a line stands for, with its options.

    Help, and a mistake in the options, end in SystemExit, as `tyro.cli` has it.

    Raises
    ------
    ParameterError
        If the command is unknown, or its options contradict each other.
    """
    words = list(words)
    ahead = []
    while words and words[0] in LEADING:
        ahead.append(words.pop(0))
    if not words:
        raise ParameterError("command", None, f"name one: {', '.join(COMMANDS)}")
    name, *rest = words
    if name.startswith("-"):
        raise ParameterError("command", name, "is no option of shake itself: name a command first")
    kind, prog = command_of(name).load(), f"shake {name}"
    if HELP_SCENARIO in rest:
        print_scenario_help(kind, prog)
    brief = brief_scenario(prog) if any(word in HELP for word in rest) else None
    command: CommandOptions = tyro.cli(kind, prog=prog, args=[*rest, *ahead], registry=brief)
    if command.quiet and command.verbose:
        raise ParameterError("quiet", True, "contradicts --verbose: leave one of them out")
    command.check_words([*rest, *ahead])
    return command


def print_completion(words: Sequence[str]) -> None:
    """Print or write the completion script that tyro makes of all commands, and exit."""
    every: dict[str, Callable[..., Any]] = {name: command.load() for name, command in COMMANDS.items()}
    tyro.extras.subcommand_cli_from_dict(every, prog="shake", args=list(words))


def print_scenario_help(kind: type[Any], prog: str) -> None:
    """Print what changes the scenario of a command, and exit."""
    found = scenario_options(kind)
    if found is None:
        raise ParameterError(HELP_SCENARIO.lstrip("-"), prog, "has no scenario options")
    prefix, usual = found
    about = f"Options of {prog} that say what the scenario is, and what to change about it."
    if prefix:
        about += f" Write each as --{prefix}NAME, such as --{prefix}stories 5."
    tyro.cli(ScenarioOptions, prog=prog, description=about, args=["--help"], default=usual)


def scenario_options(kind: type[Any]) -> tuple[str, ScenarioOptions] | None:
    """Return what stands ahead of a command's scenario options, and their defaults; None: no options."""
    for field in fields(kind) if is_dataclass(kind) else ():
        made: Any = field.default if field.default_factory is MISSING else field.default_factory()
        if isinstance(made, ScenarioOptions):
            return "", made
        if field.name == "config":
            return "config.scenario.", made.scenario
    return None


def brief_scenario(prog: str) -> ConstructorRegistry:
    """Return a registry by which help shows one scenario option, and how to find the others."""
    registry = ConstructorRegistry()
    others = len(fields(ScenarioOptions)) - 2  # without the scenario itself, and what no option sets

    @registry.struct_rule
    def rule(info: StructTypeInfo) -> StructConstructorSpec | None:
        if info.type is not ScenarioOptions:
            return None
        text = f"{SCENARIO_HELP} {others} more options change it: {prog} {HELP_SCENARIO} lists them."
        given = info.default  # the command's own, if it has one
        usual = given if isinstance(given, ScenarioOptions) else ScenarioOptions()
        shown = StructFieldSpec("scenario", str, usual.scenario, helptext=text)
        return StructConstructorSpec(ScenarioOptions, (shown,))

    return registry
