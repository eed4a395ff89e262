"""What is installed with the project stands under licences that allow an MIT project to use it."""

import importlib.metadata
import re
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

# Words of a licence expression, classifier or text that are allowed: permissive ones, and file-level
# copyleft (MPL), which does not reach a program that imports the library.
ALLOWED = {
    "0bsd", "3-clause bsd license", "apache 2.0", "apache license 2.0", "apache software license",
    "apache-2.0", "apache-2.0 with llvm-exception", "bsd", "bsd license", "bsd-2-clause",
    "bsd-3-clause", "bsl-1.0", "cc0-1.0", "isc", "isc license (iscl)", "mit", "mit license", "mit-cmu",
    "mozilla public license 2.0 (mpl 2.0)", "mpl-2.0", "psf-2.0", "python software foundation license",
    "zlib",
}  # fmt: skip
# Under the LGPL: used as they are installed, unmodified and replaceable, which is all that it asks.
# chardet comes with binaryornot or requests in some versions of the development tools.
LESSER = {"chardet", "pygame-ce"}
ROOT = "shake-env"


def closure(name, extras=()):
    """Canonical names of all distributions that a distribution brings with these extras."""
    done, queue = set(), [(canonicalize_name(name), frozenset(extras))]
    while queue:
        each, wanted = queue.pop()
        if (each, wanted) in done:
            continue
        done.add((each, wanted))
        try:
            required = importlib.metadata.requires(each) or []
        except importlib.metadata.PackageNotFoundError:  # of another platform or interpreter
            continue
        for text in required:
            requirement = Requirement(text)
            marker = requirement.marker
            contexts = [{"extra": extra} for extra in wanted] or [{"extra": ""}]
            if marker is None or any(marker.evaluate(context) for context in contexts):
                queue.append((canonicalize_name(requirement.name), frozenset(requirement.extras)))
    return {each for each, _ in done}


def licences(name):
    """The licences that a distribution states, in lower case."""
    metadata = importlib.metadata.metadata(name)
    if expression := metadata.get("License-Expression"):
        return {part.strip("() ").lower() for part in re.split(r" AND | OR ", expression)}
    stated = [c.split(" :: ")[-1] for c in metadata.get_all("Classifier", []) if c[:7] == "License"]
    if not stated:
        stated = re.split(r" AND ", (metadata.get("License") or "nothing stated").splitlines()[0])
    return {each.lower() for each in stated}


def installed():
    names = closure(ROOT, ["agents", "dev"])
    return sorted(n for n in names if _present(n) and n != ROOT)


def _present(name):
    try:
        importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


@pytest.mark.parametrize("name", installed())
def test_a_distribution_that_the_project_brings_has_an_allowed_licence(name):
    if name in LESSER:
        assert any("lgpl" in each or "lesser" in each for each in licences(name))
        return
    assert licences(name) <= ALLOWED


def test_the_rule_can_fail():
    assert not {"gpl-2.0", "gnu general public license v3 (gplv3)", "nothing stated"} & ALLOWED


def test_the_closure_is_that_of_the_install_command():
    names = closure(ROOT, ["agents", "dev"])
    assert {"numpy", "torch", "stable-baselines3", "tensorboard", "pytest", "rl-zoo3", "osqp"} <= names
    assert {"torch", "pytest"}.isdisjoint(closure(ROOT))
    assert "slycot" not in names


def test_no_pin_names_what_no_extra_brings():
    pins = (Path(__file__).parents[1] / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {canonicalize_name(line.split("==")[0]) for line in pins if "==" in line}
    assert "slycot" not in pinned
