"""A laboratory's acceptance tests: required and test response spectra, clause by clause."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "clauses": ("Acceptance", "Clause", "accept"),
        "matching": ("compatible_motion",),
        "required": ("RequiredSpectrum", "ac156", "ieee_693", "read_required_spectrum"),
        "rules": ("AcceptanceRules",),
    },
)
