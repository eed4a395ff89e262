"""An experiment of a second, for the tests of searches."""

from agents.experiments.catalogue import ExperimentConfig
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
