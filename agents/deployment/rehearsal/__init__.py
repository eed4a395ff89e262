"""A table and its controller as two processes at wall-clock rate, joined over UDP, with faults."""
