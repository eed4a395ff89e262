"""The card of a policy says what its file and its evaluation say."""

import json
import shutil

import pytest

from agents.__main__ import main
from agents.evaluation.entries import find_entry
from agents.evaluation.protocol import evaluate
from agents.evaluation.result_files import write_result
from agents.policies.policy_file import PolicyFile, load_policy
from agents.policies.registry import shipped_policy
from agents.reporting.evaluation_tables import interval_text
from agents.reporting.model_card import write_card
from shake_env import make_scenario
from shake_env.errors import ParameterError


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """A policy with a learning curve in its header, and a result that holds it."""
    folder = tmp_path_factory.mktemp("card")
    file = folder / "mine.safetensors"
    policy = load_policy(shipped_policy())
    curve = [[0, 8.0], [1_000_000, 2.0], [4_000_000, 1.05]]
    PolicyFile(**{**vars(policy), "card": {**policy.card, "curve": curve}}).save(file)
    scenario = make_scenario("linear", {"duration": 1.0})
    result = evaluate(
        scenario, [find_entry(str(file), scenario)], earthquakes=3, repeats=False, resamples=50
    )
    write_result(result, folder / "result.json")
    return folder, file, result


def test_a_card_repeats_its_sources(evaluated, capsys):
    folder, file, result = evaluated
    words = [
        "model-card",
        str(file),
        "--result",
        str(folder / "result.json"),
        "--limits",
        "Not for sale.",
    ]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["files"] == [str(folder / "mine.md"), str(folder / "mine.png")]
    text = (folder / "mine.md").read_text()
    card = load_policy(file).card
    row = next(row for row in result["rows"] if row["controller"] == "mine")
    for expected in (
        card["command"],
        row["sources"][0]["sha256"],
        f"| cost / bound | {interval_text(row['relative_cost'], 3)} |",
        f"| cost / lqr | {interval_text(row['reference_cost'], 3)} |",
        "0 of 3",
        "The actor has no biases",
        "- Not for sale.",
        "![Learning curve](mine.png)",
    ):
        assert expected in text
    assert (folder / "mine.png").stat().st_size > 3000


def test_a_result_of_other_policies_is_refused(evaluated, tmp_path):
    folder, _, _ = evaluated
    other = tmp_path / "other.safetensors"
    shutil.copy(shipped_policy("apg"), other)
    with pytest.raises(ParameterError, match="holds no row of this policy"):
        write_card(other, [folder / "result.json"])
    with pytest.raises(ParameterError, match="there is no such file"):
        write_card(other, [tmp_path / "absent.json"])
    assert [path.name for path in write_card(other)] == ["other.md", "other.png"]
    assert "Not evaluated on test earthquakes yet." in other.with_suffix(".md").read_text()
