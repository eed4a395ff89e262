"""Twelve small runs have the same results by every engine, and by several that took turns."""

from pathlib import Path

import pytest

from agents.experiments.runner import Campaign
from agents.run_directory import RESULT

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[3]
RUNS = 12


@pytest.fixture(scope="module")
def execution():
    """The benchmark that publishes this comparison; it is run from a checkout, and not installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT))
        from benchmarks import execution

        yield execution


@pytest.fixture(scope="module")
def local(execution):
    digests = execution.campaign("local")["digests"]
    assert len(digests) == len(set(digests.values())) == RUNS
    return digests


@pytest.mark.parametrize("engine", ["ray", "submitit"])
def test_an_engine_has_the_results_of_local_processes(execution, local, engine):
    pytest.importorskip(engine, reason=f"{engine} is not installed: it is an extra")
    assert execution.campaign(engine)["digests"] == local


def test_a_campaign_goes_from_engine_to_engine(execution, local, tmp_path):
    for name in ("ray", "submitit"):
        pytest.importorskip(name, reason=f"{name} is not installed: it is an extra")
    folder, finished = tmp_path / "campaign", {}
    for engine, enough in (("submitit", 3), ("local", 7), ("ray", RUNS + 1)):

        def cut(campaign, enough=enough):
            if campaign.counts().get("done", 0) >= enough:
                raise KeyboardInterrupt

        tasks = execution.campaign_tasks(folder)
        assert {task.name for task in tasks if task.state == "done"} >= set(finished)
        with execution.options(engine, tmp_path).open_executor() as executor:
            if enough > RUNS:
                Campaign(tasks).run(executor)
            else:
                with pytest.raises(KeyboardInterrupt):
                    Campaign(tasks).run(executor, cut)
        # What was done was not run again.
        times = {task.name: file.stat().st_mtime_ns for task, file in results(tasks)}
        assert {name: times[name] for name in finished} == finished and len(times) > len(finished)
        finished = times
    assert len(finished) == RUNS
    assert execution.digests(folder) == local


def results(tasks):
    """The tasks that have a result, and its file."""
    files = [(task, task.run / RESULT) for task in tasks]
    return [(task, file) for task, file in files if file.exists()]
