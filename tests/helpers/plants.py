"""Plants for tests."""

import numpy as np

from shake_env import Actuator, GroundFilter, ModelEquations, Specimen
from shake_env.model.plant import CoupledPlant

TABLE_I = Actuator()


def plant(specimen=None, actuator=TABLE_I, ground=None, equations=None):
    return CoupledPlant(
        actuator,
        specimen or Specimen.uniform(),
        ground or GroundFilter(),
        equations or ModelEquations(),
    )


def random_specimen(stories, seed=0):
    rng = np.random.default_rng([seed, stories])
    return Specimen(
        masses=rng.uniform(5.0, 80.0, stories),
        stiffnesses=rng.uniform(1e4, 4e5, stories),
        dampings=rng.uniform(0.0, 300.0, stories),
    )
