"""A batch of filters is the same filters one by one, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from filters import BodyVelocity, Start, StereoEKF, StereoObservation, VelocityDriven
from filters.engine.batch import FilterBatch

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, START_COVARIANCE, drive
from ..third_party import BiasedOdometry, ShearedPair

COUNT = 5
ODOMETRY = BodyVelocity((0.0, 0.0, SPEED), (0.0, 0.2, 0.0), np.diag(np.repeat([0.3, 0.1], 3) ** 2))
START = Start(linear_velocity=(0.0, 0.0, SPEED), covariance=START_COVARIANCE)
OPTIONS = [
    {},
    {"landmark": "shared-anchor", "consensus": True},
    {"measurement": "sequential", "iterations": 2},
    {"landmark": "hybrid", "tail_dof": 4.0},
    {"landmark": "spherical", "error": "right-invariant", "measurement": ShearedPair(), "motion": BiasedOdometry()},
    {"update": "unscented", "error": "so3"},
]


def make(**options: object) -> StereoEKF:
    return StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)


def batch_of(count: int, threads: int = 1, **options: object) -> FilterBatch:
    batch = FilterBatch(lambda: make(**options), count, threads)
    batch.reset(START)
    return batch


def drives() -> list[list[StereoObservation]]:
    """One drive for each filter."""
    return [[f.observation for f in drive(seed, 8, v_right=seed % 2 == 0)] for seed in range(COUNT)]


def snapshot(batch: FilterBatch, index: int) -> list[np.ndarray]:
    state = batch.engine.export(index)
    values = [getattr(state, name) for name in ("x", "predicted", "blocks", "first", "ids", "own", "anchor")]
    return [*values, np.triu(state.P)]


def assert_same_bits(one: FilterBatch, i: int, other: FilterBatch, j: int) -> None:
    for a, b in zip(snapshot(one, i), snapshot(other, j), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_a_batch_has_the_bits_of_single_filters(options: dict[str, object], threads: int) -> None:
    frames, batch = drives(), batch_of(COUNT, threads, **options)
    singles = [batch_of(1, **options) for _ in range(COUNT)]
    for k in range(8):
        steps = DT * (1.0 + 0.1 * np.arange(COUNT))
        always = "motion" in options
        odometry = [ODOMETRY if index % 2 or always else None for index in range(COUNT)]
        reports = batch.step(steps, [frames[index][k] for index in range(COUNT)], odometry)
        for index, single in enumerate(singles):
            report = single.step(steps[index], [frames[index][k]], [odometry[index]])[0]
            for name in ("updated", "initialised", "dropped", "gated", "nis"):
                np.testing.assert_array_equal(getattr(reports[index], name), getattr(report, name))
    for index, single in enumerate(singles):
        assert_same_bits(batch, index, single, 0)


@pytest.mark.parametrize("options", OPTIONS)
def test_what_is_read_of_all_at_once_has_the_bits_of_what_each_says(options: dict[str, object]) -> None:
    frames, batch = drives(), batch_of(COUNT, **options)
    for k in range(4):
        batch.step(DT, [frames[index][k] for index in range(COUNT)], [ODOMETRY] * COUNT)
    forecasts, velocities = batch.forecasts(), batch.velocities
    for index, slam in enumerate(batch):
        alone = slam.forecast()
        for name in ("ids", "uvd", "S", "in_view"):
            np.testing.assert_array_equal(getattr(forecasts[index], name), getattr(alone, name), err_msg=name)
        np.testing.assert_array_equal(velocities[index], np.append(slam.velocity.linear, slam.velocity.angular))
        np.testing.assert_array_equal(batch.velocity_covariances[index], slam.velocity.covariance)
        np.testing.assert_array_equal(batch.poses[index], np.append(slam.pose.position, slam.pose.orientation))
        np.testing.assert_array_equal(batch.pose_covariances[index], slam.pose.covariance)
        assert batch.state_sizes[index] == slam.state_size


@pytest.mark.parametrize("options", [*OPTIONS, {"landmark": "euclidean"}])
def test_the_maps_of_all_in_w_are_those_that_each_tells(options: dict[str, object]) -> None:
    frames, batch = drives(), batch_of(COUNT, **options)
    for k in range(4):
        batch.step(DT, [frames[index][k] for index in range(COUNT)], [ODOMETRY] * COUNT)
    found, maps = batch.world_landmarks(), [slam.landmarks for slam in batch]
    assert found.offsets.tolist() == [0, *np.cumsum([len(each.ids) for each in maps])]
    np.testing.assert_array_equal(found.ids, np.concatenate([each.ids for each in maps]))
    np.testing.assert_allclose(found.positions, np.concatenate([each.positions for each in maps]), rtol=1e-12)
    expected = np.concatenate([each.covariances for each in maps])
    np.testing.assert_allclose(found.covariances, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_arrays_of_one_shape_give_the_same_bits() -> None:
    frames, batch, other = drives(), batch_of(COUNT), batch_of(COUNT)
    for k in range(8):
        seen = [StereoObservation(o.ids, o.uvd) for o in (frames[index][k] for index in range(COUNT))]
        ids, uvd = np.full((COUNT, 20), -1), np.full((COUNT, 20, 3), np.nan)
        for index, o in enumerate(seen):
            ids[index, 2 : 2 + len(o)], uvd[index, 2 : 2 + len(o)] = o.ids[::-1], o.uvd[::-1]
        batch.step(DT, seen)
        other.step_arrays(DT, ids, uvd)
    for index in range(COUNT):
        assert_same_bits(batch, index, other, index)


def test_without_an_observation_a_filter_keeps_its_map_and_an_empty_one_drops_it() -> None:
    batch = batch_of(2)
    batch.update([drives()[0][0]] * 2)
    empty = StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    reports = batch.update([None, empty])
    assert len(batch[0].landmarks.ids) > 0
    assert len(batch[1].landmarks.ids) == 0
    assert len(reports[1].dropped) > 0


def test_a_filter_of_the_batch_works_on_the_batch() -> None:
    batch, frames = batch_of(2), drives()[0]
    before = snapshot(batch, 0)
    report = batch[1].update(frames[0])
    batch[1].predict(DT)
    batch[1].forget(report.initialised[:3])
    np.testing.assert_array_equal(batch[1].landmarks.ids, np.sort(report.initialised[3:]))
    for a, b in zip(before, snapshot(batch, 0), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda batch, o: batch.predict(0.0), "dt must be"),
        (lambda batch, o: batch.predict([0.1, -0.1]), "dt must be"),
        (lambda batch, o: batch.update([o]), "observations must have one entry"),
        (lambda batch, o: batch.update([o, 3]), "observations must be StereoObservation"),
        (lambda batch, o: batch.predict(0.1, [None]), "odometry must have one entry"),
        (lambda batch, o: batch.reset([START]), "starts must have one entry"),
        (lambda batch, o: batch.step_arrays(0.1, np.ones((2, 3), int), np.zeros((2, 3, 3))), "ids must be unique"),
        (lambda batch, o: batch.step_arrays(0.1, np.ones((2, 1), int), np.full((2, 1, 3), np.nan)), "uvd must be"),
    ],
)
def test_bad_input_is_named_and_changes_nothing(call: object, message: str) -> None:
    batch, o = batch_of(2), drives()[0][0]
    batch.update([o, o])
    before = snapshot(batch, 0) + snapshot(batch, 1)
    with pytest.raises(ValueError, match=message):
        call(batch, o)
    for a, b in zip(before, snapshot(batch, 0) + snapshot(batch, 1), strict=True):
        np.testing.assert_array_equal(a, b)


def test_filters_that_differ_are_refused() -> None:
    gates = iter([0.9, 0.99])
    with pytest.raises(ValueError, match="filter 1 differs"):
        FilterBatch(lambda: make(gate=next(gates)), 2)
    with pytest.raises(ValueError, match="odometry must be"):
        FilterBatch(lambda: make(motion=VelocityDriven()), 2).predict(0.1)
