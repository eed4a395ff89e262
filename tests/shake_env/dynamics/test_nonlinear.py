"""Nonlinear parts: order of convergence, energy, limit cases, delay, gradients."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from baselines.lqr.sampled import lqr
from shake_env import make_scenario, numba_support
from shake_env.dynamics.nonlinear import (
    FORCE,
    NonlinearDynamics,
    arrival,
    controlled_plant,
    controlled_scale,
)
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.discretization import zero_order_hold
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops, Yielding
from shake_env.model.parameters import ModelEquations
from shake_env.model.plant import SPOOL_POSITION
from shake_env.rollout import recorded_earthquakes, rollout

PLANT = make_scenario().plant
PERIOD = 0.005

SMOOTH = {
    "friction": Nonlinearity(friction=Friction(coulomb=150.0, static=220.0, viscous=50.0)),
    "orifice": Nonlinearity(valve=ServoValve(supply_pressure=3e6)),
}
KINKED = {
    "dead band": Nonlinearity(valve=ServoValve(dead_band=5e-7)),
    "saturation": Nonlinearity(valve=ServoValve(spool_limit=5e-6)),
    "rate limit": Nonlinearity(valve=ServoValve(spool_rate_limit=1.5e-4)),
    "stops": Nonlinearity(stops=StrokeStops(gap=0.004)),
    "yielding": Nonlinearity(yielding=Yielding(yield_drift=0.003)),
    "all": Nonlinearity(
        friction=Friction(coulomb=150.0, static=220.0),
        valve=ServoValve(
            supply_pressure=3e6, spool_rate_limit=3e-4, dead_band=2e-7, natural_frequency=60.0
        ),
        stops=StrokeStops(gap=0.004),
        yielding=Yielding(yield_drift=0.003),
    ),
}  # fmt: skip


def drive(time):
    """Return a current [A] that works every part: two sines, held over each control period."""
    return 0.012 * math.sin(2 * math.pi * 3 * time) + 0.006 * math.sin(2 * math.pi * 11 * time)


def reference(parts, duration):
    """Integrate the same equations by LSODA to a tight tolerance, period by period."""
    plant, scale = controlled_plant(PLANT, parts), controlled_scale(PLANT, parts)
    dynamics = NonlinearDynamics.from_plant(PLANT, parts, 1e-3, 5)
    limit = parts.valve.spool_limit
    lag, gain = PLANT.actuator.valve_time_constant, PLANT.actuator.valve_gain
    state = np.zeros(plant.order)
    for period in range(round(duration / PERIOD)):
        current = drive(period * PERIOD)

        def spool(time, current=current, start=state[3]):
            # Under a held current a first-order spool moves one way: resting on its stop is a clip.
            free = gain * current + (start - gain * current) * math.exp(-time / lag)
            return np.clip(free, -limit, limit)

        def rate(time, scaled, current=current, spool=spool):
            x = scaled * scale
            if math.isfinite(limit):
                x[3] = spool(time)
            g = dynamics.nonlinear(x, np.float64(current))
            change = plant.A @ x + plant.B[:, 0] * current + plant.B[:, 1:] @ g
            if math.isfinite(limit):
                change[3] = 0.0
            return change / scale

        found = solve_ivp(
            rate, (0.0, PERIOD), state / scale, method="LSODA", rtol=1e-9, atol=1e-11, max_step=2.5e-4
        )
        state = found.y[:, -1] * scale
        if math.isfinite(limit):
            state[3] = spool(PERIOD)
    return state


def stepped(parts, duration, substeps):
    dynamics = NonlinearDynamics.from_plant(PLANT, parts, PERIOD / substeps, substeps)
    state = np.zeros(dynamics.states)
    for period in range(round(duration / PERIOD)):
        state = dynamics.control_step(state, np.asarray(drive(period * PERIOD))).state
    return state


def errors(parts, substeps, duration=0.3):
    scale = controlled_scale(PLANT, parts)
    exact = reference(parts, duration) / scale
    return [
        float(np.linalg.norm(stepped(parts, duration, k) / scale - exact) / np.linalg.norm(exact))
        for k in substeps
    ]


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_parts_converge_with_second_order(name):
    found = errors(SMOOTH[name], (5, 10, 20, 40))
    assert found[0] < 3e-3  # the default step of 1 ms
    order = math.log2(found[-2] / found[-1])
    assert order == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("name", KINKED)
def test_parts_with_kinks_converge_with_second_order_on_average(name):
    # A kink inside a step leaves an error of second order whose factor depends on where in the step it
    # lies, so that the order from one halving to the next scatters; the slope of the line through four
    # halvings is 2 +- 0.5.
    found = errors(KINKED[name], (5, 10, 20, 40, 80))
    assert found[0] < 2e-2
    slope = np.polyfit(np.arange(5), np.log2(found), 1)[0]
    assert -slope == pytest.approx(2.0, abs=0.5)


def test_the_parts_were_at_work():
    """What each case is named after happens in it: it ends elsewhere than the linear plant."""
    linear = stepped(Nonlinearity(), 0.3, 5)
    for name, parts in {**SMOOTH, **KINKED}.items():
        if not parts.yielding.active and parts.valve.natural_frequency is None:
            state = stepped(parts, 0.3, 5)
            change = np.linalg.norm((state - linear) / controlled_scale(PLANT, parts))
            assert change > 5e-3, name


LIMITS = {
    "no friction": Nonlinearity(friction=Friction(coulomb=0.0)),
    "infinite supply": Nonlinearity(valve=ServoValve(supply_pressure=1e300)),
    "wide spool": Nonlinearity(valve=ServoValve(spool_limit=1e300, spool_rate_limit=1e300)),
    "far stops": Nonlinearity(stops=StrokeStops(gap=1e300)),
    "infinite yield drift": Nonlinearity(yielding=Yielding(yield_drift=1e300)),
}


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("name", LIMITS)
def test_limit_cases_are_the_linear_plant_to_the_last_bit(name, compiled, monkeypatch):
    monkeypatch.setattr(numba_support, "COMPILED", compiled)
    linear = NonlinearDynamics.from_plant(PLANT, Nonlinearity(), 1e-3, 5)
    other = NonlinearDynamics.from_plant(PLANT, LIMITS[name], 1e-3, 5)
    rng = np.random.default_rng(0)
    state = np.zeros((3, linear.states))
    wide = np.zeros((3, other.states))
    for _ in range(50):
        current = rng.normal(0.0, 0.02, 3)
        one, two = linear.control_step(state, current), other.control_step(wide, current)
        state, wide = one.state, two.state
        # Slip states ride along in the same products, so that yielding matches to rounding, not to bits;
        # rounding of a sum is that of its largest terms. So does every part in the compiled update,
        # whose sums take four columns at a time: a part that is on moves their grouping.
        scaled = state / PLANT.state_scale[PLANT.layout.controlled]
        rounded = compiled or LIMITS[name].yielding.active
        tolerance = 1e-12 * np.max(np.abs(scaled)) if rounded else 0.0
        found = wide[:, : linear.states] / PLANT.state_scale[PLANT.layout.controlled]
        np.testing.assert_allclose(found, scaled, rtol=0, atol=tolerance)
        assert np.all(wide[:, linear.states :] == 0.0)


def test_without_parts_it_equals_the_lifted_linear_step():
    scenario = make_scenario("linear", {"stories": 3})
    lifted = scenario.discrete.lifted
    dynamics = NonlinearDynamics.from_plant(scenario.plant, Nonlinearity(), 1e-3, 5)
    layout = scenario.plant.layout
    rng = np.random.default_rng(1)
    scale = scenario.plant.state_scale
    full = np.zeros(layout.order)
    full[layout.controlled] = rng.normal(size=dynamics.states) * scale[layout.controlled]
    found = dynamics.control_step(full[layout.controlled], np.asarray(0.01))
    joined = np.concatenate([full, [0.01], np.zeros(lifted.state.shape[1] - layout.order - 1)])
    expected = (lifted.state @ joined)[layout.controlled]
    np.testing.assert_allclose(
        found.state / scale[layout.controlled], expected / scale[layout.controlled], rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(found.table_acceleration, lifted.outputs[:, 0] @ joined, rtol=1e-9)
    np.testing.assert_allclose(found.base_shear, lifted.outputs[:, 1] @ joined, rtol=1e-9)


def test_friction_and_stops_take_energy():
    velocity = np.linspace(-1.0, 1.0, 2001)
    friction = Friction(coulomb=300.0, static=400.0, viscous=20.0)
    assert np.all(friction.force(velocity) * velocity <= 0.0)
    assert friction.force(np.asarray(0.5)) == pytest.approx(-310.0, rel=1e-6)
    stops = StrokeStops(gap=0.07)
    depth = np.linspace(0.0, 0.01, 500)
    # A stop pushes back and never pulls: over a stroke in and out it gives back no more than it took.
    for speed in (0.1, 0.5):
        into, out = (stops.force(0.07 + depth, np.full_like(depth, v)) for v in (speed, -speed))
        assert np.all(into <= 0.0) and np.all(out <= 0.0)
        assert np.all(np.abs(into) >= np.abs(out))


def test_yielding_dissipates_and_keeps_its_limit():
    """A storey cycled through drift: energy only lost, force at the yield plateau, loop closed."""
    yielding = Yielding(yield_drift=0.004, stiffness_ratio=0.1, exponent=4.0)
    step, slip, dissipated = 1e-4, np.zeros(1), 0.0
    hysteretic, lost = [], []
    time = np.arange(0.0, 4.0, step)
    drift = 0.012 * np.sin(2 * np.pi * 0.5 * time)
    rate = np.gradient(drift, step)
    for d, v in zip(drift, rate, strict=True):
        slipping = yielding.slip_rate(np.array([d]), np.array([v]), slip)
        dissipated += float(((d - slip) * slipping)[0]) * step
        slip = slip + step * slipping
        hysteretic.append(float((d - slip)[0]))
        lost.append(dissipated)
    assert np.all(np.diff(lost) >= 0.0)
    # Explicit steps of 1e-4 s overshoot the plateau by their own error.
    assert max(hysteretic) == pytest.approx(0.004, rel=2e-3)
    # A full cycle of an elastoplastic loop: 4 z_y (d_max - z_y), less what the rounded knee gives away.
    cycle = lost[-1] - lost[len(lost) // 2 - 1]
    assert cycle == pytest.approx(4 * 0.004 * (0.012 - 0.004), rel=0.06)


DISSIPATING = {
    "friction": Nonlinearity(friction=Friction(coulomb=300.0, static=400.0, viscous=50.0)),
    "yielding": Nonlinearity(yielding=Yielding(yield_drift=0.004)),
    "both": Nonlinearity(
        friction=Friction(coulomb=300.0, static=400.0),
        yielding=Yielding(yield_drift=0.004, exponent=1.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DISSIPATING)
def test_the_kernel_creates_no_energy_by_friction_or_yielding(name):
    """Valve shut, tables let go from 32 states: what is stored falls in every physics step."""
    parts, plant = DISSIPATING[name], make_scenario("linear", {"stories": 3}).plant
    a, specimen, n = plant.actuator, plant.specimen, 3
    masses, stiffnesses = np.asarray(specimen.masses), np.asarray(specimen.stiffnesses)
    dynamics = NonlinearDynamics.from_plant(plant, parts, 1e-3, 1)
    state = np.zeros((32, dynamics.states))
    linear = slice(0, 4 + 2 * n)
    shape = (32, 4 + 2 * n)
    state[:, linear] = (
        0.5 * np.random.default_rng(7).normal(size=shape) * plant.state_scale[plant.layout.controlled]
    )
    state[:, SPOOL_POSITION] = 0.0
    # A drift beyond yielding has slipped: |z| above z_y is no state that a storey can be in.
    limit, elastic = parts.yielding.yield_drift, 1.0
    if parts.yielding.active:
        elastic = parts.yielding.stiffness_ratio
        drift = np.diff(state[:, 4 : 4 + n], prepend=0.0)
        state[:, 4 + 2 * n :] = drift - drift.clip(-limit, limit)
    energy, hysteretic, slipped = [], [], 0.0
    for _ in range(1500):
        floors, rates = state[:, 4 : 4 + n], state[:, 4 + n : 4 + 2 * n]
        slip = state[:, 4 + 2 * n :] if parts.yielding.active else np.zeros((32, n))
        drift = np.diff(floors, prepend=0.0)
        oil = state[:, 0] ** 2 * a.oil_volume / (8.0 * a.bulk_modulus)
        moving = 0.5 * a.table_mass * state[:, 2] ** 2
        moving = moving + 0.5 * (state[:, 2:3] + rates) ** 2 @ masses
        springs = 0.5 * (elastic * drift**2 + (1.0 - elastic) * (drift - slip) ** 2) @ stiffnesses
        energy.append(oil + moving + springs)
        hysteretic.append(np.max(np.abs(drift - slip)))
        slipped = max(slipped, float(np.max(np.abs(slip))))
        state = dynamics.control_step(state, np.zeros(32)).state
    energy = np.asarray(energy)
    assert np.all(np.diff(energy, axis=0) < 0.0)
    # More is lost than the linear table's own dampers take.
    if parts.yielding.active:
        assert slipped > 2.0 * limit
        # A step's own error may carry z past z_y, by second order in the step.
        assert max(hysteretic) < 1.03 * limit


def test_oil_flow_curve_is_the_orifice():
    valve = ServoValve(supply_pressure=21e6)
    pressure = np.array([-10.5e6, 0.0, 10.5e6, 20e6])
    expected = 1e-5 * np.sqrt(1.0 - pressure / 21e6)
    np.testing.assert_allclose(valve.opening(np.full(4, 1e-5), pressure), expected, rtol=1e-12)
    np.testing.assert_allclose(valve.opening(np.full(4, -1e-5), -pressure), -expected, rtol=1e-12)
    assert valve.opening(np.array([1e-5]), np.array([25e6])) < 2e-8


@pytest.mark.parametrize("delay", [1, 2, 5, 7, 12])
def test_a_delay_moves_the_response_by_its_physics_steps(delay):
    now, late = (
        NonlinearDynamics.from_plant(PLANT, Nonlinearity(), 1e-3, 5, delay=d) for d in (0, delay)
    )
    rng = np.random.default_rng(2)
    histories = []
    commands = rng.normal(0.0, 0.01, 60)
    for dynamics in (now, late):
        state, history = np.zeros(dynamics.states), []
        for current in commands:
            response = dynamics.control_step(state, np.asarray(current))
            state = response.state
            history.append(response.base_shear)
        histories.append(np.concatenate(history))
    np.testing.assert_allclose(histories[1][delay:], histories[0][:-delay], rtol=1e-9, atol=1e-9)
    assert np.all(histories[1][:delay] == 0.0)


def test_arrival_picks_one_command_for_each_physics_step():
    assert arrival(2, 5, 1).tolist() == [[1, 0], [1, 0], [0, 1], [0, 1], [0, 1]]
    assert np.all(arrival(12, 5, 3).sum(axis=1) == 1.0)


@pytest.mark.parametrize("name", [*SMOOTH, *KINKED])
def test_gradients_agree_with_finite_differences(name):
    parts = (SMOOTH | KINKED)[name]
    dynamics = NonlinearDynamics.from_plant(PLANT, parts, 1e-3, 5, delay=2)
    times = [period * PERIOD for period in range(24)]

    def cost(weights, library):
        zero = weights[0] * 0.0
        state = library.stack([zero] * dynamics.states)
        total = zero
        for time, weight in zip(times, weights, strict=True):
            response = model.control_step(state, drive(time) * weight)
            state = response.state
            total = (
                total + (response.table_acceleration**2).mean() + 1e-4 * (response.base_shear**2).mean()
            )
        return total

    model = dynamics.to(torch.zeros(1, dtype=torch.float64))
    weights = torch.full((24,), 1.1, dtype=torch.float64, requires_grad=True)
    cost(weights, torch).backward()
    model = dynamics
    point = weights.detach().numpy()
    for index in (2, 9, 17):
        step = np.zeros(24)
        step[index] = 1e-6
        finite = (cost(point + step, np) - cost(point - step, np)) / 2e-6
        # Relative to the largest derivative; a kink inside the difference's own step would show here.
        largest = float(weights.grad.abs().max())
        assert float(weights.grad[index]) == pytest.approx(finite, abs=1e-5 * largest)


def test_numpy_and_torch_step_alike():
    parts = KINKED["all"]
    dynamics = NonlinearDynamics.from_plant(PLANT, parts, 1e-3, 5, delay=3)
    tensor = dynamics.to(torch.zeros(1, dtype=torch.float64))
    state, other = np.zeros((4, dynamics.states)), torch.zeros((4, dynamics.states), dtype=torch.float64)
    rng = np.random.default_rng(3)
    scale = np.concatenate([controlled_scale(PLANT, parts), [0.025]])
    for _ in range(200):
        current = rng.normal(0.0, 0.01, 4)
        state = dynamics.control_step(state, current).state
        other = tensor.control_step(other, torch.from_numpy(current)).state
    np.testing.assert_allclose(other.numpy() / scale, state / scale, rtol=0, atol=1e-10)


def test_a_force_on_the_table_reaches_its_acceleration():
    plant = controlled_plant(PLANT, Nonlinearity())
    assert plant.D[0, 1 + FORCE] == pytest.approx(1.0 / 180.0)
    held = zero_order_hold(plant, 1e-3, controlled_scale(PLANT, Nonlinearity()))
    assert held.A.shape == (8, 8)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Friction(coulomb=-1.0), "coulomb"),
        (lambda: Friction(coulomb=100.0, static=50.0), "static"),
        (lambda: ServoValve(supply_pressure=0.0), "supply_pressure"),
        (lambda: ServoValve(natural_frequency=-2.0), "natural_frequency"),
        (lambda: StrokeStops(gap=-0.1), "gap"),
        (lambda: Yielding(yield_drift=0.0), "yield_drift"),
        (lambda: Yielding(stiffness_ratio=1.5), "stiffness_ratio"),
        (lambda: Yielding(exponent=0.5), "exponent"),
        (lambda: make_scenario("linear", {"delay": -1}), "delay"),
        (lambda: make_scenario("linear", {"delay": math.inf}), "delay"),
    ],
)
def test_bad_values_are_named(make, field):
    with pytest.raises(ParameterError, match=field):
        make()


def test_printed_equations_take_no_nonlinear_part():
    scenario = make_scenario("as-printed")
    assert scenario.equations == ModelEquations.as_printed()
    with pytest.raises(ScenarioError, match="corrected equations"):
        NonlinearDynamics.from_plant(scenario.plant, SMOOTH["friction"], 1e-3, 5)


def test_a_millisecond_resolves_friction_and_a_control_period_does_not():
    """What friction costs an LQR on a recorded motion, over the same in steps of a quarter of 1 ms."""

    def cost(step):
        options = {"nonlinearity.friction.coulomb": 300.0, "physics_step": step}
        scenario = make_scenario("linear", {"fields": options})
        quakes = recorded_earthquakes(scenario)[:1]
        return rollout(lqr(scenario), scenario, quakes)[0][0].cost

    fine = cost(2.5e-4)
    assert cost(1e-3) == pytest.approx(fine, rel=3e-3)
    assert cost(5e-3) > 1.4 * fine
