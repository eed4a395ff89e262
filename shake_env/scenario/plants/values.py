"""Values of a specimen's parameters by name: what identification estimates and samples of it hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from shake_env.errors import ScenarioError
from shake_env.model.parameters import Specimen

MASS, DAMPING, STIFFNESS = "specimen_mass", "specimen_damping", "storey_stiffness"


def specimen_names(specimen: Specimen) -> tuple[str, ...]:
    """Return the names of a specimen's values: mass, a stiffness for each storey, damping.

    A structure that is given by matrices has one stiffness, a factor on its own, called
    ``storey_stiffness_1`` after the similar shear building.
    """
    stories = 1 if specimen.coupled else specimen.stories
    return (MASS, *(f"{STIFFNESS}_{i}" for i in range(1, stories + 1)), DAMPING)


def specimen_values(specimen: Specimen) -> dict[str, float]:
    """Return a specimen's values: total mass [kg], stiffnesses [N/m], damping of storey 1 [N s/m]."""
    names = specimen_names(specimen)
    values = [specimen.mass, *specimen.stiffnesses[: len(names) - 2], specimen.dampings[0]]
    return dict(zip(names, values, strict=True))


def with_specimen_values(specimen: Specimen, values: Mapping[str, float]) -> Specimen:
    """Return a specimen at these of its values; masses, and dampings, keep their proportions.

    Raises
    ------
    ScenarioError
        If it has no storey of a stiffness.
    """
    now = specimen_values(specimen)
    given = {name: v for name, v in values.items() if name in now or name.startswith(STIFFNESS)}
    for name in given:
        if name not in now:
            raise ScenarioError(name, given[name], f"the specimen has {', '.join(now)}")
    if not given:
        return specimen
    factor = {name: given.get(name, value) / value if value else 1.0 for name, value in now.items()}
    changes: dict[str, Any] = {
        "masses": tuple(factor[MASS] * m for m in specimen.masses),
        "dampings": tuple(factor[DAMPING] * c for c in specimen.dampings),
    }
    if specimen.coupled:
        stiffer = factor[f"{STIFFNESS}_1"]
        changes["stiffnesses"] = tuple(stiffer * k for k in specimen.stiffnesses)
        for name, by in (
            ("coupled_masses", factor[MASS]),
            ("coupled_stiffnesses", stiffer),
            ("coupled_dampings", factor[DAMPING]),
        ):
            matrix = getattr(specimen, name)
            if matrix is not None:
                changes[name] = tuple(map(tuple, (by * np.asarray(matrix)).tolist()))
    else:
        changes["stiffnesses"] = tuple(
            factor[f"{STIFFNESS}_{i}"] * k for i, k in enumerate(specimen.stiffnesses, start=1)
        )
    return replace(specimen, **changes)
