"""The command ``shake robustness``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import FolderOptions, print_notes, tuned_values
from agents.execution.options import ExecutionOptions
from agents.plain_values import plain
from agents.progress import progress_by_name
from agents.reporting.terminal import print_markdown
from agents.scenario_options import ScenarioOptions, given_options
from agents.seeds import ROBUSTNESS_SEED
from shake_env.errors import ParameterError

# What docs/robustness.md shows.
SHOWN = ("linear", "as-printed", "laboratory", "unknown-specimen", "yielding")


@dataclass(frozen=True, kw_only=True)
class Robustness(FolderOptions):
    """Measure the robustness of controllers to perturbed tables, specimens, loops and motions.

    Specimen mass, storey frequency, damping, friction, loop delay, sensor noise and amplitude are
    changed one at a time and in pairs; no controller is redesigned. Costs are relative to the
    reference's under the same change. A test counts as lost if a limit ended it, or if its acceleration
    error exceeded that of an uncontrolled table.

    Try:
      shake robustness
      shake robustness --scenario laboratory --controllers lqg lqg-searched apg --perturb delay
      shake robustness --controllers lqr runs/mine --earthquakes 20 --output out/mine
      shake robustness --all
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    controllers: tuple[str, ...] | None = None
    """Names as shake compare takes them, or paths of policies (default: the policies that ship for the
    scenario, its reference and the best of its classical controllers)."""
    tuned: Path | None = None
    """File of tuned values, made by shake tune --output. They belong to the scenario as it stands, which
    every controller is designed on, not to what is changed in it."""
    perturb: tuple[str, ...] = ()
    """What is changed: mass_ratio, storey_frequency, damping_ratio, coulomb_friction, delay, noise,
    amplitude (default: all)."""
    maps: bool = True
    """Whether pairs of them are changed together, too, which takes half of the time."""
    earthquakes: int = 8
    """Number of filtered-noise earthquakes, the same everywhere; `records` has its six."""
    seed: int = ROBUSTNESS_SEED
    """Seed of the first of them."""
    execution: Annotated[ExecutionOptions, tyro.conf.arg(name="")] = field(
        default_factory=ExecutionOptions
    )
    all: bool = False
    """Renew docs/robustness.md: every scenario on it with its results and figures, 45 minutes.
    A scenario is skipped where policies and settings are unchanged and every controller has its
    earlier cost on the unperturbed scenario."""
    rerun: bool = False
    """With --all: run every scenario in any case."""

    def run(self, console: Console) -> dict[str, Any]:
        """Run, print, write."""
        if self.all:
            return self._renew(console)
        from agents.evaluation.controller_set import require_names
        from agents.reporting.robustness_figures import draw_robustness
        from agents.reporting.robustness_tables import PREFIX, robustness_section, write_robustness

        if self.controllers is not None:
            require_names(self.controllers)
        scenario = self.scenario.build()
        folder = self.results_folder("robustness")
        result = _measure(self, self.scenario)
        print_markdown(console, robustness_section(result))
        print_notes(result, console)
        for reason in result["skipped"]:
            console.print(f"left out: {reason}")
        if folder is not None:
            file = folder / f"{PREFIX}{scenario.name}.json"
            write_robustness(result, file)
            for path in (file, *draw_robustness(result, folder)):
                console.print(f"wrote {path}")
        return result

    def _renew(self, console: Console) -> dict[str, Any]:
        from agents.reporting.markdown_blocks import put_block
        from agents.reporting.robustness_figures import draw_robustness
        from agents.reporting.robustness_tables import (
            PREFIX,
            read_robustness,
            robustness_section,
            write_robustness,
        )

        usual = type(self)()
        for name in ("scenario", "controllers", "perturb", "output", "tuned"):
            if getattr(self, name) != getattr(usual, name):
                raise ParameterError(
                    name, getattr(self, name), "contradicts --all: leave one of them out"
                )
        page, written = Path("docs/robustness.md"), []
        if not page.is_file():
            raise ParameterError("page", str(page), "is not here: run --all in the project's folder")
        for name in SHOWN:
            file = page.parent / "results" / f"{PREFIX}{name}.json"
            options = ScenarioOptions(name)
            known = read_robustness(file) if file.is_file() and not self.rerun else {}
            if not _holds(known, self, options):
                write_robustness(_measure(self, options), file)
            else:
                console.print(f"{name}: as before, {file}")
            result = read_robustness(file)
            pictures = [p for p in draw_robustness(result, page.parent / "figures", svg=False)]
            shown = robustness_section(result, [p.relative_to(page.parent) for p in pictures])
            put_block(page, f"robustness {name}", shown, end=name)
            written += [str(path) for path in (file, *pictures)]
            console.print(f"wrote {file} and {len(pictures)} figures")
        console.print(f"wrote {page}: then renew the cards with shake model-card")
        return {"page": str(page), "written": written}


def _measure(command: Robustness, options: ScenarioOptions) -> dict[str, Any]:
    from agents.evaluation.robustness import Grid, robustness

    scenario = options.build()
    progress = progress_by_name(f"{scenario.name}, ")
    with command.execution.open_runner() as runner, progress as on_progress:
        result = robustness(
            scenario,
            command.controllers or (),
            tuned=tuned_values(command.tuned),
            grid=Grid.from_scenario(scenario, command.perturb, command.maps),
            earthquakes=command.earthquakes,
            seed=command.seed,
            runner=runner,
            on_progress=on_progress,
        )
    return result | {"identity": _identity(command, options)}


def _holds(known: dict[str, Any], command: Robustness, options: ScenarioOptions) -> bool:
    """Return whether a result is what the code of today would find, by what costs a hundredth of it."""
    from agents.evaluation.robustness import Grid, robustness

    if known.get("identity") != _identity(command, options):
        return False
    nothing = Grid(sweeps={}, maps=(), coarse={})
    today = robustness(
        options.build(), command.controllers or (), grid=nothing, earthquakes=command.earthquakes,
        seed=command.seed,
    )  # fmt: skip
    now, before = (result["points"][0]["cost"] for result in (today, known))
    # Side by side with other tables a product rounds otherwise, and friction makes that larger.
    return all(math.isclose(now[name], before[name], rel_tol=1e-3) for name in before)


def _identity(command: Robustness, options: ScenarioOptions) -> dict[str, Any]:
    """Return what a result depends on but for the code: it holds as long as these are the same."""
    from agents.evaluation.robustness import Grid, controllers_with_sources

    scenario = options.build()
    tuned = tuned_values(command.tuned)
    chosen, sources = controllers_with_sources(command.controllers or (), scenario, tuned)
    grid = Grid.from_scenario(scenario, command.perturb, command.maps)
    return plain(
        {
            "scenario": given_options(options.__dict__),
            "controllers": list(chosen.controllers),
            "policies": {name: source["sha256"] for name, source in sources.items()},
            "earthquakes": command.earthquakes,
            "seed": command.seed,
            "sweeps": grid.sweeps,
            "maps": [[grid.coarse[name] for name in pair] for pair in grid.maps],
        }
    )
