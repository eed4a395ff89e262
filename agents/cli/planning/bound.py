"""The command ``shake bound``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import FolderOptions
from agents.progress import progress_bar
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions

EARTHQUAKES = 4  # where no seeds are given


@dataclass(frozen=True, kw_only=True)
class Bound(FolderOptions):
    """Find the least cost of each earthquake over all currents, everything known: a true bound.

    No controller costs less on the same earthquake. The optimum is found from the currents of two
    controllers; where both end at one cost, it can be trusted. Beside it stands what the scenario's
    reference costs and, where theory gives it, the least expected cost of any law with the scenario's
    own information.

    Try:
      shake bound --scenario laboratory
      shake bound --scenario yielding --seeds 4000000 4000004 --json
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(default_factory=ScenarioOptions)
    seeds: tuple[int, int] | None = None
    """Seeds of the earthquakes: from the first to the one before the second (unset: the first four test
    earthquakes). A scenario of recorded motions has its own earthquakes, numbered from 0 (unset: all of
    them)."""

    def run(self, console: Console) -> dict[str, Any]:
        """Find, print, draw."""
        from agents.evaluation.bound import bound_of, default_seeds, seeded_earthquakes
        from agents.reporting.bound_notes import disagreement_note

        scenario = self.scenario.build()
        first, end = self.seeds or default_seeds(scenario, EARTHQUAKES)
        quakes = seeded_earthquakes(scenario, first, end)
        folder = self.results_folder("bound")
        with progress_bar() as bar:
            task = bar.add_task(f"bound, {scenario.name}", total=1.0)
            result = bound_of(scenario, first, end, lambda share: bar.update(task, completed=share))
        rows = [
            (
                name,
                f"{cost:.6g}",
                f"{reference:.6g}",
                f"{reference / cost:.3f}",
                f"{100 * disagreement:.3f} %",
                f"{seconds:.2f} s",
            )
            for name, cost, reference, disagreement, seconds in zip(
                result["earthquakes"],
                result["costs"],
                result["reference_costs"],
                result["disagreements"],
                result["seconds"],
                strict=True,
            )
        ]
        heading = ("earthquake", "bound", result["reference"], "ratio", "starts differ", "time")
        print_table(console, heading, rows)
        for note in disagreement_note(result["disagreements"]):
            console.print(note.replace("**", ""), highlight=False)
        causal = result["causal_bound"]
        console.print(f"causal bound: {causal['text']}", highlight=False)
        if folder is not None:
            from agents.evaluation.bound_store import best_episodes
            from agents.reporting.figures.bound import draw_optimum

            for path in draw_optimum(best_episodes(scenario, quakes[:1])[0], folder):
                console.print(f"wrote {path}")
        return result
