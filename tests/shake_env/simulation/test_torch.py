"""The kernel on torch tensors: same numbers as numpy, and true gradients."""

import subprocess
import sys

import numpy as np
import pytest

from baselines.lqr.sampled import sampled_lqr
from shake_env import ShakeTableEnv, ShakeTableVectorEnv, make_scenario
from shake_env.dynamics.ground import GroundPeriod
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.streams import earthquake_stream
from shake_env.simulation.transition import TableModel

torch = pytest.importorskip("torch")


def generators(env_seeds):
    return [np.random.default_rng(seed) for seed in env_seeds]


def ground_of(simulation, steps):
    """Copy the next `steps` control periods of every lane."""

    def copied(period):
        parts = (period.ground, period.reference, period.target, period.reference_shear)
        drive = None if period.drive is None else period.drive.copy()
        return GroundPeriod(*(part.copy() for part in parts), drive)

    return [copied(simulation.advance_ground()[0]) for _ in range(steps)]


def run(model, state, actions, ground):
    """Roll a batch through `transition`; costs and terminal state."""
    costs, states = [], []
    for action, period in zip(actions, ground, strict=True):
        outcome = model.transition(state, action, period)
        state = outcome.response.state
        costs.append(outcome.cost.total)
        states.append(state)
    return costs, states


def largest_difference(found, expected, scale):
    return np.max(np.abs(np.asarray(found) - np.asarray(expected)) / scale)


@pytest.mark.parametrize(
    "overrides",
    [{}, {"equations": "as_printed", "stories": 5, "highpass_frequency": 0.5}],
    ids=str,
)
def test_single_env_vector_lane_and_torch_agree_over_ten_seconds_and_an_autoreset(overrides):
    scenario = make_scenario("linear", {"duration": 10.0, "amplitude": 0.1, **overrides})
    period_steps = round(10.0 / scenario.control_period)
    steps = period_steps + 200  # into the second episode
    lanes, lane, seed = 5, 3, 40
    rng = np.random.default_rng(8)
    actions = rng.uniform(-0.1, 0.1, (steps + 1, lanes, 1)).astype(np.float32)
    scale = scenario.plant.state_scale

    vector = ShakeTableVectorEnv(lanes, scenario, autoreset_mode="SameStep")
    vector.reset(seed=seed)
    of_vector = [vector.step(action) for action in actions[:steps]]

    single = ShakeTableEnv(scenario)
    single.reset(seed=seed + lane)
    of_single = []
    for action in actions[:steps, lane]:
        of_single.append(single.step(action))
        if of_single[-1][3]:
            single.reset()

    # The ground rows of the same lane, then the plant in torch.
    source = Simulation(scenario, 1)
    stream = np.random.default_rng(seed + lane)
    model = TableModel.from_scenario(scenario).to(torch.zeros(1, dtype=torch.float64))
    of_torch = []
    for first, last in ((0, period_steps), (period_steps, steps)):
        source.start([0], [earthquake_stream(seed + lane)] if first == 0 else stream.spawn(1))
        state = torch.zeros((1, model.dynamics.states), dtype=torch.float64)
        for t in range(first, last):
            ground = source.advance_ground()[0].to(state)
            outcome = model.transition(
                state, torch.as_tensor(actions[t, lane], dtype=torch.float64), ground
            )
            state = outcome.response.state
            of_torch.append((outcome, model.full_state(state, ground)))

    first = scenario.plant.layout.filter_states
    table = scale[first : first + 4]
    names = {
        "load_pressure": (0, table[0]),
        "table_displacement": (1, table[1]),
        "table_velocity": (2, table[2]),
    }
    for t in range(steps):
        vector_info, single_info, (outcome, observed) = (
            of_vector[t][4],
            of_single[t][4],
            of_torch[t],
        )
        if "final_info" in vector_info:
            vector_info = vector_info["final_info"]
        state = outcome.response.state[0]
        for name, (index, size) in names.items():
            three = (vector_info[name][lane], single_info[name], float(state[index]))
            assert np.ptp(three) <= 1e-10 * size, (t, name)
        for name, series in (
            ("table_acceleration", outcome.response.table_acceleration),
            ("base_shear", outcome.response.base_shear),
        ):
            three = (vector_info[name][lane], single_info[name], float(series[0, -1]))
            assert np.ptp(three) <= 1e-10 * (1.0 + max(map(abs, three))), (t, name)
        three = (-of_vector[t][1][lane], -of_single[t][1], float(outcome.cost.total[0]))
        assert np.ptp(three) <= 1e-10 * (1.0 + max(three)), t
        # Observations are rounded to float32.
        last = of_single[t][0]
        assert np.max(np.abs(last - observed[0].numpy())) <= 1e-7 * (1.0 + np.max(np.abs(last)))
    assert of_single[period_steps - 1][3] and of_vector[period_steps - 1][3].all()


@pytest.mark.parametrize("kind", ["batch", "single"])
def test_leading_axes_are_the_batch_in_torch_too(kind):
    scenario = make_scenario("linear", {"stories": 3})
    model = TableModel.from_scenario(scenario)
    rng = np.random.default_rng(0)
    shape = {"batch": (4, 3), "single": ()}[kind]
    layout, k = scenario.plant.layout, scenario.substeps
    state = rng.standard_normal((*shape, 4 + 2 * layout.stories)) * scenario.plant.state_scale[2:12]
    action = rng.uniform(-1.5, 1.5, shape)
    ground = GroundPeriod(
        rng.standard_normal((*shape, 2)),
        rng.standard_normal((*shape, 6)),
        rng.standard_normal((*shape, k)),
        rng.standard_normal((*shape, k)),
        None,
    )
    expected = model.transition(state, np.asarray(action), ground)
    tensor = torch.as_tensor(state)
    found = model.to(tensor).transition(tensor, torch.as_tensor(action), ground.to(tensor))
    assert found.response.state.shape == (*shape, 10)
    for a, b in (
        (found.response.state, expected.response.state),
        (found.response.base_shear, expected.response.base_shear),
        (found.cost.total, expected.cost.total),
    ):
        assert largest_difference(a.numpy(), b, np.max(np.abs(b))) < 1e-13
    assert np.array_equal(found.broken.numpy(), expected.broken)


def cost_of_gain(scenario, ground, weights, model, like):
    """Mean stage cost of ``action = -weights . observation``, with autograd where tensors come in."""
    xp = torch if like is torch else np
    lanes = ground[0].target.shape[0]
    n = model.dynamics.states
    zero = xp.zeros((lanes, n), dtype=xp.float64)
    observation = xp.zeros((lanes, len(weights)), dtype=xp.float64)
    state, total = zero, 0.0
    for period in ground:
        outcome = model.transition(state, -(observation @ weights), period)
        state = outcome.response.state
        observation = model.full_state(state, period)
        total = total + outcome.cost.total.mean()
    return total / len(ground)


@pytest.mark.parametrize("overrides", [{}, {"equations": "as_printed", "stories": 3}], ids=str)
def test_gradient_of_an_episode_by_a_gain_agrees_with_finite_differences(overrides):
    scenario = make_scenario("linear", overrides)
    model = TableModel.from_scenario(scenario)
    simulation = Simulation(scenario, 4)
    simulation.start(range(4), generators(range(4)))
    ground = ground_of(simulation, 200)  # one second
    # Near the optimum the gradient vanishes; start from half the optimal gain.
    gain = 0.5 * sampled_lqr(make_scenario().discrete, scenario.stage_cost).gain[:6]
    n = scenario.plant.layout.order
    start = np.zeros(n)
    start[:6] = gain * scenario.plant.state_scale[:6] / scenario.current_limit
    start[6:] = np.random.default_rng(1).uniform(-0.02, 0.02, n - 6)

    weights = torch.tensor(start, dtype=torch.float64, requires_grad=True)
    like = weights.detach()
    cost = cost_of_gain(scenario, [p.to(like) for p in ground], weights, model.to(like), torch)
    assert cost.item() == pytest.approx(
        float(cost_of_gain(scenario, ground, start, model, np)), rel=1e-12
    )
    cost.backward()
    gradient = weights.grad.numpy()

    step = 1e-5
    numeric = np.empty(n)
    for i in range(n):
        sides = []
        for sign in (1.0, -1.0):
            moved = start.copy()
            moved[i] += sign * step
            sides.append(float(cost_of_gain(scenario, ground, moved, model, np)))
        numeric[i] = (sides[0] - sides[1]) / (2.0 * step)
    # Central differences: truncation of order step^2, rounding of order 1e-16 / step = 1e-11.
    assert np.max(np.abs(gradient - numeric)) < 1e-5 * np.max(np.abs(numeric))


def test_gradient_by_initial_state_and_actions_agrees_with_finite_differences():
    scenario = make_scenario("linear", {"stories": 2})
    model = TableModel.from_scenario(scenario)
    simulation = Simulation(scenario, 3)
    simulation.start(range(3), generators([5, 6, 7]))
    ground = ground_of(simulation, 60)
    rng = np.random.default_rng(2)
    scale = scenario.plant.state_scale[2:10]
    x0 = 0.1 * rng.standard_normal((3, 8))
    actions = rng.uniform(-0.2, 0.2, (60, 3))

    def total(x, u, m, rows):
        costs, _ = run(m, x, u, rows)
        return sum(c.sum() for c in costs)

    x = torch.tensor(x0, requires_grad=True)
    u = torch.tensor(actions, requires_grad=True)
    like = x.detach()
    cost = total(x * torch.as_tensor(scale), list(u), model.to(like), [p.to(like) for p in ground])
    cost.backward()
    by_state, by_action = x.grad.numpy(), u.grad.numpy()

    def value(x, u):
        return float(total(x * scale, list(u), model, ground))

    # The cost is quadratic: central differences carry rounding only, so the step may be large.
    for gradient, base, of in (
        (by_state, x0, lambda v: value(v, actions)),
        (by_action, actions, lambda v: value(x0, v)),
    ):
        for _ in range(12):
            direction = rng.standard_normal(base.shape)
            step = 1e-3
            numeric = (of(base + step * direction) - of(base - step * direction)) / (2.0 * step)
            assert np.sum(gradient * direction) == pytest.approx(
                numeric, rel=1e-5, abs=1e-6 * np.linalg.norm(gradient)
            )


def test_clipped_actions_have_no_gradient():
    scenario = make_scenario()
    like = torch.zeros(1, dtype=torch.float64)
    model = TableModel.from_scenario(scenario).to(like)
    simulation = Simulation(scenario, 2)
    simulation.start(range(2), generators([0, 1]))
    ground = simulation.advance_ground()[0].to(like)
    action = torch.tensor([1.5, 0.5], dtype=torch.float64, requires_grad=True)
    outcome = model.transition(torch.zeros((2, 8), dtype=torch.float64), action, ground)
    outcome.cost.total.sum().backward()
    assert outcome.current.tolist() == pytest.approx([0.125, 0.0625], rel=1e-15)
    assert action.grad[0] == 0.0 and action.grad[1] != 0.0


def test_single_precision_stays_close_to_double():
    scenario = make_scenario("linear", {"duration": 2.0})
    simulation = Simulation(scenario, 8)
    simulation.start(range(8), generators(range(8)))
    ground = ground_of(simulation, 400)
    actions = np.random.default_rng(4).uniform(-0.2, 0.2, (400, 8))
    model = TableModel.from_scenario(scenario)
    exact, _ = run(model, np.zeros((8, 8)), list(actions), ground)
    like = torch.zeros(1, dtype=torch.float32)
    rows = [p.to(like) for p in ground]
    short, states = run(
        model.to(like),
        torch.zeros((8, 8), dtype=torch.float32),
        list(torch.as_tensor(actions, dtype=torch.float32)),
        rows,
    )
    assert states[-1].dtype == torch.float32 and short[-1].dtype == torch.float32
    # 6e-8 a step, through an oil column whose memory is some hundred steps.
    total = torch.stack(short).double().sum(0).numpy()
    assert total == pytest.approx(np.sum(exact, axis=0), rel=1e-4)


def test_limits_are_found_on_tensors_as_on_arrays():
    scenario = make_scenario("linear", {"limits": "laboratory"})
    model = TableModel.from_scenario(scenario)
    simulation = Simulation(scenario, 5)
    simulation.start(range(5), generators(range(5)))
    ground = simulation.advance_ground()[0]
    state = np.zeros((5, 8))
    state[1, 1], state[2, 2], state[3, 0], state[4, 3] = 0.08, 0.7, 3e7, np.nan
    action = np.zeros(5)
    expected = model.transition(state, action, ground).broken
    tensor = torch.as_tensor(state)
    found = model.to(tensor).transition(tensor, torch.as_tensor(action), ground.to(tensor))
    assert found.broken.tolist() == list(expected)
    # A displaced table stays displaced; the fast, the pressed and the lost one break what they break.
    assert expected[0] == 0 and expected[1] == 2 and expected[4] == 1
    assert all(expected[2:] > 0)


@pytest.mark.parametrize("package", ["shake_env", "baselines.lqr.sampled"])
def test_importing_the_physics_does_not_import_torch(package):
    code = (
        f"import sys, {package}; found = [m for m in ('torch', 'stable_baselines3', 'matplotlib') "
        "if m in sys.modules]; sys.exit(', '.join(found) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
