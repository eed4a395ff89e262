"""The sources of the three packages, for tests that read code."""

from pathlib import Path

ROOT = Path(__file__).parents[2]


def sources():
    """Dotted name and path of every module of the three packages."""
    for package in ("shake_env", "baselines", "agents"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path
