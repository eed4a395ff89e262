"""Write the reference pages that come from code, and the README's table of results from their files.

    python docs/generate.py

A test holds the pages against what this would write, so that they cannot fall behind.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path[:0] = [
    str(Path(__file__).parents[1]),
    str(Path(__file__).parent),
]  # this checkout, whatever is installed

from generators import DOCS, ROOT, reference, results  # noqa: E402
from generators.api import PACKAGES, api  # noqa: E402
from generators.deployment import deployment_figures  # noqa: E402
from generators.files import files_of_rooms  # noqa: E402

from agents.laboratory.result_files import laboratory_tables  # noqa: E402
from agents.reporting.markdown_blocks import with_block  # noqa: E402
from shake_env.scenario.json_schema import scenario_schema  # noqa: E402
from shake_env.scenario.scenario_writer import SCHEMA_FILE  # noqa: E402

ARCHITECTURE = DOCS / "architecture.md"
SB3_GUIDE = DOCS / "howto" / "train_with_sb3.md"
TRAINING = DOCS / "training.md"
FIELD = DOCS / "scenarios" / "field.md"
CLUSTER = DOCS / "howto" / "cluster.md"
DEPLOY = DOCS / "howto" / "deploy.md"


def pages() -> dict[Path, str]:
    """Return every generated page by its path."""
    made = {
        DOCS / "reference" / "scenarios.md": reference.scenarios(),
        DOCS / "reference" / "tables.md": reference.tables(),
        DOCS / "reference" / "controllers.md": reference.controllers(),
        DOCS / "reference" / "columns.md": reference.columns(),
        DOCS / "reference" / "command-line.md": reference.command_line(),
        ROOT / "shake_env" / "scenario" / SCHEMA_FILE: json.dumps(scenario_schema(), indent=1) + "\n",
        ROOT / "README.md": with_block(ROOT / "README.md", "headline", results.headline()),
        ARCHITECTURE: with_block(ARCHITECTURE, "files", files_of_rooms()),
        SB3_GUIDE: with_block(SB3_GUIDE, "sb3 guide", results.sb3_guide()),
        CLUSTER: with_block(CLUSTER, "execution figures", results.execution_figures()),
        TRAINING: with_block(TRAINING, "gradient noise", results.gradient_noise()),
        FIELD: with_block(FIELD, "adaptation", results.adaptation()),
        DEPLOY: with_block(DEPLOY, "deployment figures", deployment_figures()),
    }
    for page, place, text in (
        (DOCS / "tables.md", "tables compared", results.compared_tables()),
        (DOCS / "planning.md", "planning", results.planning_figures()),
        (DOCS / "updating.md", "laboratory figures", laboratory_tables(DOCS / "results")),
    ):
        if text is not None:
            made[page] = with_block(page, place, text)
    return made | {DOCS / "api" / f"{package}.md": api(package) for package in PACKAGES}


if __name__ == "__main__":
    for path, text in pages().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        print(f"wrote {path.relative_to(ROOT)}")
