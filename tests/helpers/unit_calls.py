"""What units of the tests do; imports nothing that takes long."""

import os
import time
from pathlib import Path

from shake_env.errors import ParameterError


def noted(folder, name, value):
    """Note a run in a file, and return a value."""
    with (Path(folder) / name).open("a") as file:
        file.write(f"{os.getpid()}\n")
    return {"value": value, "threads": os.environ.get("OMP_NUM_THREADS")}


def runs(folder, name):
    """The number of times that `noted` ran under a name."""
    file = Path(folder) / name
    return len(file.read_text().splitlines()) if file.exists() else 0


def dies(folder, name, times):
    """End the process without a word, the first times."""
    noted(folder, name, None)
    if runs(folder, name) <= times:
        os._exit(9)
    return name


def says(text):
    print(text)


def refuses():
    raise ParameterError("mass", -1.0, "must be above 0")


def distance(value, other, seconds=0.0):
    time.sleep(seconds)
    return (value - other) ** 2


def divides(number):
    return 1 / number


def allocates(gib):
    return len(bytearray(int(gib * 2**30)))


def waits(seconds):
    time.sleep(seconds)


def begins_and_ends(folder, name, seconds):
    """Note the process that begins a unit, take a time, and return the name."""
    noted(folder, name, None)
    time.sleep(seconds)
    return name
