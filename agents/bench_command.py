"""The command ``shake bench``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from agents.progress import progress_bar
from agents.run_directory import require_writable, write_json
from shake_env.errors import ScenarioError, unknown


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Run every classical controller on every named scenario. Scenarios that are done are kept.

    Try:
      shake bench --scenarios laboratory --earthquakes 20
      shake bench --results docs/results --page docs/controllers.md
    """

    scenarios: tuple[str, ...] = ("linear", "laboratory", "unknown-specimen", "yielding", "records")
    """Named scenarios."""
    earthquakes: int = 200
    """Test earthquakes of each; `records` has its six."""
    results: Path = Path("out/bench")
    """Folder of the results, a JSON file each (those of the documentation: docs/results)."""
    page: Path | None = None
    """Markdown page whose tables are renewed from all results."""
    again: bool = False
    """Whether scenarios that are done are run again."""
    json: bool = False
    """Print one JSON object on standard output and nothing else there."""

    def run(self, console: Console) -> dict[str, Any]:
        """Run what is not done, and say where it lies."""
        from agents.bench import (
            SCENARIOS,
            bench,
            markdown,
            put_tables,
            read_result,
            read_results,
            require_asked,
            result_file,
        )

        for name in self.scenarios:
            if name not in SCENARIOS:
                raise unknown(ScenarioError, "scenarios", name, SCENARIOS)
        require_writable(self.results)
        found, known = {}, {}
        for name in self.scenarios:
            file = result_file(self.results, name)
            if file.exists() and not self.again:
                known[name] = read_result(file)
                require_asked(known[name], file, name, self.earthquakes)
        for name in self.scenarios:
            file = result_file(self.results, name)
            if name in known:
                found[name] = known[name]
                console.print(f"{name}: done before, {file}")
                continue
            with progress_bar() as progress:
                task = progress.add_task(name, total=1.0)

                def told(controller: str, share: float, name: str = name, task: Any = task) -> None:
                    progress.update(task, completed=share, description=f"{name}, {controller}")

                found[name] = bench(name, self.earthquakes, on_progress=told)
            write_json(file, found[name], indent=1)
            console.print(f"wrote {file}")
            console.print(markdown(found[name]), highlight=False)
        if self.page is not None:
            put_tables(self.page, read_results(self.results))
            console.print(f"wrote {self.page}")
        return found
