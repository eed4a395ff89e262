"""Policies that come with the package: of each family one a scenario.

The seed that did best in training, of the recipe that the scenario is judged by: in `laboratory` the one
that minds the force more than the objective does.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

# Families by their names for the commands, and the algorithms of their files: one of each a scenario.
SHIPPED: dict[str, tuple[str, ...]] = {
    "policy": ("ppo", "recurrent-ppo"),
    "analytic": ("analytic",),
    "off-policy": ("sac", "tqc", "td3"),
}


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
    folder = Path(str(resources.files("agents").joinpath("pretrained")))
    trained = "laboratory" if scenario_name == "records" else scenario_name
    files = [folder / f"{of}-{by}.safetensors" for of in (trained, "linear") for by in SHIPPED[name]]
    return next(file for file in files if file.is_file())
