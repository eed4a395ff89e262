"""The ground ahead of time: lanes, blocks, statistics, and recorded motions against scipy."""

import math

import numpy as np
import pytest
from ground_periods import MOTIONS, PARTS, joined, keys, taken
from scipy.signal import lsim

from shake_env import RECORD_NAMES, Envelope, FilteredNoise, RecordedMotion, make_scenario, numba_support
from shake_env.dynamics.ground import filter_state
from shake_env.errors import ParameterError
from shake_env.model.plant import specimen_plant
from shake_env.model.random_numbers import GROUND, normals
from shake_env.motion.targets import control_steps, target_history
from shake_env.simulation.excitation import Excitation
from shake_env.simulation.simulation import Simulation


@pytest.mark.parametrize("equations", ["corrected", "as_printed"])
def test_lanes_of_a_batch_are_lanes_alone(equations):
    """Mixed motions, starts in the middle of a block, restarts with another kind of motion."""
    scenario = make_scenario("linear", {"stories": 3, "equations": equations})
    starts = {  # control step: lanes that begin there, with a motion and a seed
        0: [(0, 0, 1), (1, 1, 2), (2, 2, 3)],
        17: [(3, 3, 4)],
        50: [(4, 4, 5)],
        64: [(1, 0, 6)],  # from a record to noise, at a block's edge
        90: [(0, 3, 7)],  # from noise to a record
        130: [(2, 4, 8), (3, 2, 9)],
    }
    batch = Excitation(scenario.discrete, 5)
    rows, running = [], {}
    alone = {}
    for t in range(300):
        for lane, motion, seed in starts.get(t, []):
            batch.start([lane], [MOTIONS[motion]], keys(seed))
            alone[lane] = Excitation(scenario.discrete, 1)
            alone[lane].start([0], [MOTIONS[motion]], keys(seed))
            running[lane] = t
        period = batch.advance()
        rows.append(period)
        for lane, single in alone.items():
            expected = single.advance()
            for part in (*PARTS, "drive"):
                a, b = getattr(period, part), getattr(expected, part)
                if b is None:
                    assert a is None
                    continue
                size = 1e-12 * max(1.0, np.max(np.abs(b)))
                assert np.max(np.abs(a[lane] - b[0])) <= size, (t, lane, part)


def test_starting_all_lanes_at_once_or_one_by_one_is_the_same():
    scenario = make_scenario()
    at_once, one_by_one = Excitation(scenario.discrete, 5), Excitation(scenario.discrete, 5)
    at_once.start(range(5), MOTIONS, keys(*range(5)))
    for lane in range(5):
        one_by_one.start([lane], [MOTIONS[lane]], keys(lane))
    for _ in range(150):
        a, b = taken(at_once), taken(one_by_one)
        for part in PARTS:
            assert a[part] == pytest.approx(b[part], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("highpass", [None, 0.5])
def test_stationary_variances_of_target_and_reference_shear(highpass):
    scenario = make_scenario("linear", {"highpass_frequency": highpass, "control_rate": 100.0})
    lanes, steps, warm_up = 400, 1000, 300
    excitation = Excitation(scenario.discrete, lanes)
    excitation.start(
        range(lanes),
        [FilteredNoise(duration=10.0, amplitude=0.7)] * lanes,
        keys(*([2009, i] for i in range(lanes))),
    )
    squares = np.zeros((2, lanes))
    for t in range(steps):
        period = excitation.advance()
        if t >= warm_up:
            squares[0] += np.mean(period.target**2, axis=-1)
            squares[1] += np.mean(period.reference_shear**2, axis=-1)
    # 3 s of warm-up: the slowest pole (2.7 rad/s; 2.2 with the high-pass) leaves exp(-13) at most.
    mean = squares / (steps - warm_up)
    plant = scenario.plant
    for found, expected in zip(
        mean, (plant.target_variance, plant.reference_shear_variance), strict=True
    ):
        # Lanes are independent; 3.3 standard errors of their mean leave one seed in 1000.
        error = np.std(found, ddof=1) / math.sqrt(lanes)
        assert abs(np.mean(found) - 0.49 * expected) < 3.3 * error
        assert 3.3 * error < 0.05 * expected


def test_envelope_scales_the_noise_ahead_of_the_filter():
    """With the same draws: a slow envelope's target is close to envelope times the stationary one."""
    scenario = make_scenario("linear", {"control_rate": 1000.0})
    envelope = Envelope(rise=4.0, hold=2.0, decay_rate=0.2)
    outputs = []
    for shape in (None, envelope):
        excitation = Excitation(scenario.discrete, 1)
        motion = FilteredNoise(duration=12.0, envelope=shape)
        excitation.start([0], [motion], keys(0))
        outputs.append(np.array([taken(excitation)["target"][0, -1] for _ in range(12000)]))
    stationary, shaped = outputs
    time = 1e-3 * np.arange(1, 12001)
    error = shaped - envelope.at(time) * stationary
    assert np.std(error) < 0.1 * np.std(stationary)
    # During the hold the filter forgets how it came there.
    hold = (time > 5.5) & (time < 6.0)
    assert np.max(np.abs(error[hold])) < 0.05 * np.max(np.abs(stationary))


def test_envelope_is_taken_at_the_middle_of_each_physics_step():
    scenario = make_scenario()
    envelope = Envelope(rise=0.3, hold=0.1, decay_rate=3.0)
    discrete, layout = scenario.discrete, scenario.plant.layout
    excitation = Excitation(discrete, 1)
    motion = FilteredNoise(duration=1.0, amplitude=0.6, envelope=envelope)
    excitation.start([0], [motion], keys(5))
    found = joined([taken(excitation) for _ in range(200)])["target"][:, 0].ravel()
    rank = discrete.noise.shape[1]
    draws = normals(keys(5)[0], np.arange(200), GROUND, 5 * rank).reshape(1000, rank)
    x, expected = np.zeros(layout.order), []
    for j, draw in enumerate(draws):
        intensity = 0.6 * envelope.at(np.array((j + 0.5) * 1e-3))
        x = discrete.model.A @ x + discrete.noise @ (intensity * draw)
        expected.append((discrete.model.C @ x)[2])
    assert np.max(np.abs(found - expected)) < 1e-12 * np.max(np.abs(expected))


def test_envelope_does_not_depend_on_when_a_lane_starts():
    # A lane that starts at another time must see the same envelope.
    scenario = make_scenario()
    motion = FilteredNoise(duration=5.0, envelope=Envelope(rise=1.0, hold=0.2, decay_rate=3.0))
    histories = []
    for offset in (0, 1, 33):
        excitation = Excitation(scenario.discrete, 1)
        excitation.start([0], [FilteredNoise()], keys(99))
        for _ in range(offset):
            excitation.advance()
        excitation.start([0], [motion], keys(1))
        histories.append(joined([taken(excitation) for _ in range(200)])["target"])
    for other in histories[1:]:
        assert other == pytest.approx(histories[0], rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("name", RECORD_NAMES)
@pytest.mark.parametrize("highpass", [None, 0.5])
def test_recorded_target_and_reference_shear(name, highpass):
    scenario = make_scenario("linear", {"record": name, "stories": 5, "highpass_frequency": highpass})
    motion, k = scenario.motion, scenario.substeps
    history = target_history(motion, 1e-3)
    steps = control_steps(motion, scenario.control_period, 1e-3)
    excitation = Excitation(scenario.discrete, 1)
    start = excitation.start([0], [motion], keys(0))
    rows = joined([taken(excitation) for _ in range(steps)])
    # The target at every physics step is the resampled record, bit by bit.
    target = rows["target"][:, 0].ravel()
    assert np.array_equal(target, history.acceleration[1 : 1 + steps * k])
    # The reference's base shear, by scipy on scaled states with straight lines between samples.
    building = specimen_plant(scenario.specimen)
    T = scenario.plant.state_scale[scenario.plant.layout.reference]
    scaled = (building.A * T / T[:, None], building.B / T[:, None], building.C * T, building.D)
    count = steps * k + 1
    _, shear, states = lsim(scaled, history.acceleration[:count], 1e-3 * np.arange(count))
    found = rows["reference_shear"][:, 0].ravel()
    assert np.max(np.abs(found - shear[1:])) < 1e-8 * np.max(np.abs(shear))
    found = rows["reference"][:, 0] / T
    assert np.max(np.abs(found - states[k::k])) < 1e-8 * np.max(np.abs(states))
    # The filter state gives the target back: C_W x_W = y~.
    output = scenario.plant.coupled.C[2, scenario.plant.layout.ground]
    ground = rows["ground"][:, 0]
    assert np.max(np.abs(ground @ output - target[k - 1 :: k])) < 1e-8 * np.max(np.abs(target))
    assert start.ground[0] @ output == pytest.approx(history.acceleration[0], rel=1e-8, abs=1e-12)
    assert not np.any(start.reference) and not np.any(start.target)


@pytest.mark.parametrize("name", [RECORD_NAMES[0], RECORD_NAMES[4]])
@pytest.mark.parametrize("highpass", [None, 0.5])
def test_filter_state_of_a_record_is_a_motion_of_the_filter(name, highpass):
    """Its rows are integrals of each other, as the filter's own are; w is what remains."""
    scenario = make_scenario("linear", {"record": name, "highpass_frequency": highpass})
    history = target_history(scenario.motion, 1e-3)
    state = filter_state(scenario.ground, history, scenario.physics_step)
    assert state.shape == (len(history.acceleration), 2 if highpass is None else 4)
    A = scenario.plant.coupled.A[scenario.plant.layout.ground, scenario.plant.layout.ground]
    rate, modelled = np.diff(state, axis=0) / 1e-3, 0.5 * (state[1:] + state[:-1]) @ A.T
    # All rows but that of x_w', which the noise drives. The removed drift leaves a constant; the
    # running sum of the source leaves half a step.
    for row in [0] if highpass is None else [0, 2, 3]:
        difference = rate[:, row] - modelled[:, row]
        size = np.max(np.abs(rate[:, row]))
        assert np.std(difference) < 5e-3 * size, row
        assert abs(np.mean(difference)) < 2e-2 * size, row


def test_highpass_keeps_the_ground_within_bounds():
    """The Kanai-Tajimi ground walks away; with the second filter its displacement is stationary."""
    scenario = make_scenario("linear", {"highpass_frequency": 0.5, "control_rate": 100.0})
    lanes = 50
    excitation = Excitation(scenario.discrete, lanes)
    excitation.start(
        range(lanes),
        [FilteredNoise(duration=60.0)] * lanes,
        keys(*range(lanes)),
    )
    rows = joined([taken(excitation) for _ in range(6000)])
    x = rows["ground"][:, :, 2]
    early, late = np.std(x[1000:3000]), np.std(x[4000:])
    assert late == pytest.approx(early, rel=0.1)
    assert np.max(np.abs(x)) < 6.0 * np.std(x[1000:])
    # Its second derivative is the target. y~ itself walks by s = 2 zeta_g omega_g sqrt(dt) a step, so
    # trapezoids miss v by s dt / sqrt(12) and x by s dt^2 / 12, five of which are allowed.
    fine = make_scenario("linear", {"highpass_frequency": 0.5, "control_rate": 1000.0})
    excitation = Excitation(fine.discrete, 1)
    excitation.start([0], [FilteredNoise(duration=5.0)], keys(3))
    rows = joined([taken(excitation) for _ in range(5000)])
    y, x, v = rows["target"][:, 0, -1], rows["ground"][:, 0, 2], rows["ground"][:, 0, 3]
    s = 2.0 * 1.4 * (2.0 * math.pi * 1.1) * math.sqrt(1e-3)
    missed_x = np.diff(x) - 0.5e-3 * (v[1:] + v[:-1])
    missed_v = np.diff(v) - 0.5e-3 * (y[1:] + y[:-1])
    assert np.max(np.abs(missed_x)) < 5.0 * s * 1e-3**2 / 12.0 < 1e-3 * np.max(np.abs(np.diff(x)))
    assert np.max(np.abs(missed_v)) < 5.0 * s * 1e-3 / math.sqrt(12.0)
    # White, so that it does not add up: a wrong relation would drift.
    assert abs(np.sum(missed_v)) < 4.0 * s * 1e-3 / math.sqrt(12.0) * math.sqrt(5000)


def test_ground_filter_states_follow_their_own_equation():
    scenario = make_scenario("linear", {"control_rate": 1000.0})
    excitation = Excitation(scenario.discrete, 1)
    excitation.start([0], [FilteredNoise(duration=5.0)], keys(0))
    rows = joined([taken(excitation) for _ in range(5000)])
    x_w, v_w = rows["ground"][:, 0].T
    assert rows["target"][:, 0, -1] == pytest.approx(
        2 * 1.4 * (2 * math.pi * 1.1) * v_w, rel=1e-9, abs=1e-9
    )
    w = np.diff(v_w) - 1e-3 * 0.5 * (
        -((2 * math.pi * 1.1) ** 2) * (x_w[1:] + x_w[:-1])
        - 2 * 1.4 * (2 * math.pi * 1.1) * (v_w[1:] + v_w[:-1])
    )
    # What remains is a step of a Wiener process: variance dt, white. 5000 steps: 2 % and 1.4 %.
    assert np.var(w) == pytest.approx(1e-3, rel=3.3 * math.sqrt(2 / 5000))
    assert abs(np.corrcoef(w[1:], w[:-1])[0, 1]) < 3.3 / math.sqrt(5000)


@pytest.mark.parametrize(
    "motion",
    [FilteredNoise(duration=1e-3), RecordedMotion(record="napa2014_68150_hne", duration=4e-3)],
)
def test_too_short_a_motion_raises(motion):
    with pytest.raises(ParameterError, match=r"duration = 0.00.*at least one control period"):
        control_steps(motion, 5e-3, 1e-3)


def test_amplitude_does_not_change_the_draws():
    histories = []
    for amplitude in (1.0, 0.5):
        scenario = make_scenario()
        excitation = Excitation(scenario.discrete, 1)
        excitation.start([0], [FilteredNoise(amplitude=amplitude)], keys(0))
        histories.append(joined([taken(excitation) for _ in range(100)])["target"])
    assert histories[1] == pytest.approx(0.5 * histories[0], rel=1e-12, abs=1e-15)


def test_the_order_in_which_lanes_begin_does_not_matter():
    discrete = make_scenario().discrete
    found = []
    for order in ([0, 1, 2, 3], [0, 2, 1, 3]):
        excitation = Excitation(discrete, 4)
        excitation.start(order, [FilteredNoise()] * 4, keys(*order))
        found.append(excitation.advance().target.copy())
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("name", ["linear", "yielding"])
def test_the_compiled_ground_is_the_references(name, own, monkeypatch):
    """Noise and records side by side, more lanes than a block of the kernel, restarts within one."""
    pytest.importorskip("numba")
    spread = {"fields": {"uncertainty.mass_ratio": [0.1, 1.0]}} if own else {}
    scenario = make_scenario(name, {"stories": 3, "amplitude": 2.0, **spread})
    lanes = 70

    def followed(compiled):
        monkeypatch.setattr(numba_support, "COMPILED", compiled)
        simulation = Simulation(scenario, lanes)
        motions = [MOTIONS[lane % len(MOTIONS)] for lane in range(lanes)]
        streams = [np.random.default_rng(lane) for lane in range(lanes)]
        simulation.start(range(lanes), streams, motions)
        rows = []
        for t in range(150):
            if t == 90:
                again = [69, 3, 31]
                streams = [np.random.default_rng(100 + lane) for lane in again]
                simulation.start(again, streams, [MOTIONS[1], MOTIONS[0], MOTIONS[3]])
            period, _ = simulation.advance_ground()
            rows.append({part: getattr(period, part).copy() for part in PARTS})
        return joined(rows)

    ours, theirs = followed(True), followed(False)
    for part in PARTS:
        size = np.abs(theirs[part]).max(axis=(0, 1))
        # The same sums in another order than BLAS's, carried on over a thousand physics steps.
        assert np.all(np.abs(ours[part] - theirs[part]) <= 1e-11 * size)
