"""The command ``shake adaptation``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import tyro
from rich.console import Console

from agents.cli.command_options import FolderOptions
from agents.progress import progress_bar
from agents.reporting.terminal import print_markdown
from agents.scenario_options import ScenarioOptions
from agents.seeds import VALIDATION_SEED, require_seed
from shake_env.errors import ParameterError

CLASSICAL = ("nmpc", "nmpc-adaptive", "lqg-searched")


@dataclass(frozen=True, kw_only=True)
class Adaptation(FolderOptions):
    """Measure how fast controllers learn a drawn plant: cost over time within an episode.

    The stage cost of each controller in bins of time is divided by that of nmpc-informed, nonlinear
    predictive control that is told the plant of each episode, on the same earthquakes. A ratio that
    falls while the shaking stays the same shows learning. A policy with a memory also runs with its
    memory cleared once: the time until its cost is again that of the policy that kept it is the time
    that the memory needs.

    Try:
      shake adaptation --scenario unknown-specimen --earthquakes 4
      shake adaptation --scenario field --controllers dagger-apg lqg-searched --bin 0.25
      shake adaptation --scenario field --output out/adaptation
    """

    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")] = field(
        default_factory=lambda: ScenarioOptions("field")
    )
    controllers: tuple[str, ...] = ()
    """Names of controllers, or paths of policies (unset: the shipped policies of the scenario, nmpc,
    nmpc-adaptive and lqg-searched)."""
    earthquakes: int = 24
    """Earthquakes of filtered noise. nmpc-adaptive takes about 10 s of processor time for each on field,
    2 s on unknown-specimen; all others together a quarter of that."""
    seed: int = VALIDATION_SEED
    """Seed of the first earthquake; the others follow."""
    bin: float = 0.5
    """Width of a bin of time [s]."""
    clear_time: float = 5.0
    """When memories of policies are cleared [s]."""

    def run(self, console: Console) -> dict[str, Any]:
        """Measure, print, draw."""
        from agents.policies.registry import SHIPPED, policies_trained_for
        from agents.studies.adaptation.result import AdaptationSettings, adaptation, adaptation_table
        from shake_env.files import write_json

        if self.earthquakes < 1:
            raise ParameterError("earthquakes", self.earthquakes, "must be at least 1")
        require_seed(self.seed)
        scenario = self.scenario.build()
        trained = policies_trained_for(scenario.name)
        usual = (*(name for name in reversed(SHIPPED) if name in trained), *CLASSICAL)
        settings = AdaptationSettings(
            controllers=self.controllers or usual,
            earthquakes=self.earthquakes,
            seed=self.seed,
            bin=self.bin,
            clear_time=self.clear_time,
        )
        folder = self.results_folder("adaptation")
        with progress_bar() as bar:
            task = bar.add_task(f"adaptation, {scenario.name}", total=1.0)

            def show(name: str, share: float) -> None:
                bar.update(task, completed=share, description=f"{scenario.name}, {name}")

            result = adaptation(scenario, settings, show)
        print_markdown(console, adaptation_table(result))
        if folder is not None:
            from agents.studies.adaptation.figure import draw_adaptation

            write_json(file := folder / f"adaptation_{scenario.name}.json", result, indent=1)
            for path in (file, *draw_adaptation(result, folder)):
                console.print(f"wrote {path}")
        return result
