"""The command ``shake bench``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from agents.command_options import CommandOptions
from agents.output_path import require_writable
from agents.progress import progress_bar
from agents.terminal import print_markdown


@dataclass(frozen=True, kw_only=True)
class Bench(CommandOptions):
    """Run every classical controller on every named scenario. Scenarios that are done are kept.

    Try:
      shake bench --scenarios laboratory --earthquakes 20 --results out/bench
      shake bench --page docs/controllers.md
    """

    scenarios: tuple[str, ...] = ("linear", "laboratory", "unknown-specimen", "yielding", "records")
    """Named scenarios."""
    earthquakes: int = 200
    """Test earthquakes of each; `records` has its six."""
    results: Path = Path("docs/results")
    """Folder of the results, a JSON file each."""
    page: Path | None = None
    """Markdown page whose tables are renewed from all results."""
    again: bool = False
    """Whether scenarios that are done are run again."""

    def run(self, console: Console) -> dict[str, Any]:
        """Run what is not done, and say where it lies."""
        from agents.bench import bench, markdown, put_tables, read_results

        require_writable(self.results, "results")
        found = {}
        for name in self.scenarios:
            file = self.results / f"bench_{name}.json"
            if file.exists() and not self.again:
                found[name] = json.loads(file.read_text(encoding="utf-8"))
                console.print(f"{name}: done before, {file}")
                continue
            with progress_bar() as progress:
                task = progress.add_task(name, total=1.0)

                def told(controller: str, share: float, name: str = name, task: Any = task) -> None:
                    progress.update(task, completed=share, description=f"{name}, {controller}")

                found[name] = bench(name, self.earthquakes, on_progress=told)
            file.write_text(json.dumps(found[name], indent=1) + "\n", encoding="utf-8")
            console.print(f"wrote {file}")
            print_markdown(console, markdown(found[name]))
        if self.page is not None:
            put_tables(self.page, read_results(self.results))
            console.print(f"wrote {self.page}")
        return found
