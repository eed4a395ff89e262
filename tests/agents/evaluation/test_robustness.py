"""The robustness command: its result, figures, and what is said of it."""

import json
import re
from dataclasses import replace

import pytest

from agents.__main__ import main
from agents.evaluation.perturbations import (
    QUANTITIES,
)
from agents.evaluation.robustness import (
    DEFAULT_BASELINES,
    Grid,
    controllers_with_sources,
    default_controllers,
)
from agents.policies.policy_file import load_policy
from agents.policies.registry import shipped_policy
from agents.reporting.model_card import write_card
from agents.reporting.robustness_figures import draw_robustness
from agents.reporting.robustness_tables import (
    point_at,
    range_in_words,
    read_robustness,
    robustness_findings,
    robustness_markdown,
    robustness_section,
    write_robustness,
)
from agents.scenario_options import ScenarioOptions
from shake_env import make_scenario
from shake_env.errors import ParameterError, ScenarioError


def test_who_is_compared_unless_told_otherwise():
    for name, baselines in DEFAULT_BASELINES.items():
        assert set(default_controllers(make_scenario(name))) >= set(baselines)
    assert "apg" in default_controllers(make_scenario("laboratory"))
    chosen, sources = controllers_with_sources((), make_scenario("linear"))
    assert next(iter(chosen.controllers)) == "lqr"
    renamed = make_scenario("laboratory", {"fields": {"name": "mytable"}})
    assert default_controllers(renamed) == default_controllers(make_scenario("laboratory"))
    assert "lqr" not in sources
    assert len(sources["apg"]["sha256"]) == 64


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--controllers", "oracle"], "knows what is changed"),
        (["--controllers", "tf-iteration"], "repeats its tests"),
        (["--perturb", "mas_ratio"], "mass_ratio"),
        (["--earthquakes", "0"], "at least 1"),
        (["--all", "--perturb", "delay"], "contradicts --all"),
    ],
)
def test_mistakes_name_value_and_remedy(words, message, capsys):
    assert main(["robustness", *words]) == 2
    assert message in capsys.readouterr().err
    with pytest.raises(ScenarioError):
        Grid.from_scenario(make_scenario("linear"), ("weight",))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The command's result with a policy of a scenario that is too short to mean anything."""
    folder = tmp_path_factory.mktemp("robustness")
    words = ["robustness", "--controllers", "apg", "h-infinity", "--earthquakes", "2"]
    words += ["--duration", "0.6", "--perturb", "coulomb_friction", "delay", "--output", str(folder)]
    assert main(words) == 0
    return folder, read_robustness(folder / "robustness_linear.json")


def test_the_command_writes_result_and_figures(small):
    folder, result = small
    assert result["earthquakes"] == ["noise 5000000", "noise 5000001"]
    assert result["reference"] == "lqr"
    for name in ("robustness_linear", "robustness_linear_maps"):
        assert (folder / f"{name}.png").stat().st_size > 5000
        assert (folder / f"{name}.svg").exists()
    assert point_at(result, delay=1.0, coulomb_friction=300.0)["changes"] == {
        "coulomb_friction": 300.0,
        "delay": 1.0,
    }
    with pytest.raises(ParameterError, match="not in the result"):
        point_at(result, delay=1.23)
    again = folder / "copy.json"
    write_robustness(result, again)
    assert read_robustness(again) == result
    (folder / "other.json").write_text("{}")
    with pytest.raises(ParameterError, match="no result of shake robustness"):
        read_robustness(folder / "other.json")
    assert len(draw_robustness(result, folder / "png", svg=False)) == 2


def made_up(failures, cost):
    """A result of a sweep over three delays; failures and cost by controller."""
    points = [
        {
            "changes": {"delay": delay} if delay else {},
            "cost": {name: values[i] for name, values in cost.items()},
            "relative_cost": {name: values[i] / cost["lqr"][i] for name, values in cost.items()},
            "failures": {name: values[i] for name, values in failures.items()},
        }
        for i, delay in enumerate((0.0, 1.0, 2.0))
    ]
    delay = {"name": "delay", "title": "loop delay", "unit": "ms", "nominal": 0.0, "trained": None}
    return {
        "scenario": "linear", "reference": "lqr", "seed": 1, "version": "0", "code": None,
        "machine": "m",
        "controllers": [{"name": "lqr", "source": None}, {"name": "mine", "source": {"sha256": "1"}}],
        "earthquakes": ["a", "b"], "quantities": [{**delay, "values": [0.0, 1.0, 2.0]}], "maps": [],
        "points": points,
    }  # fmt: skip


def test_what_is_said_follows_from_the_numbers():
    result = made_up(
        {"lqr": [0, 0, 0], "mine": [0, 0, 2]}, {"lqr": [1.0, 1.0, 2.0], "mine": [0.9, 1.3, 99.0]}
    )
    failures, dearer = robustness_findings(result, "mine")
    assert re.findall(r"[\d.]*\d", failures) == ["2", "6", "2", "2"] and "loop delay" in failures
    assert re.findall(r"[\d.]*\d", dearer) == ["1", "1.30", "1"] and "loop delay" in dearer
    assert "lqr" in dearer
    assert "| loop delay, 0 to 2 ms | 0 ms | 1.00 | 0.90 to 1.30; lost at 2 ms |" in robustness_markdown(
        result
    )
    good = made_up(
        {"lqr": [0, 0, 1], "mine": [0, 0, 0]}, {"lqr": [1.0, 1.0, 9.0], "mine": [0.9, 0.8, 0.7]}
    )
    failures, dearer = robustness_findings(good, "mine")
    assert re.findall(r"[\d.]*\d", failures) == ["6"] and "none" in failures  # of the tests
    assert re.findall(r"[\d.]*\d", dearer) == ["2"] and "delay" not in dearer  # 2 %: nowhere


def test_values_in_words():
    values = [1.0, 2.0, 3.0, 4.0, 5.0]
    for chosen, words in (
        ("11111", "at every value"),
        ("11000", "up to 2 ms"),
        ("00011", "from 4 ms"),
        ("10000", "at 1 ms"),
        ("01110", "from 2 to 4 ms"),
        ("01001", "at 2 and at 5 ms"),
        ("00000", "nowhere"),
    ):
        assert range_in_words(values, [c == "1" for c in chosen], "ms") == words


def test_a_section_shows_the_table_and_what_was_found(small):
    _, result = small
    text = robustness_section(result)
    assert text.count("**apg.**") == 1 and robustness_markdown(result) in text


def test_a_card_says_where_its_policy_fails(small, tmp_path):
    folder, result = small
    file = tmp_path / "mine.safetensors"
    file.write_bytes(shipped_policy("apg").read_bytes())
    write_card(file, robustness=folder / "robustness_linear.json")
    text = file.with_suffix(".md").read_text()
    for sentence in robustness_findings(result, "apg"):
        assert f"- {sentence}" in text
    other = tmp_path / "other.safetensors"
    other.write_bytes(shipped_policy("ppo").read_bytes())
    with pytest.raises(ParameterError, match="does not hold this policy"):
        write_card(other, robustness=folder / "robustness_linear.json")
    assert load_policy(other).card  # and is a policy all the same


def test_a_report_shows_it(small, tmp_path, capsys):
    folder, result = small
    words = ["compare", "--controllers", "none", "--num-noise-motions", "2", "--no-records"]
    words += ["--duration", "1"]
    file = str(folder / "robustness_linear.json")
    assert main([*words, "--report", str(tmp_path / "page"), "--json", "--robustness", file]) == 0
    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    assert page.count('<img src="data:image/png;base64,') == 2
    assert robustness_findings(result, "apg")[0].replace("'", "&#x27;") in page
    capsys.readouterr()
    other = ["--robustness", file, "--scenario", "laboratory"]
    for more, message in (
        (["--robustness", file], "give --report"),
        ([*other, "--report", str(tmp_path / "two")], "is of linear"),
    ):
        assert main([*words, *more]) == 2
        assert message in capsys.readouterr().err


def test_all_runs_what_does_not_hold_any_more(tmp_path, monkeypatch, capsys):
    """One scenario of one quantity, run, left alone, and run again when a cost is not what it was."""
    monkeypatch.chdir(tmp_path)
    assert main(["robustness", "--all"]) == 2
    assert "run --all in the project's folder" in capsys.readouterr().err
    monkeypatch.setattr("agents.cli.robustness.SHOWN", ("linear",))
    build = ScenarioOptions.build
    monkeypatch.setattr(ScenarioOptions, "build", lambda options: build(replace(options, duration=0.4)))
    monkeypatch.setattr("agents.evaluation.robustness.DEFAULT_BASELINES", {})
    monkeypatch.setattr("agents.evaluation.robustness.policies_trained_for", lambda _: ())
    page, file = tmp_path / "docs" / "robustness.md", tmp_path / "docs/results/robustness_linear.json"
    page.parent.mkdir()
    page.write_text("<!-- robustness linear -->\n<!-- end linear -->\n")
    one = {"damping_ratio": replace(QUANTITIES["damping_ratio"], values=(0.5, 1.0))}
    monkeypatch.setattr("agents.evaluation.robustness.QUANTITIES", one)
    words = ["robustness", "--all", "--no-maps", "--earthquakes", "1"]
    assert main(words) == 0
    assert "as before" not in capsys.readouterr().out
    assert "changed at a time](figures/robustness_linear.png)" in page.read_text()
    made = read_robustness(file)
    assert main(words) == 0
    assert "as before" in capsys.readouterr().out
    made["points"][0]["cost"]["lqr"] *= 1.01  # as under another random stream
    write_robustness(made, file)
    assert main(words) == 0
    assert "as before" not in capsys.readouterr().out


def test_one_json_object_on_standard_output(capsys):
    words = ["robustness", "--controllers", "none", "--earthquakes", "1", "--duration", "1"]
    assert main([*words, "--perturb", "damping_ratio", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    # A table that stands still has the error of the target itself, whatever the specimen.
    assert all(each["failures"]["none"] == 0 for each in found["points"])
