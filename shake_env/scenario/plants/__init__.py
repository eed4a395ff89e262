"""True plants of a scenario: their values by name, and samples of them from a posterior."""
