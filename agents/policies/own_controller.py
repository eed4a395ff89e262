"""A controller of one's own, named by module and class: ``module:Class`` or ``path/to/file.py:Class``.

The class, or a function, is called with the scenario and returns a `Controller`. Free parameters that
`shake tune` searches stand in its attribute ``tunable``, a mapping of name to ``(low, high, default)``
or `baselines.baseline.Tunable`; it is called with their values by keyword.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from baselines.baseline import Baseline, Tunable
from shake_env.controller import Controller
from shake_env.errors import ParameterError, ScenarioError, ShakeError
from shake_env.scenario.scenario import Scenario

_FORM = "name it module:Class or path/to/file.py:Class"


def is_own_controller(name: str) -> bool:
    """Return whether a word names a module or file and what to take from it."""
    place, separator, attribute = name.rpartition(":")
    return bool(separator and place) and attribute.isidentifier() and not Path(name).exists()


def own_baseline(name: str) -> Baseline:
    """Return a controller of one's own as an entry of a catalogue.

    Importing it runs its code.

    Raises
    ------
    ScenarioError
        If there is no such module, file or attribute, its import fails, or what it has is not callable.
    """
    make = _factory(name)
    return Baseline(
        lambda scenario, **values: _made(name, make, scenario, values),
        (inspect.getdoc(make) or name).partition("\n")[0],
        _tunable(name, getattr(make, "tunable", {})),
    )


def own_source(name: str) -> str:
    """Return a digest of the code of a controller of one's own, by which a search knows it again."""
    file = inspect.getsourcefile(_factory(name))
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ""


def _factory(name: str) -> Callable[..., Any]:
    place, _, attribute = name.rpartition(":")
    module = _from_file(name, Path(place)) if place.endswith(".py") else _from_path(name, place)
    if not hasattr(module, attribute):
        raise ScenarioError("controller", name, f"{place} has no {attribute}: {_FORM}")
    make: Callable[..., Any] = getattr(module, attribute)
    if not callable(make):
        raise ScenarioError("controller", name, "must be a class or a function of a scenario")
    return make


def _from_file(name: str, file: Path) -> ModuleType:
    """Return the module of a file, run once for each state of the file."""
    if not file.is_file():
        raise ScenarioError("controller", name, f"there is no file {str(file)!r}: {_FORM}")
    content = hashlib.sha256(str(file.resolve()).encode() + file.read_bytes()).hexdigest()
    alias = f"shake_own_{content[:16]}"
    if alias in sys.modules:
        return sys.modules[alias]
    spec = importlib.util.spec_from_file_location(alias, file)
    assert spec is not None and spec.loader is not None  # a name that ends with .py has both
    module = importlib.util.module_from_spec(spec)
    sys.modules[alias] = module  # before it runs: its dataclasses look themselves up there
    sys.path.insert(0, str(file.resolve().parent))  # what lies beside it can be imported
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the user's code raises is reported by its line
        del sys.modules[alias]
        raise _refused(name, "its import", error) from error
    finally:
        sys.path.remove(str(file.resolve().parent))
    return module


def _from_path(name: str, module: str) -> ModuleType:
    """Return an importable module; the current folder counts, as for ``python -m``."""
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        return importlib.import_module(module)
    except Exception as error:  # likewise
        raise _refused(name, "its import", error) from error
    finally:
        sys.path.remove(here)


def _tunable(name: str, given: Any) -> dict[str, Tunable]:
    """Return the free parameters that a class declares."""
    if not isinstance(given, Mapping):
        raise ScenarioError("controller", name, "tunable must map names to (low, high, default)")
    tunables = {}
    for each, values in given.items():
        try:
            if not isinstance(values, Tunable):
                low, high, default = map(float, values)
                values = Tunable(low, high, default, logarithmic=low > 0.0)
        except (TypeError, ValueError, ParameterError) as error:
            remedy = f"tunable {each!r} must be low <= default <= high ({error})"
            raise ScenarioError("controller", name, remedy) from error
        tunables[str(each)] = values
    return tunables


def _made(
    name: str, make: Callable[..., Any], scenario: Scenario, values: dict[str, float]
) -> Controller:
    try:
        controller = make(scenario, **values)
    except ShakeError:
        raise
    except Exception as error:  # likewise
        raise _refused(name, "making it", error) from error
    if not isinstance(controller, Controller):
        raise ScenarioError("controller", name, "must make an object with a method predict")
    _try_decisions(name, controller, scenario)
    return controller


def _try_decisions(name: str, controller: Controller, scenario: Scenario) -> None:
    """Let it decide once for one table and for two, at rest: a wrong form is an error at once."""
    for tables in ((), (2,)):
        observation = np.zeros((*tables, scenario.observation.size), dtype=np.float32)
        start = np.ones(tables or 1, dtype=bool)
        try:
            action, _ = controller.predict(observation, None, start, deterministic=True)
            action = np.asarray(action, dtype=np.float64)
        except Exception as error:  # likewise
            raise _refused(name, f"predict, observation of shape {observation.shape},", error) from error
        if action.shape != (*tables, 1) or not np.isfinite(action).all():
            raise ScenarioError(
                "controller",
                name,
                f"for an observation {observation.shape} it returns an action {action.shape}: must be "
                f"{(*tables, 1)}, finite",
            )


def _refused(name: str, what: str, error: Exception) -> ScenarioError:
    at = traceback.extract_tb(error.__traceback__)[-1]
    message = f"{what} raises {type(error).__name__} at {at.filename}:{at.lineno}: {error}"
    return ScenarioError("controller", name, message)
