"""Moving bodies in the state: their steps, their beliefs against the truth, and which landmarks are on them."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest

from filters import RigidBodies, Start, StereoEKF, StereoObservation, make_filter
from filters.bodies.rigid_bodies import BodyStep
from filters.geometry import derivatives, rotations
from filters.geometry.poses import Pose, relative_jacobian

from ..drives import CAMERA, DT
from .street import CARS, NOISE, SPEED, WALKERS, Mover, Score, Sight, drive_along, street

MOTION = {"name": "constant-velocity", "sigma_acceleration": 1.0, "sigma_angular_acceleration": 0.3}

LOOSE = {**MOTION, "sigma_acceleration": 3.0}


def make(**options) -> StereoEKF:
    return make_filter("moving-bodies", camera=CAMERA, noise=NOISE, **{"motion": MOTION, **options})


def scores(movers: tuple[Mover, ...], seeds: int, *, told: bool, **options) -> list[Score]:
    return [drive_along(make(**options), street(seed, movers), movers, told=told) for seed in range(seeds)]


def every(drives: list[Score], name: str) -> np.ndarray:
    return np.concatenate([getattr(one, name) for one in drives])


def rms(drives: list[Score]) -> float:
    return float(np.sqrt(np.mean([np.square(one.ego).mean() for one in drives])))


# --- the step ---


def test_the_jacobians_of_a_step_are_those_of_what_it_does() -> None:
    rng = np.random.default_rng(0)
    p, q, v, w = rng.standard_normal(3), rotations.exp_quaternion(rng.standard_normal(3)), *rng.standard_normal((2, 3))
    points = 5.0 * rng.standard_normal((4, 3))

    def stepped(e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turned = rotations.multiply(q, rotations.exp_quaternion(e[3:6]))
        step = BodyStep.of(np.concatenate([p + e[:3], turned, v + e[6:9], w + e[9:]])[None], 0.3)
        return step.moved[0], step.carry(np.zeros(4, np.int64), points)[0]

    there = stepped(np.zeros(12))[0]

    def errors(e: np.ndarray) -> np.ndarray:
        moved = stepped(e)[0]
        turn = rotations.log(rotations.matrix(there[3:7]).T @ rotations.matrix(moved[3:7]))
        return np.concatenate([moved[:3], turn, moved[7:]])

    step = BodyStep.of(np.concatenate([p, q, v, w])[None], 0.3)
    np.testing.assert_allclose(step.F[0], derivatives.jacobian(errors, 12), atol=1e-6)
    by_body = derivatives.jacobian(lambda e: stepped(e)[1].ravel(), 12).reshape(4, 3, 12)
    np.testing.assert_allclose(step.carry(np.zeros(4, np.int64), points)[1], by_body, atol=1e-6)


def test_a_step_is_a_rigid_motion_by_the_constant_twist() -> None:
    """The point and the landmarks keep their distances; two half steps are a whole one."""
    body = np.array([[1.0, 2.0, 20.0, 0.0, 0.0, 0.0, 1.0, 3.0, 0.1, 5.0, 0.1, 0.7, -0.2]])
    points = body[0, :3] + np.random.default_rng(1).standard_normal((5, 3))
    whole, half = BodyStep.of(body, 0.4), BodyStep.of(body, 0.2)
    one = np.zeros(5, np.int64)
    again = BodyStep.of(half.moved, 0.2)
    np.testing.assert_allclose(again.moved, whole.moved, atol=1e-12)
    np.testing.assert_allclose(again.carry(one, half.carry(one, points)[0])[0], whole.carry(one, points)[0], atol=1e-12)
    apart = np.linalg.norm(whole.carry(one, points)[0] - whole.moved[0, :3], axis=1)
    np.testing.assert_allclose(apart, np.linalg.norm(points - body[0, :3], axis=1))


# --- association told ---


def test_what_is_told_to_stand_is_used_as_without_bodies() -> None:
    """The same bits: a filter with bodies is, without any, the filter without."""
    seen = [Sight(s.camera, s.observation.select(s.observation.bodies < 0)) for s in street(0)]
    with_bodies, without = make(), make(bodies=None)
    for slam in (with_bodies, without):
        drive_along(slam, seen, CARS, told=True)
    np.testing.assert_array_equal(with_bodies.state.P, without.state.P)
    np.testing.assert_array_equal(with_bodies.pose.position, without.pose.position)


def test_told_bodies_are_believed_in_as_they_err() -> None:
    """Ten drives past three cars and a walker: the camera as if they were not there, their NEES in their bands."""
    movers = CARS + WALKERS
    drives = scores(movers, 10, told=True)
    assert [one.born for one in drives] == [4] * 10
    assert sum(one.wrong for one in drives) == 0
    assert 0.5 < every(drives, "pose").mean() < 2.0  # measured: 0.95
    assert 0.3 < every(drives, "twist").mean() < 1.5  # measured: 0.45
    assert np.median(np.abs(every(drives, "speed"))) < 0.2  # m/s; measured: 0.13
    removed = [
        drive_along(
            make(bodies=None),
            [Sight(s.camera, s.observation.select(s.observation.bodies < 0)) for s in street(seed, movers)],
            movers,
            told=True,
        )
        for seed in range(10)
    ]
    assert rms(drives) < 1.05 * rms(removed)  # measured: 1.02


@pytest.mark.parametrize(
    "options",
    [{"error": "right-invariant"}, {"error": "first-estimates"}, {"landmark": "euclidean"}, {"landmark": "hybrid"}],
)
def test_other_parts_can_have_bodies(options: dict) -> None:
    drives = scores(CARS, 4, told=True, **options)
    assert [one.born for one in drives] == [3] * 4
    assert 0.4 < every(drives, "pose").mean() < 2.5
    assert 0.2 < every(drives, "twist").mean() < 1.5


# --- association found out ---


def test_bodies_are_found_and_told_apart() -> None:
    movers = CARS + WALKERS
    drives = scores(movers, 10, told=False)
    bodies = every(drives, "pose")
    assert 35 <= sum(one.born for one in drives) <= 45  # four a drive; measured: 40
    assert sum(one.wrong for one in drives) < 0.02 * 9 * len(bodies)  # of landmarks on bodies; measured: 69
    assert sum(one.mover_as_static for one in drives) < 0.03 * sum(one.on_movers for one in drives)  # measured: 0
    assert 0.5 < np.median(bodies) < 1.5  # measured: 0.76
    assert np.median(np.abs(every(drives, "speed"))) < 0.2
    without = scores(movers, 10, told=False, bodies=None)
    assert rms(drives) < rms(without)


def test_a_bus_that_pulls_away_is_not_taken_for_the_scene() -> None:
    """Most landmarks are on a bus that stands at first; a filter that rejects outliers follows it for a while."""
    errors = {}
    for name, bodies in (("bodies", True), ("rejection", None)):
        errors[name] = [_behind_a_bus(seed, bodies) for seed in range(4)]
    assert max(errors["bodies"]) < 0.2  # m; measured: 0.05
    assert np.median(errors["rejection"]) > 3.0 * np.median(errors["bodies"])  # measured: 9


def _behind_a_bus(seed: int, bodies: bool | None) -> float:
    """Largest error of the position, m, behind a bus that stands for a second and then accelerates."""
    rng = np.random.default_rng([5, seed])
    rear = np.column_stack([rng.uniform(-1.2, 1.2, 40), rng.uniform(-1.8, 1.0, 40), rng.uniform(18.0, 22.0, 40)])
    posts = np.column_stack([rng.choice([-7.0, 7.0], 50), rng.uniform(-2.0, 1.5, 50), np.linspace(15.0, 75.0, 50)])
    slam, worst, on_bus = make(bodies=bodies, motion=LOOSE), 0.0, np.arange(90) < 40
    slam.reset(Start(linear_velocity=(0.0, 0.0, 4.0), covariance=np.diag(np.repeat([1e-4, 1e-4, 0.3, 0.03], 3) ** 2)))
    for k in range(60):
        if k:
            slam.predict(DT)
        driven, pulled = 4.0 * DT * k, 0.75 * max(DT * k - 1.0, 0.0) ** 2
        points = np.vstack([rear, posts])
        points[:, 2] += np.where(on_bus, pulled, 0.0) - driven
        ids = np.flatnonzero((points[:, 2] > 5.0) & (on_bus | (points[:, 2] < 25.0)))
        uvd = CAMERA.project(points[ids])
        inside = CAMERA.in_view(uvd, margin=3.0)
        uvd += rng.multivariate_normal(np.zeros(3), NOISE.R, len(ids))
        slam.update(StereoObservation(ids[inside], uvd[inside]))
        worst = max(worst, abs(float(slam.pose.position[2]) - driven))
    return worst


def test_a_walker_has_no_turn_and_a_car_has_one() -> None:
    movers = (CARS[0], WALKERS[0])
    slam = make()
    drive_along(slam, street(2, movers, frames=25), movers, told=True)
    assert sorted(slam.bodies.turning.tolist()) == [False, True]
    still = slam.bodies.covariances[~slam.bodies.turning][0]
    assert np.sqrt(np.diag(still)[9:]).max() < 0.02  # rad/s


# --- what a user sees ---


def ahead_of(slam: StereoEKF, frames: int = 30) -> StereoEKF:
    drive_along(slam, street(1, CARS, frames), CARS, told=True)
    return slam


def test_a_body_is_a_variable_of_the_state() -> None:
    slam = ahead_of(make())
    belief = slam.bodies
    assert belief.ids.tolist() == [0, 1, 2]
    one = slam.belief("body-1")
    np.testing.assert_array_equal(one.covariance, belief.covariances[1])
    value = [belief.positions[1], belief.orientations[1], belief.linear[1], belief.angular[1]]
    np.testing.assert_array_equal(one.value, np.concatenate(value))
    assert np.linalg.eigvalsh(slam.belief("pose", "body-0", "body-2").covariance).min() > -1e-12
    assert set(np.concatenate(belief.landmarks)) <= set(slam.ids.tolist())


def test_the_prediction_of_the_bodies_is_that_of_the_filter() -> None:
    slam = ahead_of(make())
    foreseen = slam.bodies.predict(0.2)
    slam.predict(DT)
    slam.predict(DT)
    np.testing.assert_allclose(foreseen.positions, slam.bodies.positions, atol=1e-12)
    np.testing.assert_allclose(foreseen.covariances, slam.bodies.covariances, rtol=1e-9, atol=1e-12)
    now = slam.bodies
    np.testing.assert_array_equal(now.predict(0.0).covariances, now.covariances)
    assert np.trace(now.predict(1.0).covariances[0]) > np.trace(now.covariances[0])


def test_a_body_that_is_out_of_sight_coasts_then_leaves() -> None:
    slam = ahead_of(make(bodies={"patience": 3}))
    size, nothing = slam.state_size, StereoObservation([], np.zeros((0, 3)), bodies=np.zeros(0, dtype=np.int64))
    died = []
    for _ in range(5):
        slam.predict(DT)
        died.append(slam.update(nothing).died.tolist())
    assert died == [[], [], [], [0, 1, 2], []]
    assert len(slam.bodies) == 0
    assert slam.state_size < size - 3 * 12


def test_reports_say_who_comes_and_goes() -> None:
    slam, joined, born = make(), set(), []
    slam.reset(Start(linear_velocity=(0.0, 0.0, SPEED)))
    for k, sight in enumerate(street(3, CARS, 15)):
        if k:
            slam.predict(DT)
        report = slam.update(sight.observation)
        born += report.born.tolist()
        joined |= set(report.joined.tolist())
    on_bodies = set(np.concatenate(slam.bodies.landmarks).tolist())
    assert born == [0, 1, 2]
    assert on_bodies
    assert on_bodies <= joined | set(sight.observation.ids[sight.observation.bodies >= 0].tolist())


def test_a_copy_goes_on_alike() -> None:
    seen = street(4, CARS, 30)
    slam = make()
    drive_along(slam, seen[:20], CARS, told=False)
    for other in (copy.deepcopy(slam), pickle.loads(pickle.dumps(slam))):
        first = copy.deepcopy(slam)
        for one in (first, other):
            for sight in seen[20:]:
                one.predict(DT)
                one.update(StereoObservation(sight.observation.ids, sight.observation.uvd))
        np.testing.assert_array_equal(first.state.P, other.state.P)
        np.testing.assert_array_equal(first.bodies.positions, other.bodies.positions)


def test_a_walk_of_the_gauge_takes_bodies_along() -> None:
    """What it adds turns and shifts camera, map and bodies together: seen from the camera, nothing changes."""
    slam = ahead_of(make(error="right-invariant"))
    walked = copy.deepcopy(slam)
    walked.assume(NOISE, gauge_walk=0.05)
    for one in (slam, walked):
        one.predict(DT)
    poses = Pose(slam.pose.position, slam.pose.orientation)
    for j, number in enumerate(slam.bodies.ids.tolist()):
        body = Pose(slam.bodies.positions[j], slam.bodies.orientations[j])
        J = relative_jacobian(poses, body)
        still, moved = (J @ one.belief("pose", f"body-{number}").covariance[:12, :12] @ J.T for one in (slam, walked))
        np.testing.assert_allclose(moved, still, rtol=1e-6, atol=1e-9)
    assert np.trace(walked.pose.covariance) > 1.01 * np.trace(slam.pose.covariance)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: make(bodies={"reech": 1.0}), r"^bodies has no setting 'reech', did you mean 'reach'\?"),
        (lambda: make(bodies=5), r"^bodies must be RigidBodies, a table of its settings or None, got 5$"),
        (lambda: RigidBodies(sigma_velocity=(1.0, -1.0, 1.0)), r"^sigma_velocity must be standard deviations >= 0"),
        (lambda: RigidBodies(least_points=2), r"^least_points must be an integer >= 3, got 2$"),
        (lambda: RigidBodies(reach=0.0), r"^reach must be a finite number > 0, got 0.0$"),
        (lambda: make(measurement="fisheye"), r"^measurement must be of a rectified pair with bodies, got FisheyePair"),
        (lambda: make_filter("submaps", camera=CAMERA, noise=NOISE, bodies=True), r"^bodies must be None with submaps"),
        (lambda: make_filter("msckf", camera=CAMERA, noise=NOISE, bodies=True), r"^bodies must be None with a window"),
        (lambda: StereoObservation([1, 2], np.ones((2, 3)), bodies=[0]), r"^bodies must be 2 integers >= -2"),
        (lambda: make().bodies.predict(-1.0), r"^seconds must be a finite number >= 0, got -1.0$"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_settings_survive_a_table() -> None:
    chosen = RigidBodies(reach=3.0, sigma_acceleration=(2.0, 0.2, 2.0))
    assert RigidBodies.of(dataclasses.asdict(chosen)) == chosen
