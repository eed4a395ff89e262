"""Which controllers have a form in C, and why the others have none."""

from __future__ import annotations

from agents.policies.registry import controllers, find_controller
from shake_env.errors import ScenarioError

_SOLVES = "solves an optimisation in each period, with no bound on its iterations"
_DRIVE_FILE = "is a drive file, learnt on repeats of one test"
# Names of `agents.policies.registry.controllers` without a form in C.
NOT_EXPORTED = {
    "mpc": _SOLVES,
    "nmpc": _SOLVES,
    "nmpc-adaptive": _SOLVES,
    "planned": "is made for one record before its test: shake plan writes its currents and feedback",
    "tf-iteration": _DRIVE_FILE,
    "ilc": _DRIVE_FILE,
    "oracle": "is made for the true plant, which no laboratory knows",
}


def exported() -> tuple[str, ...]:
    """Return the names of the controllers that have a form in C."""
    return tuple(name for name in controllers() if name not in NOT_EXPORTED)


def require_exported(name: str) -> None:
    """Raise ScenarioError, with the reason, where a controller has no form in C.

    Parameters
    ----------
    name
        As `find_controller` takes it.
    """
    reason = NOT_EXPORTED.get(find_controller(name).name)
    if reason is not None:
        known = ", ".join(exported())
        raise ScenarioError(
            "controller", name, f"has no C form: it {reason}. Those that have one: {known}, policy files"
        )
