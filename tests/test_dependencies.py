"""Dependencies: their licences, and that the pinned versions are those that pyproject.toml declares."""

import importlib.metadata
import re
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

# Words of a licence expression, classifier or text that are allowed: permissive ones, and file-level
# copyleft (MPL), which does not reach a program that imports the library.
ALLOWED = {
    "0bsd", "3-clause bsd license", "apache", "apache 2.0", "apache license 2.0", "apache license v2.0",
    "apache software license", "apache-2.0", "apache-2.0 with llvm-exception", "bsd", "bsd license",
    "bsd-2-clause", "bsd-3-clause", "bsl-1.0", "cc0-1.0", "cmu license (mit-cmu)", "cnri-python", "isc",
    "isc license (iscl)", "mit", "mit license", "mit-cmu", "mozilla public license 2.0 (mpl 2.0)",
    "mpl-2.0", "psf-2.0", "python software foundation license", "unlicense", "zlib",
}  # fmt: skip
# Under the LGPL: used as they are installed, unmodified and replaceable, which is all that it asks.
# chardet comes with binaryornot or requests in some versions of the development tools.
LESSER = {"chardet", "nptdms", "pygame-ce"}
# NVIDIA's own licence: what a CUDA build of torch brings, which the project does not need.
NVIDIA = ("nvidia-", "cuda-")
# Distributions whose metadata state no licence: that of the file that they bring, and words of it.
IN_A_FILE = {"fmpy": ("bsd-2-clause", "THIS SOFTWARE IS PROVIDED BY THE COPYRIGHT HOLDERS")}
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
    if not stated and not metadata.get("License") and name in IN_A_FILE:
        licence, words = IN_A_FILE[name]
        files = importlib.metadata.files(name) or []
        texts = [each.read_text() for each in files if "LICENSE" in each.name.upper()]
        return {licence} if any(words in text for text in texts) else {"another than was read"}
    if not stated:
        stated = re.split(r" AND ", (metadata.get("License") or "nothing stated").splitlines()[0])
    return {each.lower() for each in stated}


def installed():
    names = closure(ROOT, ["agents", "dev", "ray", "slurm"])
    return sorted(n for n in names if _present(n) and n != ROOT)


def _present(name):
    try:
        importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def refused(name):
    """Licences of a distribution that the project may not bring."""
    if name.startswith(NVIDIA):
        return set()
    lesser = {each for each in licences(name) if "lgpl" in each or "lesser" in each}
    return licences(name) - ALLOWED - (lesser if name in LESSER else set())


@pytest.mark.parametrize("name", installed())
def test_a_distribution_that_the_project_brings_has_an_allowed_licence(name):
    assert refused(name) == set()


@pytest.mark.parametrize(
    ("header", "licence"),
    [
        ("License-Expression: MIT AND GPL-2.0", "gpl-2.0"),
        ("Classifier: License :: OSI Approved :: GNU General Public License v3 (GPLv3)",
         "gnu general public license v3 (gplv3)"),
        ("License: LGPL-2.1", "lgpl-2.1"),  # not one of those in LESSER
        ("Summary: made", "nothing stated"),
    ],
)  # fmt: skip
def test_another_licence_is_refused(header, licence, tmp_path, monkeypatch):
    folder = tmp_path / "made-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(f"Metadata-Version: 2.4\nName: made\nVersion: 1.0\n{header}\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert refused("made") == {licence}


def test_the_closure_is_that_of_the_install_command():
    names = closure(ROOT, ["agents", "dev"])
    assert {"numpy", "torch", "stable-baselines3", "tensorboard", "pytest", "rl-zoo3", "osqp"} <= names
    assert {"torch", "pytest"}.isdisjoint(closure(ROOT))
    assert "slycot" not in names


CONSTRAINTS = ("constraints.txt", "constraints-oldest.txt")


def pins(file):
    """The pinned version of each distribution in a constraints file."""
    lines = (Path(__file__).parents[1] / file).read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if "==" in line]
    return {canonicalize_name(name): version for name, version in pairs}


@pytest.mark.parametrize("file", CONSTRAINTS)
def test_no_pin_is_under_another_licence(file):
    assert "slycot" not in pins(file)


def test_the_oldest_pins_are_the_declared_minimum_versions():
    declared = {}
    for text in importlib.metadata.requires(ROOT):
        requirement = Requirement(text)
        lowest = [s.version for s in requirement.specifier if s.operator == ">="]
        if lowest:
            declared[canonicalize_name(requirement.name)] = lowest[0]
    oldest = pins("constraints-oldest.txt")
    ours = {
        name: version for name, version in declared.items() if name != "obspy"
    }  # no extra of the tests
    assert oldest == ours


def test_the_newest_pins_are_within_the_declared_range():
    newest, oldest = pins("constraints.txt"), pins("constraints-oldest.txt")
    assert oldest.keys() <= newest.keys()
    assert all(Version(newest[name]) >= Version(oldest[name]) for name in oldest)
