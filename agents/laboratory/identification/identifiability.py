"""Parameters that logs do not identify, and the excitation that would."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agents.laboratory.identification.fit import Fit
from agents.laboratory.identification.parameters import find_parameter

FLAT = 0.7  # of the prior's standard deviation: a wider posterior counts as unidentified
TIED = 0.95  # correlation above which two parameters are not separable


@dataclass(frozen=True)
class Unidentified:
    """A parameter that logs do not identify, or two that they do not separate."""

    names: tuple[str, ...]
    reason: str
    excitation: str  # that would identify it

    def __str__(self) -> str:
        return f"{' and '.join(self.names)}: {self.reason}; needed: {self.excitation}"


def unidentified(fit: Fit) -> list[Unidentified]:
    """Return what the logs of a fit do not identify."""
    parameters = []
    shares = fit.deviations / fit.prior.deviations
    for name, share in zip(fit.names, shares, strict=True):
        if share > FLAT:
            reason = f"the posterior is {100 * share:.0f} % as wide as the prior"
            parameters.append(Unidentified((name,), reason, find_parameter(name).excitation))
    correlation = fit.correlation
    for i, j in np.argwhere(np.triu(np.abs(correlation) > TIED, k=1)).tolist():
        names = (fit.names[i], fit.names[j])
        reason = f"their correlation is {correlation[i, j]:.3f}"
        ways = dict.fromkeys(find_parameter(name).excitation for name in names)
        parameters.append(Unidentified(names, reason, "; ".join(ways)))
    return parameters
