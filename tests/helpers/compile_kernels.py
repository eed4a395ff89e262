"""Compile what the tests run compiled, once, before the workers of a whole run begin.

Each worker would compile all of it otherwise, at the same time as the other. What numba has on disk is
only read. A script with the name of a part compiles that part alone.
"""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


def plans():
    """The search of currents, by a plan of two periods: as long as any two others."""
    import numpy as np

    from baselines.planning.model import PlanningModel
    from shake_env import make_scenario

    model = PlanningModel.of(make_scenario("laboratory"))
    target = np.zeros((1, 2, model.substeps))
    model.improve(np.zeros((1, 2)), np.zeros((1, model.states)), target, target, iterations=1)


def steps():
    """What steps tables: as the environment does it, and for estimators and planners."""
    from shake_env.kernels.period import period_of
    from shake_env.kernels.vectors import BLOCK

    period_of(1)
    period_of(BLOCK)
    import shake_env.kernels.table  # noqa: F401


def slopes():
    """Slopes of a period backwards."""
    import shake_env.kernels.period_adjoint  # noqa: F401


def jacobians():
    """Slopes of a period forwards."""
    import numpy as np

    from baselines.planning.ilqr_kernel import period_with_jacobian
    from baselines.planning.model import PlanningModel
    from shake_env import make_scenario

    model = PlanningModel.of(make_scenario("laboratory"))
    period_with_jacobian(np.zeros(model.states), 0.0, model.arrays, model.scale)


def estimates():
    """The extended Kalman filter and a yielding reference, by one reading and two periods."""
    import numpy as np

    from baselines.planning.ekf import ExtendedKalmanFilter
    from baselines.planning.filter_kernel import follow_targets
    from baselines.planning.nmpc import NonlinearPredictiveControl
    from shake_env import make_scenario

    scenario = make_scenario("laboratory")
    filtered = ExtendedKalmanFilter.from_scenario(scenario)
    readings = np.zeros((1, scenario.observation.readings_count))
    filtered.advance(filtered.rest(1), np.zeros(1), readings, np.array([True]))
    law = NonlinearPredictiveControl(make_scenario("yielding"))
    state = np.zeros((1, 3 * make_scenario("yielding").specimen.stories))
    follow_targets(state, np.zeros((1, 3)), law._yielding, law.model.arrays[7], np.zeros((1, 2)))


PARTS = {part.__name__: part for part in (plans, steps, slopes, estimates, jacobians)}


def compile_all(processes):
    """Compile every part, a few at a time. What fails here fails again in the test that needs it."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}

    def part(name):
        command = [sys.executable, __file__, name]
        return subprocess.run(command, env=environment, stderr=subprocess.DEVNULL).returncode

    with ThreadPoolExecutor(processes) as pool:
        return dict(zip(PARTS, pool.map(part, PARTS), strict=True))


if __name__ == "__main__":
    PARTS[sys.argv[1]]()
