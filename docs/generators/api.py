"""The API pages: a package's modules by topic, with their public names."""

from __future__ import annotations

import ast
from pathlib import Path

from generators import NOTE, ROOT

PACKAGES = {
    "shake_env": "Physics and the Gymnasium environment: numpy, SciPy, Gymnasium, array-api-compat.",
    "baselines": "Classical controllers, each a `Controller`.",
    "agents": "Learning, comparison and the command line: what needs torch, SB3 or a terminal.",
}
# Rooms in reading order; modules at the top of a package come first.
TOPICS = {
    "shake_env": (
        "model", "scenario", "motion", "records", "dynamics", "simulation", "safety", "rendering",
        "kernels",
    ),
    "baselines": ("lqr", "estimation", "planning", "servo", "iterative", "analysis"),
    "agents": (
        "policies", "execution", "evaluation", "acceptance", "training", "learning", "experiments",
        "laboratory", "deployment", "reporting", "motions", "studies", "cli",
    ),
}  # fmt: skip


def public_modules(package: str) -> list[str]:
    """Return the dotted names of a package's modules that have a docstring, by topic, then by name."""
    names = []
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__main__" or any(part.startswith("_") for part in parts[:-1]):
            continue
        module = parts[:-1] if parts[-1] == "__init__" else parts
        if ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))):
            names.append(".".join(module))
    order = {topic: number for number, topic in enumerate(TOPICS[package])}
    return sorted(names, key=lambda name: (order.get([*name.split("."), ""][1], -1), name))


def own_names(path: Path) -> list[str]:
    """Return the public functions and classes that a file defines itself."""
    kinds = ast.FunctionDef | ast.ClassDef
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return [node.name for node in body if isinstance(node, kinds) and not node.name.startswith("_")]


def api(package: str) -> str:
    """Return a package's API page: a heading a module, its public names below.

    What a package passes on from its modules stands where it is defined, and there alone.
    """
    text = [f"# API, {package}\n", NOTE, PACKAGES[package] + "\n"]
    for module in public_modules(package):
        text.append(f"::: {module}\n")
        start = ROOT.joinpath(*module.split("."), "__init__.py")
        if start.is_file():
            names = own_names(start)
            listed = f" [{', '.join(names)}]" if names else " false"
            text[-1] += f"    options:\n      members:{listed}\n"
    return "\n".join(text)
