"""A controller, by its name or as an object, as a program."""

from __future__ import annotations

import math
from typing import Any

import shake_env
from agents.deployment.channels import current_channel, identifier, observation_channels
from agents.deployment.exported import require_exported
from agents.deployment.laws import NONLINEAR_FILTER, block_of
from agents.deployment.program import Precision, Program
from agents.policies.policy_file import file_digest
from agents.policies.registry import find_controller, get_controller, policy_path, values_for
from agents.provenance import code_version
from baselines.planning.nonlinear_estimate import NonlinearEstimate
from shake_env.controller import Controller
from shake_env.errors import ScenarioError
from shake_env.model.nonlinearity import ServoValve
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.digest import known_name, scenario_digest
from shake_env.scenario.scenario import Scenario


def controller_program(
    name: str,
    scenario: Scenario,
    *,
    supervised: bool = False,
    precision: Precision = "float64",
    prefix: str | None = None,
) -> tuple[Program, Controller]:
    """Return a controller of a name as a program, and the controller itself.

    Parameters
    ----------
    name
        As `agents.policies.registry.get_controller` takes it.
    scenario
        What it drives.
    supervised
        Whether the safety supervisor is put around it.
    precision
        Of the arithmetic.
    prefix
        Of functions and types; None: `usual_prefix`.

    Raises
    ------
    ScenarioError
        If the controller does not suit the scenario, or has no form in C.
    """
    require_exported(name)
    controller = get_controller(name, scenario)
    if isinstance(controller, NonlinearEstimate):
        raise ScenarioError("controller", name, NONLINEAR_FILTER)
    provenance = {
        "program": f"shake-env {shake_env.__version__}, {code_version() or 'not a git checkout'}",
        "controller": name,
        "scenario": f"{scenario.name}, digest {scenario_digest(scenario)}",
    }
    entry = find_controller(name)
    if entry.kind in ("shipped", "file"):
        provenance["policy"] = f"sha256 {file_digest(policy_path(name, known_name(scenario)))}"
    values = values_for(name, scenario)
    if values is not None:
        given = ", ".join(f"{key}={value:.6g}" for key, value in values.parameters.items())
        provenance["parameters"] = f"{values.description}: {given}" if given else values.description
    if supervised:
        controller = Supervised(controller, scenario)
        provenance["supervisor"] = "around the controller"
    prefix = prefix or usual_prefix(name, scenario, precision, supervised)
    title = f"Controller {name} of a shake table, scenario {scenario.name}"
    return as_program(controller, scenario, prefix, title, provenance, precision), controller


def usual_prefix(name: str, scenario: Scenario, precision: Precision, supervised: bool = False) -> str:
    """Return the prefix of an export: controller and scenario, supervisor and single precision.

    Exports that differ in one of these can be linked into one program. Those of one scenario under
    other options have the same; they need prefixes of their own.
    """
    words = [name.rstrip("/").rsplit("/", 1)[-1], scenario.name]
    words += ["supervised"] * supervised + [precision] * (precision != "float64")
    return identifier("_".join(words)).lower()


def as_program(
    controller: Controller,
    scenario: Scenario,
    prefix: str,
    title: str,
    provenance: dict[str, str],
    precision: Precision = "float64",
) -> Program:
    """Return a controller object as a program; arguments as of `controller_program` and `Program`."""
    return Program(
        name=prefix,
        title=comment_text(title),
        block=block_of(controller, scenario),
        inputs=observation_channels(scenario),
        outputs=(current_channel(scenario),),
        period=scenario.control_period,
        accepts_any_input=isinstance(controller, Supervised),
        provenance={key: comment_text(text) for key, text in provenance.items()},
        valve=valve_numbers(scenario.nonlinearity.valve),
        precision=precision,
    )


def valve_numbers(valve: ServoValve) -> dict[str, Any]:
    """Return what the opening of a servovalve depends on; None where nothing limits it."""
    limits = {name: getattr(valve, name) for name in ("spool_limit", "supply_pressure")}
    numbers = {name: value if math.isfinite(value) else None for name, value in limits.items()}
    return {
        **numbers,
        "dead_band": valve.dead_band,
        "missing": valve.missing,
        "rated": valve.rated,
        "supply_sag": valve.supply_sag,
    }


def comment_text(text: str) -> str:
    """Return a text that may stand in a C comment and a C string."""
    return text.replace("\\", "/").replace('"', "'").replace("*/", "* /").replace("\n", " ")
