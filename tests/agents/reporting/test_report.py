"""The report of a comparison: its numbers against theory, its page against what a page must be."""

import base64
import json
import re
import zlib
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from plotly.offline import get_plotlyjs

from agents.__main__ import main
from agents.acceptance.clauses import accept
from agents.acceptance.options import AcceptanceOptions
from agents.acceptance.rules import AcceptanceRules
from agents.evaluation.comparison import compare
from agents.reporting.comparison_tables import print_tables
from agents.reporting.report.acceptance import acceptance_section
from agents.reporting.report.contents import (
    HistoryCollector,
    make_report,
    policy_files_of,
    report_channels,
    unique_labels,
)
from agents.reporting.report.data import page_data
from agents.reporting.report.estimates import SampledParameters, TransferEstimate, lqr_frontier
from agents.reporting.report.page import report_page, unbroken_percentages, write_report
from agents.reporting.report.traces import BUDGET, LEVELS, Curves, pack_all, pack_curves, unpack_curves
from agents.reporting.terminal import OutputConsole
from agents.run_directory import learning_curve
from baselines.lqr.sampled import lqr
from shake_env import make_scenario
from shake_env.model.plant import specimen_plant
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.presets import NAMED
from shake_env.simulation.trajectory import Trajectory

VOID = {"meta", "link", "br", "img", "input", "hr", "line"}


def reported(scenario, names=("none",), acceptance=None, **options):
    gathered = HistoryCollector(scenario, acceptance)
    found = compare(scenario, names, on_histories=gathered, **options)
    return make_report(found, gathered, "shake compare")


@pytest.fixture(scope="module")
def linear():
    return reported(make_scenario("linear", {"duration": 6.0}), noise=3, records=False)


class Checked(HTMLParser):
    """Elements must nest, identifiers be unique; keeps what tests ask for."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.elements = [], [], []
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.elements.append((tag, attributes))
        if "id" in attributes:
            self.ids.append(attributes["id"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def all(self, tag):
        return [attributes for each, attributes in self.elements if each == tag]


# --- acceptance ---------------------------------------------------------------------------------------


def test_a_report_holds_each_controller_against_the_required_spectrum(tmp_path):
    # The same spectrum, rules and motion as `accept` has: what the section says is what it found.
    scenario = make_scenario("linear", {"duration": 6.0})
    file = tmp_path / "required.csv"
    file.write_text("1.0, 0.01\n30.0, 0.01\n", encoding="utf-8")
    options = AcceptanceOptions(spectrum=str(file), rules=AcceptanceRules(strong_motion=1.0))
    report = reported(scenario, ("none", "tvc"), options, noise=3, records=False)
    section = acceptance_section(report)
    rows = {row.label: row for row in section.rows}
    assert set(rows) == {"tvc", "LQR"}  # a table that stands still has no test spectrum
    _, histories = rollout(lqr(scenario), scenario, report.gathered.earthquakes, record=range(3))
    alone = [
        accept([t.table_acceleration], scenario.physics_step, options.required(), options.rules)
        for t in histories.values()
    ]
    assert rows["LQR"].passed == sum(each.passed for each in alone)
    lowest = min(float((each.trs / each.rrs).min()) for each in alone)
    np.testing.assert_allclose(rows["LQR"].lowest, lowest, rtol=1e-12)
    text = report_page(report, [])
    Checked(text)
    assert "Required response spectrum" in text and section.required.name in text
    below = AcceptanceOptions(spectrum="ac156", s_ds=5.0)  # far above the motion
    strict = acceptance_section(reported(scenario, ("lqr",), below, noise=2, records=False))
    (row,) = strict.rows
    assert row.passed == 0 and row.lowest < 0.9
    assert any(words.startswith("no ordinate below 0.9 RRS (2)") for words in row.failed)


def test_a_required_spectrum_without_a_report_is_refused(capsys):
    assert main(["compare", "--acceptance.spectrum", "ac156"]) == 2
    assert "--report" in capsys.readouterr().err


# --- estimates against theory -----------------------------------------------------------------------


def test_errors_by_frequency_differ_by_the_specimen_alone():
    # f_s - f~_s = G_S (y_A - y~) exactly in the corrected model: the ratio of both estimates is |G_S|,
    # whatever the controller does.
    scenario = make_scenario("linear", {"duration": 24.0})
    controller = lqr(scenario)
    earthquakes = noise_earthquakes(scenario, 6, 4_000_000)
    _, found = rollout(controller, scenario, earthquakes, record=range(6))
    estimate = TransferEstimate(scenario.physics_step)
    for trajectory in found.values():
        estimate.add(trajectory)
    frequency, acceleration, shear = estimate.response()
    model = specimen_plant(scenario.specimen)
    s = 2j * np.pi * frequency[:, None, None]
    expected = np.abs(model.C @ np.linalg.inv(s * np.eye(model.order) - model.A) @ model.B)[:, 0, 0]
    # A window of 4 s smears the first mode, 0.4 Hz wide at half power, over 0.25 Hz and a band: beside
    # it the estimate is within a few percent, at it within a fifth.
    ratio = shear / acceleration / expected
    away = np.abs(frequency - 4.33) > 1.0
    inside = away & (frequency > 0.7) & (frequency < 9.0)
    np.testing.assert_allclose(ratio[inside], 1.0, atol=0.08)


def test_a_table_that_stands_still_has_an_acceleration_error_of_one():
    time = 1e-3 * np.arange(1, 10_001)
    target = np.random.default_rng(0).standard_normal(len(time))
    zero, none = np.zeros_like(time), np.zeros(2000)
    still = Trajectory(
        time, target, zero, 3.0 * target, zero, time[4::5], none, zero[:8000:1].reshape(2000, 4), none
    )
    estimate = TransferEstimate(1e-3)
    assert not estimate.known
    estimate.add(still)
    _, acceleration, shear = estimate.response()
    np.testing.assert_allclose(acceleration, 1.0, rtol=1e-12)
    np.testing.assert_allclose(shear, 3.0, rtol=1e-12)


def test_a_test_shorter_than_a_window_is_not_counted():
    scenario = make_scenario("linear", {"duration": 1.0})
    _, found = rollout(lqr(scenario), scenario, noise_earthquakes(scenario, 1), record=[0])
    estimate = TransferEstimate(scenario.physics_step)
    estimate.add(found[0])
    assert not estimate.known


def test_the_frontier_passes_through_the_design_and_never_turns_back():
    points = np.array(lqr_frontier(make_scenario("linear")))
    # SPEC's sampled LQR of equal weights, 200 Hz; the curve's middle weight keeps their product, not
    # the current's share, so that it is the design itself.
    assert np.min(np.linalg.norm(points - [0.441274, 0.072726], axis=1)) < 1e-6
    assert np.all(np.diff(points[:, 0]) > 0)
    assert np.all(np.diff(points[:, 1]) < 0)
    assert lqr_frontier(make_scenario("laboratory")) == []


# --- curves -----------------------------------------------------------------------------------------


def curves(samples=500, rate=200.0, seed=0):
    noise = np.cumsum(np.random.default_rng(seed).standard_normal((2, samples)), axis=1)
    return Curves(rate, {"a": noise[0].astype(np.float32), "b": 1e-3 * noise[1].astype(np.float32)})


def test_packed_curves_come_back_within_a_level():
    given = curves()
    back = unpack_curves(json.loads(json.dumps(pack_curves(given))))
    assert back.rate == given.rate
    for name, curve in given.values.items():
        peak = np.max(np.abs(curve))
        np.testing.assert_allclose(back.values[name], curve, atol=0.51 * peak / LEVELS)


@pytest.mark.parametrize("curve", [[], [0.0, 0.0], [5.0, -5.0, 5.0], [np.nan, 1.0]])
def test_any_curve_can_be_packed(curve):
    back = unpack_curves(pack_curves(Curves(100.0, {"a": np.array(curve, dtype=np.float32)})))
    np.testing.assert_allclose(back.values["a"], np.nan_to_num(curve), atol=0.01)


def test_thinning_keeps_the_budget_and_thins_noise_first():
    rows = [[curves(4000, seed=i), curves(4000, seed=9 + i)] for i in range(4)]
    groups = ["records", "records", "filtered noise", "filtered noise"]
    sizes = {}
    for budget in (10**9, 60_000, 20_000):
        packed = pack_all(rows, groups, budget)
        sizes[budget] = sum(len(each["blob"]) for row in packed for each in row)
        assert sizes[budget] <= budget
        assert packed[0][0]["rate"] >= packed[3][0]["rate"]
    assert packed[0][0]["rate"] < 200.0
    first = pack_all(rows, groups, sizes[10**9] - 1)
    assert (first[0][0]["rate"], first[3][0]["rate"]) == (200.0, 100.0)


def test_curves_without_noise_are_thinned_too():
    packed = pack_all([[curves(4000)]], ["records"], 3000)
    assert len(packed[0][0]["blob"]) <= 3000


@pytest.mark.parametrize("name", NAMED)
def test_every_named_scenario_has_a_page(name):
    scenario = make_scenario(name, {} if name == "records" else {"duration": 5.0})
    report = reported(scenario, noise=2, records=False)
    text = report_page(report, [])
    found = Checked(text)
    assert len(found.ids) == len(set(found.ids))
    for sentence in report.verdict.sentences:
        assert unbroken_percentages(sentence) in text
    plots = {each["id"] for each in found.all("div") if each.get("class") == "plot"}
    assert {"traces", "trade-off", "spectrum", "transfer-shear"} <= plots
    assert ("hysteresis" in plots) == scenario.nonlinearity.yielding.active
    assert ("robustness" in plots) == scenario.uncertainty.active


def test_every_figure_lies_beside_the_page(tmp_path):
    scenario = make_scenario("yielding", {"duration": 5.0})
    report = reported(scenario, noise=2, records=False)
    report = replace(
        report,
        drawn=SampledParameters(
            {"mass_ratio": np.array([0.2, 0.6]), "storey_frequency": np.array([5.0, 8.0])}
        ),
        learning={"none": [(0, 9.0), (1000, 1.5)]},
    )
    paths = write_report(report, tmp_path)
    names = ("trade_off", "traces", "spectra", "hysteresis", "transfer", "robustness", "learning")
    assert [path.name for path in paths] == [
        "index.html", *(f"{name}.{ending}" for name in names for ending in ("svg", "png"))
    ]  # fmt: skip
    linked = {each["href"] for each in Checked(paths[0].read_text(encoding="utf-8")).all("a")}
    assert linked == {path.name for path in paths[1:]}
    assert all(path.stat().st_size > 2000 for path in paths)


def test_the_page_loads_nothing(linear):
    text = report_page(linear, ["traces"])
    found = Checked(text)
    for _, attributes in found.elements:
        for key in ("src", "href", "srcset", "data", "action"):
            value = attributes.get(key, "data:,")
            assert value == "data:," or value in ("traces.svg", "traces.png"), (key, value)
    assert not any(each in text for each in ("://", "@import", "url("))


def test_a_full_page_stays_below_5_mb(linear):
    text = report_page(linear, [])
    curves = [packed for quake in page_data(linear)["earthquakes"] for packed in quake["runs"]]
    curves += [quake["target"] for quake in page_data(linear)["earthquakes"]]
    assert len(text) - sum(len(packed["blob"]) for packed in curves) + BUDGET < 4_995_000


def test_the_page_holds_the_plotting_library_of_the_installed_package(linear):
    packed = re.search(r'id="plotly-script">(.*?)</script>', report_page(linear, []), re.DOTALL)[1]
    source = zlib.decompress(base64.b64decode(packed)).decode("utf-8")
    assert source == get_plotlyjs() and "MIT" in source[:400]  # its licence's notice stays with it


def test_the_page_is_accessible_by_structure(linear):
    found = Checked(report_page(linear, []))
    assert found.all("html") == [{"lang": "en"}]
    assert len(found.all("h1")) == 1
    assert len(found.all("caption")) == len(found.all("table")) >= 1
    assert all(each.get("scope") in ("col", "row") for each in found.all("th"))
    labelled = {each.get("for") for each in found.all("label")}
    inputs = {each["id"] for tag in ("input", "select") for each in found.all(tag)}
    assert inputs <= labelled
    assert all(each.get("aria-label") for each in found.all("div") if each.get("class") == "plot")


def test_the_page_holds_the_numbers(linear):
    data = page_data(linear)
    text = report_page(linear, [])
    inside = re.search(r'id="report-data">(.*?)</script>', text, re.DOTALL)
    assert json.loads(inside[1]) == json.loads(json.dumps(data))
    assert [c["label"] for c in data["controllers"]] == ["LQR", "none"]
    rows = linear.comparison.episodes["lqr"]
    for quake, row in zip(data["earthquakes"], rows, strict=True):
        assert quake["errors"][0][0] == pytest.approx(100 * row.acceleration_rms_error, rel=1e-3)
        back = unpack_curves(quake["runs"][0])
        assert len(back.values["stroke"]) == 1200
        assert np.max(np.abs(back.values["current"])) == pytest.approx(1e3 * row.peak_current, rel=1e-2)


@pytest.mark.parametrize("hostile", ['</script><img src=x onerror="alert(1)">', "<!--<script>"])
def test_names_cannot_break_out_of_the_page(linear, hostile):
    labels = {name: hostile + name for name in linear.labels}
    text = report_page(replace(linear, labels=labels), [])
    found = Checked(text)
    assert not found.all("img")
    # "<!--<script>" inside a script element hides the end tag that follows: no "<" may be in the data.
    data = re.search(r'id="report-data">(.*?)</script>', text, re.DOTALL)[1]
    assert "<" not in data
    assert hostile in json.dumps(json.loads(data), ensure_ascii=False).replace('\\"', '"')


def test_a_table_driven_in_volts_is_told_in_volts(capsys):
    scenario = make_scenario("laboratory", {"table": "quanser-shake-table-ii", "duration": 1.0})
    report = reported(scenario, noise=2, records=False)
    (row,) = [s for s in report.comparison.summaries if s.controller == "lqg"]
    text = report_page(report, [])
    assert "input [V]" in text and "mA" not in re.sub(r"<script.*?</script>", "", text, flags=re.S)
    assert f"<td>{row.peak_current:.2f}</td>" in text
    panel = next(c for c in report.channels if c.key == "current")
    assert (panel.title, panel.unit, panel.limit) == ("input", "V", scenario.current_limit)
    print_tables(report.comparison, OutputConsole(force_terminal=False, width=200))
    shown = capsys.readouterr().out
    assert "input V" in shown and "mA" not in shown and f"{row.peak_current:.2f}" in shown
    frame = report.comparison.to_frame("summaries")
    assert frame.attrs["units"]["peak_current"] == "V"


def test_limits_stand_with_their_panels():
    by_key = {channel.key: channel for channel in report_channels(make_scenario("laboratory"))}
    assert by_key["stroke"].limit == pytest.approx(76.0)
    assert by_key["current"].limit == pytest.approx(40.0)
    assert by_key["pressure"].limit == pytest.approx(21.0)
    assert by_key["shear"].limit is None
    assert {c.key: c.limit for c in report_channels(make_scenario("linear"))}["stroke"] is None


def test_labels_are_short_and_differ():
    names = ["lqr", "runs/a/one", "runs/b/one", "runs/c/policy.safetensors", "best.safetensors"]
    assert list(unique_labels(names).values()) == ["LQR", "a/one", "b/one", "c", "best"]


def test_a_run_directory_has_its_learning_curve(tmp_path):
    rows = [
        {"steps": 0, "seconds": 1.0, "cost_ratio": 9.0},
        {"steps": 10, "seconds": 2.0, "cost_ratio": 1.5},
    ]
    lines = [json.dumps(row) for row in rows]
    (tmp_path / "evaluations.jsonl").write_text("\n".join([*lines, '{"steps": 20, "co']))
    assert learning_curve(str(tmp_path)) == [(0, 9.0), (10, 1.5)]
    assert learning_curve("lqr") == []


def test_the_command_writes_the_report_it_names(tmp_path, capsys):
    folder = tmp_path / "report"
    arguments = ["--no-records", "--noise=2", "--duration=2", "--controllers", "none", "--output"]
    assert main(["compare", *arguments, str(tmp_path / "out"), "--report", str(folder)]) == 0
    written = "".join(capsys.readouterr().out.split())  # a narrow terminal folds paths
    assert f"wrote{folder}/index.html" in written
    text = (folder / "index.html").read_text(encoding="utf-8")
    # Two seconds are shorter than a window of the spectral estimate: its panel is left out, not empty.
    plots = {each["id"] for each in Checked(text).all("div") if each.get("class") == "plot"}
    assert plots == {"trade-off", "traces", "spectrum", "ratio"}
    assert not (folder / "transfer.png").exists()


def test_a_shipped_policy_is_the_scenarios_own():
    found = policy_files_of(["lqg", "apg"], "laboratory")
    assert list(found) == ["apg"]
    assert found["apg"].card["config"]["scenario"]["scenario"] == "laboratory"
