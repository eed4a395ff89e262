"""Work shared among processes and machines: one interface, engines behind it."""
