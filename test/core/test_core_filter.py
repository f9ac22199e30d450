import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from fnn_ekf_ros.core.adaptation import Adaptation
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.filter import (
    NOMINAL_PERIOD_S,
    FilterModel,
    StepInput,
    for_mode,
    reset_pose,
    start_filter,
    step,
)
from fnn_ekf_ros.core.joint import calm_noise
from fnn_ekf_ros.core.motion import MotionModel, displacement, move

Covariances = Callable[[np.random.Generator, int, int], FloatArray]
BOTH_MODELS = pytest.mark.parametrize("model", list(MotionModel))
ALL_ROWS = np.ones(4, dtype=np.bool_)
NO_ROWS = np.zeros(4, dtype=np.bool_)
START = np.array([1.0, 2.0, 0.5])
START_COVARIANCE = np.array([[0.04, 0.01, 0.0], [0.01, 0.05, 0.002], [0.0, 0.002, 0.01]])


def random_periods(
    rng: np.random.Generator, steps: int, batch: tuple[int, ...] = ()
) -> list[StepInput]:
    """Periods of a robot near START, with late and reported measurements."""
    periods = []
    for _ in range(steps):
        control = rng.uniform([-0.1, 0.02], [0.2, 0.3], (*batch, 2))
        part = rng.random((*batch, 4, 1))
        root = 0.1 * rng.standard_normal((*batch, 4, 4))
        periods.append(
            StepInput(
                control=control,
                measurement=rng.normal([1.0, 2.0, 0.5, 0.5], 0.3, (*batch, 4)),
                available=rng.random((*batch, 4)) < 0.6,
                control_at_measurement=part * control[..., None, :],
                measurement_covariance=root @ np.swapaxes(root, -1, -2) + 0.01 * np.eye(4),
            )
        )
    return periods


def arrays_of(*values: NamedTuple) -> list[np.ndarray[Any, Any]]:
    found: list[np.ndarray[Any, Any]] = []
    for value in values:
        for part in value:
            if isinstance(part, tuple):
                found += arrays_of(part)  # type: ignore[arg-type]
            elif part is not None:
                found.append(part)
    return found


def bytes_of(*values: NamedTuple) -> list[bytes]:
    return [array.tobytes() for array in arrays_of(*values)]


def one_of_batch(value: Any, index: tuple[int, ...]) -> Any:
    """Return the tuple of arrays with the batch dimensions taken away."""
    parts = [
        one_of_batch(part, index) if isinstance(part, tuple) else
        None if part is None else part[index]
        for part in value
    ]  # fmt: skip
    return type(value)(*parts)


@pytest.mark.parametrize("mode", ["none", "r", "q", "rq", "joint"])
def test_step_changes_none_of_its_arguments_and_repeats_itself(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    model = make_model(adaptation=make_adaptation(mode=mode, window_length=6))
    state = start_filter(model, START, START_COVARIANCE)
    for period in random_periods(np.random.default_rng(60), 30):
        before = bytes_of(state, period)
        for array in arrays_of(state, period):
            array.flags.writeable = False
        first, second = step(model, state, period), step(model, state, period)
        assert bytes_of(*first) == bytes_of(*second)
        assert bytes_of(state, period) == before
        state = first[0]


@pytest.mark.parametrize("mode", ["none", "r", "q", "rq", "joint"])
@BOTH_MODELS
def test_batch_equals_single_filters(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    mode: str,
    model: MotionModel,
) -> None:
    batch = (2, 2)
    filter_model = make_model(
        motion_model=model, adaptation=make_adaptation(mode=mode, window_length=6)
    )
    rng = np.random.default_rng(61)
    mean = START + 0.1 * rng.standard_normal((*batch, 3))
    together = start_filter(filter_model, mean, START_COVARIANCE)
    alone = {i: start_filter(filter_model, mean[i], START_COVARIANCE) for i in np.ndindex(*batch)}
    for period in random_periods(rng, 60, batch):
        together, result = step(filter_model, together, period)
        for i in np.ndindex(*batch):
            alone[i], single = step(filter_model, alone[i], one_of_batch(period, i))
            expected = arrays_of(alone[i], single)
            got = arrays_of(one_of_batch(together, i), one_of_batch(result, i))
            for one, other in zip(got, expected, strict=True):
                np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("mode", ["r", "joint"])
def test_one_period_serves_a_whole_batch(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    """Filters with different noise beside each other share what the sensors said."""
    model = make_model(adaptation=make_adaptation(mode=mode, window_length=6))
    noise = np.array([0.2, 1.0, 5.0])[:, None] * np.array(model.measurement_noise)
    shared = start_filter(model, np.tile(START, (3, 1)), START_COVARIANCE, measurement_noise=noise)
    spread = shared
    for everything in random_periods(np.random.default_rng(62), 20):
        period = everything._replace(control_at_measurement=None)
        copied: list[Any] = [None if a is None else np.stack([a] * 3) for a in period]
        copies = StepInput(*copied)
        shared, spread = step(model, shared, period)[0], step(model, spread, copies)[0]
        for one, other in zip(arrays_of(shared), arrays_of(spread), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("mode", ["none", "joint"])
def test_one_period_with_late_measurements_serves_a_whole_batch(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    model = make_model(adaptation=make_adaptation(mode=mode))
    state = start_filter(model, np.tile(START, (3, 1)), START_COVARIANCE)
    step(model, state, random_periods(np.random.default_rng(63), 1)[0])


@BOTH_MODELS
def test_without_adaptation_the_run_equals_the_textbook_filter(
    make_model: Callable[..., FilterModel], textbook_step: Any, model: MotionModel
) -> None:
    """The steps together: prediction with Q of the period, correction with R, masks."""
    filter_model = make_model(motion_model=model, period_s=0.15)
    Q = np.diag(filter_model.process_noise) * 0.15 / 0.375
    R = np.diag(filter_model.measurement_noise)
    state = start_filter(filter_model, START, START_COVARIANCE)
    x, P = START, START_COVARIANCE
    paper = model is MotionModel.PAPER
    for everything in random_periods(np.random.default_rng(64), 300):
        period = everything._replace(control_at_measurement=None, measurement_covariance=None)
        rows = [int(row) for row in np.flatnonzero(period.available)]
        before = textbook_step(paper, x, P, period.control, Q, period.measurement, R, [])
        x, P = textbook_step(paper, x, P, period.control, Q, period.measurement, R, rows)
        state, result = step(filter_model, state, period)
        np.testing.assert_allclose(state.mean[:2], x[:2], atol=1e-10, rtol=0.0)
        assert abs(math.remainder(state.mean[2] - x[2], 2.0 * math.pi)) < 1e-10
        np.testing.assert_allclose(state.covariance, P, atol=1e-12, rtol=0.0)
        variance = np.diag(before[1])[[0, 1, 2, 2]] + np.diag(R)
        np.testing.assert_allclose(result.innovation_variance, variance, rtol=1e-10)
        assert result.degrees_of_freedom == len(rows)
    assert state.process_noise.tobytes() == np.array(filter_model.process_noise).tobytes()
    assert state.measurement_noise.tobytes() == np.array(filter_model.measurement_noise).tobytes()


@pytest.mark.parametrize("mode", ["r", "q", "rq"])
def test_adaptation_changes_nothing_before_it_has_learned_something(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    """The first step of the adapted noise is the one after the window is ready."""
    adaptive = make_model(adaptation=make_adaptation(mode=mode, window_length=45))
    state = start_filter(adaptive, START, START_COVARIANCE)
    plain = start_filter(make_model(), START, START_COVARIANCE)
    for i, masked in enumerate(random_periods(np.random.default_rng(65), 16)):
        period = masked._replace(available=ALL_ROWS)
        state, plain = step(adaptive, state, period)[0], step(make_model(), plain, period)[0]
        same = bytes_of(state._replace(gate=plain.gate)) == bytes_of(plain)
        # A third of 45 innovations: after the 15th the noise moves, and the 16th feels it.
        assert same == (i < 14)
        assert (state.mean.tobytes() == plain.mean.tobytes()) == (i < 15)


def arc_pose(start: FloatArray, control: FloatArray) -> FloatArray:
    """Where an arc from `start` ends; radius form."""
    radius = control[0] / control[1]
    end = start[2] + control[1]
    return np.array(
        [
            start[0] + radius * (math.sin(end) - math.sin(start[2])),
            start[1] + radius * (math.cos(start[2]) - math.cos(end)),
            end,
        ]
    )


@pytest.mark.parametrize("heading", [0.5, 3.1, -2.0])
def test_measurements_inside_the_period_are_carried_exactly_along_an_arc(
    make_model: Callable[..., FilterModel], heading: float
) -> None:
    """Noise-free arc, every row sampled at another instant: no innovation is left."""
    model, parts = make_model(), (0.1, 0.45, 0.7, 1.0)
    truth = np.array([1.0, 2.0, heading])
    state = start_filter(model, truth, START_COVARIANCE)
    for control in (np.array([0.4, 0.5]), np.array([-0.2, 0.9]), np.array([0.3, -1.4])):
        seen = [arc_pose(truth, part * control) for part in parts]
        measurement = np.array([seen[0][0], seen[1][1], seen[2][2], seen[3][2]])
        at = np.array([part * control for part in parts])
        state, result = step(model, state, StepInput(control, measurement, ALL_ROWS, at))
        truth = arc_pose(truth, control)
        np.testing.assert_allclose(result.innovation, 0.0, atol=1e-14)
        np.testing.assert_allclose(state.mean[:2], truth[:2], rtol=0.0, atol=1e-14)
        assert abs(math.remainder(state.mean[2] - truth[2], 2.0 * math.pi)) < 1e-14


@BOTH_MODELS
def test_carrying_adds_the_motion_since_the_measurement(
    make_model: Callable[..., FilterModel], model: MotionModel
) -> None:
    """What is added is the model's own way from the instant to the end, per row."""
    control = np.array([0.4, 0.5])
    parts = np.array([0.0, 0.3, 0.6, 0.9])
    at = parts[:, None] * control
    state = start_filter(make_model(motion_model=model), START, START_COVARIANCE)
    z = np.array([1.2, 2.3, 0.9, 1.1])
    _, late = step(make_model(motion_model=model), state, StepInput(control, z, ALL_ROWS, at))
    _, direct = step(make_model(motion_model=model), state, StepInput(control, z, ALL_ROWS))
    end = displacement(model, START[2], control)
    since = [end - displacement(model, START[2], part) for part in at]
    added = [since[0][0], since[1][1], since[2][2], since[3][2]]
    np.testing.assert_allclose(late.innovation - direct.innovation, added, rtol=0.0, atol=1e-15)
    assert np.all(np.abs(added) > 1e-3)


def test_measured_at_the_end_is_not_carried(make_model: Callable[..., FilterModel]) -> None:
    control = np.array([0.4, 0.5])
    state = start_filter(make_model(), START, START_COVARIANCE)
    z, at = np.array([1.2, 2.3, 0.9, 1.1]), np.broadcast_to(control, (4, 2))
    late = step(make_model(), state, StepInput(control, z, ALL_ROWS, at))
    direct = step(make_model(), state, StepInput(control, z, ALL_ROWS))
    assert bytes_of(*late) == bytes_of(*direct)


@pytest.mark.parametrize("mode", ["none", "joint"])
def test_missing_rows_may_hold_anything(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    """Not-a-number in the masked rows' measurement and control."""
    model = make_model(adaptation=make_adaptation(mode=mode))
    available = np.array([True, False, True, False])
    control = np.array([0.4, 0.5])
    z, at = np.array([1.2, 2.3, 0.9, 1.1]), 0.5 * np.tile(control, (4, 1))
    state = start_filter(model, START, START_COVARIANCE)
    clean = step(model, state, StepInput(control, z, available, at))
    z, at = z.copy(), at.copy()
    z[~available], at[~available] = np.nan, np.nan
    dirty = step(model, state, StepInput(control, z, available, at))
    assert bytes_of(*clean) == bytes_of(*dirty)


@pytest.mark.parametrize("mode", ["none", "joint"])
def test_missing_rows_may_hold_anything_in_the_reported_covariance(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation], mode: str
) -> None:
    model = make_model(adaptation=make_adaptation(mode=mode))
    available = np.array([True, True, False, False])
    covariance = np.full((4, 4), np.nan)
    covariance[:2, :2] = [[0.01, 0.002], [0.002, 0.02]]
    state = start_filter(model, START, START_COVARIANCE)
    z = np.array([1.2, 2.3, np.nan, np.nan])
    period = StepInput(np.array([0.1, 0.1]), z, available, None, covariance)
    for _ in range(4):
        state, result = step(model, state, period)
    assert all(np.all(np.isfinite(array)) for array in arrays_of(state, result))


def test_reported_covariance_is_multiplied_by_the_adapted_scale(
    make_model: Callable[..., FilterModel], textbook_step: Any, random_covariances: Covariances
) -> None:
    """R of row i and j times the root of both rows' (adapted / started)."""
    model, control = make_model(), np.array([0.4, 0.5])
    scale = np.array([4.0, 0.25, 9.0, 1.0])
    reported = 0.02 * random_covariances(np.random.default_rng(66), 1, 4)[0]
    adapted = scale * np.array(model.measurement_noise)
    state = start_filter(model, START, START_COVARIANCE, measurement_noise=adapted)
    z = np.array([1.5, 2.1, 1.2, 0.9])
    after, result = step(model, state, StepInput(control, z, ALL_ROWS, None, reported))
    R = np.array(
        [[reported[i, j] * math.sqrt(scale[i] * scale[j]) for j in range(4)] for i in range(4)]
    )
    x, P = textbook_step(
        False, START, START_COVARIANCE, control, np.diag(model.process_noise), z, R, [0, 1, 2, 3]
    )
    np.testing.assert_allclose(after.mean, x, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(after.covariance, P, rtol=0.0, atol=1e-12)
    _, unscaled = step(
        model,
        start_filter(model, START, START_COVARIANCE),
        StepInput(control, z, ALL_ROWS, None, reported),
    )
    np.testing.assert_allclose(
        result.innovation_variance - unscaled.innovation_variance,
        np.diag(reported) * (scale - 1.0),
        rtol=0.0,
        atol=1e-14,
    )


def test_reported_covariance_alone_is_used_before_anything_was_adapted(
    make_model: Callable[..., FilterModel],
) -> None:
    state = start_filter(make_model(), START, START_COVARIANCE)
    period = StepInput(np.array([0.4, 0.5]), np.array([1.5, 2.1, 1.2, 0.9]), ALL_ROWS)
    reported = np.diag(np.array(make_model().measurement_noise))
    plain = step(make_model(), state, period)
    with_report = step(make_model(), state, period._replace(measurement_covariance=reported))
    for one, other in zip(arrays_of(*plain), arrays_of(*with_report), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14)


@pytest.mark.parametrize("period_s", [0.375, 0.1, 1.5])
def test_process_noise_grows_with_the_period(
    make_model: Callable[..., FilterModel], period_s: float
) -> None:
    model, control = make_model(period_s=period_s), np.array([0.4, 0.5])
    state = start_filter(model, START, START_COVARIANCE)
    after, _ = step(model, state, StepInput(control, np.zeros(4), NO_ROWS))
    motion = move(MotionModel.EXACT_ARC, START, control)
    A, W = motion.motion_jacobian, motion.noise_jacobian
    Q = np.diag(model.process_noise) * period_s / 0.375
    expected = A @ START_COVARIANCE @ A.T + W @ Q @ W.T
    np.testing.assert_allclose(after.covariance, expected, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(after.process_noise, model.process_noise)
    assert NOMINAL_PERIOD_S == 0.375


def test_start_takes_its_noise_from_the_model_or_from_its_caller(
    make_model: Callable[..., FilterModel],
) -> None:
    model = make_model()
    mean = np.zeros((2, 5, 3))
    state = start_filter(model, mean, np.eye(3))
    assert state.covariance.shape == (2, 5, 3, 3)
    assert state.window.squares.shape == (2, 5, 45, 4)
    np.testing.assert_array_equal(state.process_noise[1, 4], model.process_noise)
    np.testing.assert_array_equal(state.measurement_noise[1, 4], model.measurement_noise)
    assert not np.any(state.window.counts)
    Q, R = np.array([1.0, 2.0]), np.arange(1.0, 11.0)[:, None].reshape(2, 5, 1) * np.ones(4)
    state = start_filter(model, mean, np.eye(3), Q, R)
    np.testing.assert_array_equal(state.process_noise[0, 3], Q)
    np.testing.assert_array_equal(state.measurement_noise, R)


def test_new_pose_keeps_the_noise_and_forgets_the_innovations(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation]
) -> None:
    model = make_model(adaptation=make_adaptation(mode="r", window_length=6))
    state = start_filter(model, START, START_COVARIANCE)
    for period in random_periods(np.random.default_rng(67), 20):
        state, _ = step(model, state, period)
    before = bytes_of(state)
    fresh = reset_pose(state, np.array([7.0, 8.0, 0.9]), np.eye(3))
    assert bytes_of(state) == before
    np.testing.assert_array_equal(fresh.mean, [7.0, 8.0, 0.9])
    np.testing.assert_array_equal(fresh.covariance, np.eye(3))
    assert fresh.measurement_noise.tobytes() == state.measurement_noise.tobytes()
    assert fresh.process_noise.tobytes() == state.process_noise.tobytes()
    assert fresh.window.squares.shape == (6, 4)
    assert not np.any(fresh.window.counts)


def test_mode_q_projects_on_the_heading_at_the_end_of_the_step(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation]
) -> None:
    """Driving along y after a quarter turn, only y's innovations teach the forward noise."""
    model = make_model(adaptation=make_adaptation(mode="q", window_length=3))
    loud_x = np.array([5.0, 0.0, 0.0, 0.0])
    available = np.array([True, True, False, False])
    changes = []
    for heading in (0.0, -math.pi / 2.0):
        state = start_filter(model, np.array([0.0, 0.0, heading]), 1e-4 * np.eye(3))
        turned = move(MotionModel.EXACT_ARC, state.mean, np.array([0.0, math.pi / 2.0])).mean
        z = turned[[0, 1, 2, 2]] + loud_x
        after, _ = step(model, state, StepInput(np.array([0.0, math.pi / 2.0]), z, available))
        changes.append(after.process_noise[0] - model.process_noise[0])
    # Ends along y: y was quiet, so the noise falls; ends along x: it rises.
    assert changes[0] < 0.0 < changes[1]


def test_reported_covariance_moves_by_the_network_output(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., Adaptation]
) -> None:
    """Sensors that report ten times the filter's R: what is used moves by dR, not by 10 dR."""
    model = make_model(adaptation=make_adaptation(mode="r", window_length=3))
    own = np.array(model.measurement_noise)
    period = StepInput(
        np.array([0.1, 0.1]), START[[0, 1, 2, 2]] + 1.0, ALL_ROWS, None, np.diag(10.0 * own)
    )
    reported, _ = step(model, start_filter(model, START, START_COVARIANCE), period)
    used = make_model(
        measurement_noise=tuple(10.0 * own), adaptation=make_adaptation(mode="r", window_length=3)
    )
    own_ten, _ = step(
        used,
        start_filter(used, START, START_COVARIANCE),
        period._replace(measurement_covariance=None),
    )
    effective = 10.0 * own * reported.measurement_noise / own
    np.testing.assert_allclose(effective, own_ten.measurement_noise, rtol=1e-9)


@pytest.mark.parametrize("before", ["none", "r", "q", "rq", "joint"])
@pytest.mark.parametrize("after", ["none", "r", "q", "rq", "joint"])
def test_a_change_of_mode_keeps_the_pose_and_the_noise_without_an_alarms_share(
    make_model: Callable[..., FilterModel],
    make_adaptation: Callable[..., Adaptation],
    before: str,
    after: str,
) -> None:
    old, new = (
        make_model(adaptation=make_adaptation(mode=mode, window_length=6))
        for mode in (before, after)
    )
    state = start_filter(old, START, START_COVARIANCE)
    periods = random_periods(np.random.default_rng(61), 25)
    for period in periods[:20]:
        state, _ = step(old, state, period)
    if state.joint is not None:  # slip leads: the noise in use is not the calm one
        state = state._replace(joint=state.joint._replace(lead=np.array([0.0, 12.0])))
    changed = for_mode(new, state)
    assert bytes_of(changed._replace(joint=None), changed.window) == bytes_of(
        state._replace(
            joint=None,
            process_noise=changed.process_noise,
            measurement_noise=changed.measurement_noise,
        ),
        state.window,
    )
    if (before == "joint") == (after == "joint"):
        assert changed is state
    elif before == "joint":
        assert state.joint is not None
        Q, R = calm_noise(state.joint)
        np.testing.assert_array_equal(changed.process_noise, Q)
        np.testing.assert_array_equal(changed.measurement_noise, R)
    else:
        assert changed.joint is not None
        np.testing.assert_array_equal(changed.joint.process_noise, state.process_noise)
        np.testing.assert_array_equal(changed.joint.measurement_noise, state.measurement_noise)
        np.testing.assert_array_equal(changed.joint.log_scale, 0.0)
    for period in periods[20:]:
        changed, _ = step(new, changed, period)
    assert (changed.joint is not None) == (after == "joint")
