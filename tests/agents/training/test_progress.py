"""What a person sees of a training run: in the terminal, in tensorboard and in the run's directory."""

import io
import json
import re

import numpy as np
import pytest
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from agents.progress import Progress
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import APGOptions, PPOOptions, SACOptions
from agents.training.config import TrainConfig
from agents.training.progress import BARS, TrainingView, curve_meaning, sparkline
from agents.training.run import train


def shown(*told):
    stream = io.StringIO()
    console = Console(file=stream, width=100, force_terminal=False)
    with TrainingView("training mine", console) as view:
        for each in told:
            view(each)
    return stream.getvalue()


def told(steps, seconds, *evaluations, **changes):
    last = evaluations[-1] if evaluations else None
    return Progress(steps, 1000, seconds, last, evaluations, **changes)


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "apg"])
def test_every_algorithm_writes_what_tensorboard_shows(algorithm, tmp_path):
    config = TrainConfig(
        algorithm=algorithm,
        scenario=ScenarioOptions("yielding") if algorithm == "ppo" else ScenarioOptions(),
        ppo=PPOOptions(n_envs=4, n_steps=16, batch_size=64, n_epochs=1),
        sac=SACOptions(n_envs=32, batch_size=32, gradient_steps=1, buffer_size=1000, learning_starts=32),
        apg=APGOptions(n_envs=4, rollout_horizon=8),
        net_arch=(8,), episode_duration=0.2, total_timesteps=128, evaluations=1000,
        evaluation_earthquakes=2,
    )  # fmt: skip
    seen = []
    result = train(config, tmp_path / "run", report=seen.append)
    written = EventAccumulator(str(tmp_path / "run" / "tensorboard"), size_guidance={"images": 0})
    written.Reload()
    keys = ("cost_ratio", "acceleration_rms_error", "base_shear_rms_error")
    scalars = {key: written.Scalars(f"evaluation/{key}") for key in keys}
    pictures = written.Images("evaluation/example")
    rows = [
        json.loads(line) for line in (tmp_path / "run" / "evaluations.jsonl").read_text().splitlines()
    ]
    assert len(rows) == len(pictures) == len(scalars[keys[0]]) >= 2
    assert all(picture.width >= 600 and picture.height >= 400 for picture in pictures)
    # Tensorboard keeps single precision.
    assert min(s.value for s in scalars["cost_ratio"]) == pytest.approx(result.cost_ratio, rel=1e-6)
    assert scalars["base_shear_rms_error"][-1].value == pytest.approx(
        rows[-1]["base_shear_rms_error"], rel=1e-6
    )
    assert seen[-1].evaluations == tuple(row["cost_ratio"] for row in rows)
    assert seen[-1].errors == (rows[-1]["acceleration_rms_error"], rows[-1]["base_shear_rms_error"])
    assert seen[-1].reference == ("oracle" if algorithm == "ppo" else "LQR")


def test_the_view_says_how_far_how_long_and_how_good():
    text = shown(told(0, 0.0, 9.0), told(250, 60.0, 9.0, 3.0, 1.21, 1.25, errors=(0.45, 0.08)))
    assert "25 %, about 3 min left" in text
    # Now and at best; both errors; what it costs more than the reference.
    assert text.index("1.250") < text.index("1.210")
    assert re.search(r"acceleration\D*45\.0 %", text) and re.search(r"base shear\D*8\.0 %", text)
    assert re.search(r"\b25 % more\b", text) and "reference" in text
    assert sparkline((9.0, 3.0, 1.21, 1.25)) in text


def test_the_time_left_counts_from_where_a_resumed_run_began():
    assert "75 %, about 2 min left" in shown(told(500, 0.0), told(750, 100.0))
    assert "not known yet" in shown(told(500, 0.0), told(505, 1.0))
    assert "took 40 s" in shown(told(0, 0.0), told(1000, 40.0, 1.0))


def test_the_last_state_is_all_that_a_file_gets():
    text = shown(*(told(steps, steps / 10, 2.0) for steps in range(0, 1001, 100)))
    assert text.count("training mine") == 1
    assert "100 %" in text


@pytest.mark.parametrize(
    ("evaluations", "words"),
    [
        ((), "about to be evaluated"),
        ((9.0, 8.0), "hardly controlled yet"),
        ((9.0, 1.5), "50 % more"),
        ((9.0, 1.003), "about as good"),
        ((9.0, 0.9), "better than the reference by 10.0 %"),
        ((9.0, 1.1, 2.5), "worse than it was"),
    ],
)
def test_evaluations_are_put_in_words(evaluations, words):
    assert words in curve_meaning(told(10, 1.0, *evaluations))


def test_a_sparkline_falls_as_its_values_do():
    line = sparkline(np.geomspace(100.0, 1.0, 8).tolist())
    assert line == BARS[::-1]
    assert sparkline([1.0, 1.0]) == BARS[0] * 2
