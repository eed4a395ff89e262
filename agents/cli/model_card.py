"""The command ``shake model-card``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from agents.cli.command_options import CommandOptions


@dataclass(frozen=True, kw_only=True)
class ModelCard(CommandOptions):
    """Write a policy's card: how it was made, its learning curve, its evaluation, its limits of use.

    Where docs/results has a robustness result of its scenario that holds the policy, the card says where
    the policy loses tests and where a classical controller costs less.

    Try:
      shake model-card runs/mine
      shake model-card policy.safetensors --result docs/results/evaluation_linear.json
    """

    policy: tyro.conf.Positional[Path]
    """Run directory or policy file; the card is written beside the file, as *.md and *.png."""
    result: tuple[Path, ...] = ()
    """Result files of shake evaluate that hold a row made of this policy."""
    robustness: Path | None = None
    """Result file of shake robustness (default: docs/results/robustness_SCENARIO.json, if it holds this
    policy)."""
    limits: str = ""
    """Further sentences on limits of use."""

    def run(self, console: Console) -> dict[str, Any]:
        """Write the card."""
        from agents.policies.registry import policy_path
        from agents.reporting.model_card import write_card

        policy = policy_path(str(self.policy))
        robustness = self.robustness or _known_robustness(policy)
        files = write_card(policy, self.result, self.limits, robustness)
        for file in files:
            console.print(f"wrote {file}")
        return {"files": [str(file) for file in files]}


def _known_robustness(policy: Path) -> Path | None:
    from agents.policies.policy_file import file_digest, load_policy
    from agents.reporting.model_card import robustness_of
    from agents.reporting.robustness_tables import PREFIX

    trained = load_policy(policy).card.get("config", {}).get("scenario", {}).get("scenario", "linear")
    file = Path("docs/results") / f"{PREFIX}{trained}.json"
    return file if file.is_file() and robustness_of(file, file_digest(policy)) else None
