"""The bench of nonlinear parts: loops, spikes and flow against theory; the command and its page."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from agents.__main__ import main
from agents.studies.components.bench import (
    LEVELS,
    SAMPLES,
    ComponentSetup,
    drift_path,
    elastoplastic_energy,
    growing_cycles,
    loop_area,
    shaken_storey,
    sinusoidal_table,
    slip_history,
    steady_loop,
    storey_force,
    valve_flow,
)
from shake_env.errors import ParameterError
from shake_env.model.nonlinearity import Friction, ServoValve, Yielding

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "components.md"
BENCH = ComponentSetup()
LAW = BENCH.yielding
COULOMB = Friction(coulomb=150.0)


@pytest.fixture(scope="module")
def tables():
    return sinusoidal_table(BENCH, COULOMB, LEVELS, 1e-3)


# --- the storey


# Sharper knees below yielding come to their loop slowly and lose next to nothing in it.
@pytest.mark.parametrize(
    ("exponent", "ductility"), [(1.0, 0.6), (2.0, 0.6), (1.0, 1.2), (2.0, 1.2), (4.0, 1.2), (20.0, 1.2)]
)
def test_a_cycle_takes_what_the_law_integrates_to(exponent, ductility):
    # Loading from -Z: dz/dd = 1 up to z = 0, then 1 - u^n with u = z/z_y up to Z; unloading is elastic.
    # So Z + int_0^Z dz / (1 - u^n) = 2 d, and a cycle loses twice
    # (1 - alpha) k int_0^Z z u^n / (1 - u^n) dz.
    def travel(top):
        return top + quad(lambda u: 1.0 / (1.0 - u**exponent), 0.0, top)[0]

    top = brentq(lambda u: travel(u) - 2.0 * ductility, 0.0, 1.0 - 1e-9, xtol=1e-14)
    share = quad(lambda u: u ** (1.0 + exponent) / (1.0 - u**exponent), 0.0, top)[0]
    expected = 2.0 * (1.0 - LAW.stiffness_ratio) * BENCH.stiffness * LAW.yield_drift**2 * share
    at = np.array([ductility * LAW.yield_drift])
    found = steady_loop(BENCH, replace(LAW, exponent=exponent), at)[2][0]
    # Second order in drift steps of 1 / 80 of the yield drift, and what eight cycles leave of the start.
    assert found == pytest.approx(expected, rel=2e-3)


def test_energy_rises_to_the_elastoplastic_loop_with_the_exponent():
    at = LAW.yield_drift * np.array([2.0, 5.0])
    limit = elastoplastic_energy(BENCH, LAW, at)
    expected = 4.0 * 0.9 * 348.2 * 0.004 * np.array([1.0, 4.0])
    np.testing.assert_allclose(limit, expected, rtol=1e-3)
    shares = np.array(
        [steady_loop(BENCH, replace(LAW, exponent=n), at)[2] / limit for n in (1.0, 4.0, 20.0)]
    )
    assert np.all(np.diff(shares, axis=0) > 0.0) and np.all(shares < 1.0)
    # With u = exp(-t / n) the knee's share is zeta(2) / (2 n^2 (d / d_y - 1)) to first order in 1 / n;
    # the next order and the loop's own error are 1e-4 at n = 20.
    knee = np.pi**2 / (12.0 * 20.0**2 * np.array([1.0, 4.0]))
    np.testing.assert_allclose(1.0 - shares[-1], knee, rtol=0, atol=2e-4)
    nothing = elastoplastic_energy(BENCH, LAW, np.array([0.5 * LAW.yield_drift]))
    assert nothing == 0.0


def test_loops_are_closed_and_symmetric():
    at = LAW.yield_drift * np.array([1.5, 5.0])
    drift, force, _ = steady_loop(BENCH, LAW, at)
    half = SAMPLES
    np.testing.assert_allclose(force[half:], -force[: half + 1], rtol=0, atol=1e-6 * BENCH.yield_force)
    np.testing.assert_allclose(drift[half:], -drift[: half + 1], rtol=0, atol=1e-15)
    np.testing.assert_allclose(force[0], force[-1], rtol=1e-9)


def test_slopes_are_those_of_the_law_and_the_force_has_no_jump():
    loop = growing_cycles(BENCH, replace(LAW, exponent=20.0))
    slope = np.diff(loop.force) / np.diff(loop.drift)
    k = BENCH.stiffness
    assert slope[0] == pytest.approx(k, rel=1e-9)
    # On the way to the largest drift the storey is past its knee.
    top = int(np.argmax(loop.drift))
    assert slope[top - 1] == pytest.approx(LAW.stiffness_ratio * k, rel=1e-6)
    assert slope[top] == pytest.approx(k, rel=1e-6)
    # Overshoot at the knee, second order in the drift step, may dip below the post-yield slope a little.
    assert np.all(slope <= k * (1.0 + 1e-9)) and np.all(slope > 0.0)
    plateau = np.interp(
        LAW.yield_drift * 2.0, loop.drift[top - SAMPLES : top], loop.force[top - SAMPLES : top]
    )
    assert plateau == pytest.approx(BENCH.yield_force * (1.0 + LAW.stiffness_ratio), rel=1e-6)


def test_the_law_knows_no_rate():
    turns = LAW.yield_drift * np.array([3.0, -3.0, 3.0])
    straight = drift_path(turns)
    quarter = np.sin(np.linspace(0.0, 0.5 * np.pi, 301))[:, None]
    rest = np.cos(np.linspace(0.0, 2.0 * np.pi, 1201))[1:, None]
    sine = (turns[0] * np.concatenate([quarter, rest]))[:, 0]
    areas = []
    for drift, cycle in ((straight, 2 * SAMPLES + 1), (sine, 1201)):
        force = storey_force(BENCH.plant, LAW, drift, slip_history(LAW, drift))
        areas.append(float(loop_area(force[-cycle:], drift[-cycle:])))
    assert areas[0] == pytest.approx(areas[1], rel=5e-4)


def test_growing_cycles_lose_what_is_not_given_back():
    loop = growing_cycles(BENCH)
    assert np.all(np.diff(loop.cycle_energy) > 0.0) and loop.cycle_energy[0] > 0.0
    # Work put in over everything is what slips took and what is still in the springs at the end.
    work = float(loop_area(loop.force, loop.drift))
    slip_at_end = -loop.force[-1] / (BENCH.stiffness * (1.0 - LAW.stiffness_ratio))  # drift is zero
    stored = 0.5 * (1.0 - LAW.stiffness_ratio) * BENCH.stiffness * slip_at_end**2
    assert loop.drift[-1] == 0.0
    assert work == pytest.approx(loop.cycle_energy.sum() + stored, rel=1e-4)


def test_the_shaken_storey_follows_the_force_law():
    drift, shear = shaken_storey(BENCH)
    assert np.max(np.abs(drift)) > 2.0 * LAW.yield_drift
    # Without the damper's share the force stays within the plateau.
    damper = BENCH.plant.specimen.dampings[0] * np.gradient(drift, 1e-3)
    plateau = BENCH.yield_force * 0.9 + 0.1 * BENCH.stiffness * np.abs(drift)
    assert np.all(np.abs(shear - damper) <= 1.01 * plateau)
    small, force = shaken_storey(replace(BENCH, amplitude=0.02))
    damper = BENCH.plant.specimen.dampings[0] * np.gradient(small, 1e-3)
    np.testing.assert_allclose(
        force, BENCH.stiffness * small + damper, atol=2e-2 * np.max(np.abs(force))
    )


# --- friction on the table


def test_newtons_law_on_the_signals_finds_the_friction(tables):
    for i, level in enumerate(LEVELS):
        expected = COULOMB.force(tables.velocity[:, i], np.asarray(level))
        np.testing.assert_allclose(tables.friction[:, i], expected, rtol=0, atol=1e-7)
    own = sinusoidal_table(BENCH, BENCH.friction, step=2e-3)
    expected = BENCH.friction.force(own.velocity)
    np.testing.assert_allclose(own.friction, expected, rtol=0, atol=1e-7)


def test_friction_takes_its_force_times_the_way(tables):
    stroke = np.ptp(tables.displacement, axis=0)
    # The way there and back, less what smoothing over 5 of 160 mm/s rounds off at its ends.
    np.testing.assert_allclose(tables.energy, 2.0 * np.asarray(LEVELS) * stroke, rtol=2e-3, atol=1e-9)


def test_acceleration_spikes_at_the_reversal_and_rings_with_the_oil(tables):
    step = tables.time[1]
    excess = tables.acceleration - tables.acceleration[:, [0]]
    spikes = np.max(np.abs(excess), axis=0)
    assert np.all(np.diff(spikes) > 0.3)
    oil = BENCH.plant.natural_frequencies[-1]
    for i, level in enumerate(LEVELS[1:], start=1):
        first = round(tables.reversal[i] / step)
        # Within one swing of the oil column from the reversal the excess is at its largest.
        after = excess[first : first + round(1.0 / (oil * step)), i]
        assert np.max(np.abs(after)) > 0.9 * spikes[i], level
        before = excess[first - round(0.1 / step) : first, i]
        assert np.max(np.abs(after)) > 1.8 * np.max(np.abs(before))
        ringing = excess[first : first + round(0.45 / step), i]
        spectrum = np.abs(np.fft.rfft(ringing * np.hanning(len(ringing)), 16 * len(ringing)))
        peak = np.fft.rfftfreq(16 * len(ringing), step)[np.argmax(spectrum)]
        assert peak == pytest.approx(oil, abs=1.0)
    assert excess[:, 0] == pytest.approx(0.0, abs=0.0)


def test_the_period_repeats_and_does_not_hang_on_the_step(tables):
    spikes = np.max(np.abs(tables.acceleration - tables.acceleration[:, [0]]), axis=0)
    # What is left of the start-up rings on for four periods, by e^-2.8 in each.
    assert np.all(np.abs(tables.acceleration[-1] - tables.acceleration[0]) < 2e-2 * (spikes + 1.0))
    fine = sinusoidal_table(BENCH, COULOMB, LEVELS[:2], 5e-4)
    spike = np.max(np.abs(fine.acceleration[:, 1] - fine.acceleration[:, 0]))
    assert spike == pytest.approx(spikes[1], rel=2e-2)


# --- the valve

ORIFICE = replace(BENCH.valve, dead_band=0.0)
SUPPLY, TRAVEL = 21e6, 1.25e-5


def test_flow_meets_the_linear_valve_without_load_and_stops_at_the_supply():
    spool = TRAVEL * np.array([-1.0, -0.3, 0.0, 0.3, 1.0])
    at_rest = valve_flow(BENCH, ORIFICE, spool, np.zeros(5))
    np.testing.assert_allclose(at_rest, 76.0 * spool, rtol=1e-14)
    stalled = valve_flow(BENCH, ORIFICE, spool, SUPPLY * np.sign(spool))
    # The root is cut off at 1e-3 of the flow, which bounds its slope.
    assert np.all(np.abs(stalled) <= 1.001e-3 * 76.0 * np.abs(spool))
    driven = valve_flow(BENCH, ORIFICE, spool, -SUPPLY * np.sign(spool))
    np.testing.assert_allclose(driven, np.sqrt(2.0) * 76.0 * spool, rtol=1e-14)


def test_flow_has_merritts_coefficients_and_both_quadrants():
    spool = TRAVEL * np.array([0.2, 0.6, 1.0])
    for share in (-0.8, 0.0, 0.5, 0.9):
        p = np.full(3, share * SUPPLY)
        root = np.sqrt(1.0 - share)
        dp, dx = 1e2, 1e-11
        flow_pressure = (
            valve_flow(BENCH, ORIFICE, spool, p + dp) - valve_flow(BENCH, ORIFICE, spool, p - dp)
        ) / (2 * dp)
        np.testing.assert_allclose(flow_pressure, -76.0 * spool / (2.0 * SUPPLY * root), rtol=1e-5)
        inside = 0.9 * spool
        gain = (
            valve_flow(BENCH, ORIFICE, inside + dx, p) - valve_flow(BENCH, ORIFICE, inside - dx, p)
        ) / (2 * dx)
        np.testing.assert_allclose(gain, 76.0 * root, rtol=1e-5)
        np.testing.assert_array_equal(
            valve_flow(BENCH, ORIFICE, -spool, -p), -valve_flow(BENCH, ORIFICE, spool, p)
        )


def test_flow_is_continuous_over_spool_and_pressure():
    valve = BENCH.valve
    spool = np.linspace(-2.0 * TRAVEL, 2.0 * TRAVEL, 4001)
    for share in (-0.5, 0.0, 0.5):
        flow = valve_flow(BENCH, valve, spool, np.full_like(spool, share * SUPPLY))
        assert np.max(np.abs(np.diff(flow))) <= 76.0 * np.sqrt(1.5) * (spool[1] - spool[0]) * (
            1.0 + 1e-9
        )
        assert np.all(flow[np.abs(spool) <= valve.dead_band] == 0.0)
        assert np.ptp(flow[spool > TRAVEL]) == 0.0
    for position in (-TRAVEL, 0.4 * TRAVEL):
        for steps in (1000, 4000):
            pressure = np.linspace(-1.2 * SUPPLY, 1.2 * SUPPLY, steps + 1)
            flow = valve_flow(BENCH, ORIFICE, np.full_like(pressure, position), pressure)
            # The root rises from the supply pressure as the square root of the step.
            bound = 76.0 * abs(position) * np.sqrt(2.4 / steps)
            assert np.max(np.abs(np.diff(flow))) <= bound


# --- what the bench refuses


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"yielding": Yielding()}, "yield_drift"),
        ({"valve": ServoValve(spool_limit=1e-5)}, "supply_pressure"),
        ({"valve": ServoValve(supply_pressure=1e7)}, "spool_limit"),
        ({"frequency": 0.0}, "frequency"),
        ({"current": -0.01}, "current"),
        ({"ductilities": (1.0, 0.0)}, "ductilities"),
        ({"ductilities": ()}, "ductilities"),
    ],
)
def test_bench_names_what_cannot_be_drawn(changes, field):
    with pytest.raises(ParameterError, match=field):
        replace(BENCH, **changes)


# --- the command and its page


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("components")
    with pytest.MonkeyPatch.context() as patch:
        lines = []
        patch.setattr("builtins.print", lambda *a, **k: lines.append(a[0]))
        assert main(["plot-components", "--json", "--output", str(folder)]) == 0
    (line,) = lines
    return folder, json.loads(line)


def test_command_prints_one_object_and_writes_the_figures(run):
    folder, found = run
    written = json.loads((folder / "components.json").read_text())
    assert written == {key: value for key, value in found.items() if key != "files"}
    names = {Path(path).name for path in found["files"]}
    parts = ("yielding", "friction", "valve")
    assert names == {f"component_{p}.{kind}" for p in parts for kind in ("png", "svg")} | {
        "components.json"
    }
    assert all(Path(path).stat().st_size > 2000 for path in found["files"])


def test_help_teaches_by_example(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["plot-components", "--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert "shake plot-components --output" in out and "--json" in out


def test_page_holds_the_numbers_that_are_computed(run):
    _, found = run
    text = PAGE.read_text(encoding="utf-8")
    rows = [
        [c.strip() for c in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("|")
    ]
    cycles = {row[0]: row[1:] for row in rows if re.fullmatch(r"\d+ mm", row[0])}
    assert len(cycles) == 6
    for c in found["yielding"]["cycles"]:
        assert cycles[f"{1e3 * c['drift']:.0f} mm"] == [
            f"{c['energy']:.2f}", f"{c['elastoplastic_energy']:.2f}"
        ]  # fmt: skip
    levels = {row[0]: row[1:] for row in rows if re.fullmatch(r"\d+ N", row[0])}
    assert len(levels) == 4
    for t in found["friction"]["tables"]:
        assert levels[f"{t['coulomb']:.0f} N"] == [
            f"{abs(t['energy']):.1f}", f"{t['ideal_energy']:.1f}",
            f"{t['peak_acceleration']:.2f}", f"{t['spike']:.2f}",
        ]  # fmt: skip


def test_page_shows_figures_that_load_quickly():
    names = re.findall(r"\(figures/(component_\w+\.png)\)", PAGE.read_text(encoding="utf-8"))
    assert len(names) == 3
    for name in names:
        assert (ROOT / "docs" / "figures" / name).stat().st_size < 150_000
