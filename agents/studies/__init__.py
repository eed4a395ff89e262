"""Studies beside the daily path: reproduction of the paper, validation, components."""
