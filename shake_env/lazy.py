"""Names of a package that are imported from its modules on first use.

For packages whose modules need libraries that take seconds to load (torch, matplotlib): a name costs
what its own module needs, and importing the package costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

from shake_env.renamed import PYTHON, renamed


def names_of(
    package: str, modules: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], list[str]]:
    """Return ``__getattr__`` and ``__all__`` of a package (PEP 562); old names are understood.

    Parameters
    ----------
    package
        Its ``__name__``.
    modules
        Names by the module of the package that defines them.
    """
    module_of = {name: module for module, names in modules.items() for name in names}

    def get(name: str) -> Any:
        if name in (old := PYTHON.get(package, {})):
            name = renamed(f"{package} name", name, old)
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{module_of[name]}"), name)

    return get, sorted(module_of)
