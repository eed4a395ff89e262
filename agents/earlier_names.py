"""Command lines and training configurations of earlier versions, put into the present names."""

from __future__ import annotations

import re
import shlex
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from shake_env.renamed import (
    ALGORITHM,
    COMMANDS,
    CONFIG,
    CONTROLLERS,
    EXPERIMENTS,
    INVERTED,
    LAST,
    OPTIONS,
    RenamedWarning,
    renamed,
)

SECTIONS = ("ppo", "sac", "td3", "tqc", "recurrent_ppo", "apg")  # of a configuration, an algorithm each
REMOVED = {"step_check": False}  # options that are gone, with the value that has no effect


def present_words(words: Sequence[str]) -> list[str]:
    """Return the words of a command line in the present names, with a warning for each old one.

    Names of controllers stay: `agents.policies.registry` takes the old ones, too.
    """
    present: list[str] = []
    command = ""
    for word in words:
        if not command and not word.startswith("-"):
            word = command = renamed("command", word, COMMANDS)
        elif word.startswith("--"):
            word = _present_option(command, word)
        elif present and re.fullmatch(r"--config\.(algorithm|\w+\.base-controller)", present[-1]):
            word = renamed("value", word, CONTROLLERS)
        elif command in ("run-experiments", "tune-training") and "/" in word:
            scenario, _, name = word.rpartition("/")
            word = f"{scenario}/{renamed('experiment', name, EXPERIMENTS)}"
        present.append(word)
    return present


def _present_option(command: str, word: str) -> str:
    """Return ``--name`` or ``--name=value`` with the present name."""
    given, *value = word.split("=", 1)
    *sections, field = given[2:].replace("_", "-").split(".")
    table: Mapping[str, str] = OPTIONS.get(command, {})
    negated, field = field.startswith("no-"), field.removeprefix("no-")
    if sections[:1] == ["config"]:
        sections = ["apg" if section == "analytic" else section for section in sections]
        algorithm = sections[1:] and sections[1].replace("-", "_") in SECTIONS
        fields = ALGORITHM if algorithm else {} if sections[1:] else CONFIG
        table = {old.replace("_", "-"): new.replace("_", "-") for old, new in fields.items()}
        negated ^= bool(algorithm) and field == INVERTED.replace("_", "-")
    field = table.get(field, field)
    present = "--" + ".".join([*sections, f"no-{field}" if negated else field])
    if present == given.replace("_", "-"):
        return word
    return "=".join([renamed("option", given, {given: present}), *value])


def present_command(text: str) -> str:
    """Return a command line, as a policy file holds the one that made it, in the present names."""
    try:
        words = shlex.split(text)
    except ValueError:  # no command line
        return text
    if words[:1] != ["shake"]:
        return text
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RenamedWarning)
        present = present_words(words[1:])
    return text if present == words[1:] else shlex.join(["shake", *present])


def present_config(values: Any) -> Any:
    """Return the plain values of a training configuration by their present names.

    What is no configuration is returned as it is.
    """
    if not isinstance(values, Mapping):
        return values
    present = {CONFIG.get(name, name): value for name, value in values.items()}
    for name in ("algorithm", "init_policy"):
        if name in present:
            present[name] = _present_value(present[name])
    for section in SECTIONS:
        if isinstance(present.get(section), Mapping):
            present[section] = _present_section(present[section])
    return present


def warn_of_old_names(values: Any, source: str) -> None:
    """Warn, in one line, of the old names that a configuration's plain values hold.

    Parameters
    ----------
    values
        What `present_config` takes.
    source
        Where it was read, for the warning.
    """
    if not isinstance(values, Mapping):
        return
    old = {name: CONFIG[name] for name in values if name in CONFIG}
    for section in ("analytic", *SECTIONS):
        if isinstance(options := values.get(section), Mapping):
            old |= {name: ALGORITHM[name] for name in options if name in ALGORITHM}
    if old:
        pairs = ", ".join(f"{name} is now {present}" for name, present in old.items())
        text = f"{source}: {pairs}; the old names work until version {LAST}"
        warnings.warn(text, RenamedWarning, stacklevel=3)


def _present_section(values: Mapping[str, Any]) -> dict[str, Any]:
    present = {ALGORITHM.get(name, name): value for name, value in values.items()}
    present = {name: value for name, value in present.items() if (name, value) not in REMOVED.items()}
    if "base_controller" in present:
        present["base_controller"] = _present_value(present["base_controller"])
    if isinstance(values.get(INVERTED), bool):
        present[ALGORITHM[INVERTED]] = not values[INVERTED]
    return present


def _present_value(value: Any) -> Any:
    return CONTROLLERS.get(value, value) if isinstance(value, str) else value


def present_card(card: Mapping[str, Any]) -> dict[str, Any]:
    """Return the card of a policy file with configuration and command lines in the present names."""
    present = dict(card)
    if "config" in present:
        present["config"] = present_config(present["config"])
    if isinstance(present.get("command"), str):
        present["command"] = present_command(present["command"])
    if isinstance(first := present.get("first"), Mapping) and isinstance(first.get("command"), str):
        present["first"] = {**first, "command": present_command(first["command"])}
    return present
