"""Commands on plans: the bound of an earthquake, and the plan of a record."""
