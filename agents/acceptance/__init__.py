"""A laboratory's acceptance tests: required and test response spectra, clause by clause."""

from agents.acceptance.clauses import Acceptance, AcceptanceRules, Clause, accept
from agents.acceptance.matching import compatible_motion
from agents.acceptance.required import RequiredSpectrum, ac156, ieee_693, read_required_spectrum

__all__ = [
    "Acceptance",
    "AcceptanceRules",
    "Clause",
    "RequiredSpectrum",
    "ac156",
    "accept",
    "compatible_motion",
    "ieee_693",
    "read_required_spectrum",
]
