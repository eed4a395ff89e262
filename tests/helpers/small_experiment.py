"""An experiment of a second, for the tests of searches."""

from contextlib import contextmanager
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from agents.experiments.evaluation_tasks import EVALUATION_TASKS
from agents.experiments.recipes import ExperimentConfig
from agents.experiments.search import open_search
from agents.experiments.search_space import own_values, search_space
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import PPOOptions
from agents.training.config import TrainConfig

SMALL = TrainConfig(
    scenario=ScenarioOptions(duration=1.0),
    ppo=PPOOptions(n_envs=4, n_steps=16, batch_size=32, n_epochs=1),
    net_arch=(8,),
    episode_duration=0.2,
    total_timesteps=1_024,
    evaluations=8,
    evaluation_earthquakes=1,
    checkpoint_interval=1e-9,
)
TINY = ExperimentConfig(evaluation_task="linear", config=SMALL, minutes=0.1)


@contextmanager
def short_validation():
    """What a search is judged on lasts a second, and no evaluation of this process draws a figure."""
    task = replace(next(t for t in EVALUATION_TASKS if t.name == "linear"), options=SMALL.scenario)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("agents.experiments.search_objective.EVALUATION_TASKS", (task,))
        patch.setattr("agents.training.watch.example_figure", lambda trajectory, title: Figure())
        yield


def essence(trace):
    """What decides a trial and what came of it; numbers have gaps where a trial was cut."""
    return [(row.values, row.cost, row.ratio, row.lost, row.state, row.default) for row in trace.trials]


def led_study(search, storage):
    """The search with whole trials, and its study of five that reached a thousandth of the cost."""
    search = replace(search, share=1.0)
    study = open_search(search, storage)
    knobs, own = search_space(TINY), own_values(TINY)
    for _ in range(6):
        study.enqueue_trial({knob.name: own[knob.name] for knob in knobs})
    for _ in range(5):
        before = study.ask()
        for knob in knobs:
            knob.suggest(before)
        for place in range(21):
            before.report(1e-3, place)
        study.tell(before, 1e-3)
    return search, study
