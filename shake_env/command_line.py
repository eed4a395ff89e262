"""The entry point ``shake``: checks that its packages are this project's before it starts them.

Other distributions have packages called ``agents`` and ``baselines`` as well. Where one of them lies in
the same environment, its files come first or in between, and any message of theirs would mislead.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path

from shake_env.errors import install_hint

UPPER = {"agents": "provenance", "baselines": "catalogue"}  # packages above, a module of each
PACKAGES = ("tyro", "rich")  # of the extra `agents`, without which there is no command line
MISTAKE = 2  # exit code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, or say why it cannot; return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    why = foreign_package() or (None if words == ["--version"] else missing_package())
    if why is not None:
        print(f"shake: {why}", file=sys.stderr)
        return MISTAKE
    if words == ["--version"]:
        print(f"shake-env {sys.modules['shake_env'].__version__}")  # imported by this very module
        return 0
    # By name: the layers above import this one, and not the other way round.
    code: int = importlib.import_module("agents.__main__").main(arguments)
    return code


def foreign_package() -> str | None:
    """Return which upper package is not this project's and what to do, or None."""
    own = Path(__file__).parent.parent
    for package, module in UPPER.items():
        spec = importlib.util.find_spec(package)
        places = [] if spec is None else [Path(each) for each in spec.submodule_search_locations or ()]
        file = None if spec is None else spec.origin  # none in a wheel, an empty one in the source
        empty = file is None or not Path(file).stat().st_size
        if empty and own / package in places and (own / package / f"{module}.py").is_file():
            continue
        where = file or ", ".join(map(str, places)) or "nowhere"
        return (
            f"the package {package!r} that Python finds ({where}) is not this project's: other "
            "distributions have one of that name. Install this project into an environment of its own: "
            "python -m venv .venv, then .venv/bin/python -m pip install '.[agents]' in the folder of "
            "its source"
        )
    return None


def missing_package() -> str | None:
    """Return which package of the command line is not installed and what to do, or None."""
    for package in PACKAGES:
        if importlib.util.find_spec(package) is None:
            return (
                f"the command line needs {package}, which a plain install leaves out; "
                f"{install_hint('agents')}"
            )
    return None
