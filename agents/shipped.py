"""Policies that come with the package: of each family the best for each scenario."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

SHIPPED = {"policy": "ppo", "analytic": "analytic"}  # name for the commands, and algorithm of its files


def shipped_policy(name: str = "policy", scenario_name: str = "linear") -> Path:
    """Return the file of a policy that comes with the package.

    Parameters
    ----------
    name
        Of `SHIPPED`.
    scenario_name
        Whose policy is asked for. The records are driven by the laboratory's, for nothing is trained on
        them; a scenario without a policy of its own gets the linear table's, if it fits.
    """
    folder = Path(str(resources.files("agents"))) / "pretrained"
    trained = "laboratory" if scenario_name == "records" else scenario_name
    own = folder / f"{trained}-{SHIPPED[name]}.safetensors"
    return own if own.is_file() else folder / f"linear-{SHIPPED[name]}.safetensors"
