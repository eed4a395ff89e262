"""What a supervisor did: commands that it changed and readings that it found faulty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray


@dataclass(frozen=True)
class Interventions:
    """How often a supervisor acted, over all episodes since its memory began."""

    steps: NDArray[np.int64]  # (N,) commands
    acted: NDArray[np.int64]  # (N,) of them changed, braking and not finite ones included
    braked: NDArray[np.int64]  # (N,) of them replaced by the braking law's
    not_finite: NDArray[np.int64]  # (N,) of them that were NaN or infinite
    largest: FloatArray  # (N,) largest change of a finite command [-] of the current limit
    faults: dict[str, NDArray[np.int64]]  # by signal (N,) faulty readings

    @property
    def share(self) -> float:
        """Share of commands changed, over all tables."""
        return float(self.acted.sum() / max(int(self.steps.sum()), 1))

    def __str__(self) -> str:
        faulty = {name: count for name, count in self.faults.items() if count.any()}
        faults = ", ".join(
            f"{name} {count.sum()} at {np.count_nonzero(count)} tables" for name, count in faulty.items()
        )
        return (
            f"supervisor: changed {self.acted.sum()} of {self.steps.sum()} commands "
            f"({100 * self.share:.2f} %) at {np.count_nonzero(self.acted)} of {len(self.steps)} tables; "
            f"braked {self.braked.sum()}, not finite {self.not_finite.sum()}; "
            f"largest change {self.largest.max(initial=0.0):.3f} of full current"
            + (f"; faulty readings: {faults}" if faults else "")
        )
