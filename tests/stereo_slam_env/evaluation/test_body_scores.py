"""Figures of moving bodies on a drive through a town (15 s, without compilation)."""

from dataclasses import replace

import numpy as np
import pytest

import stereo_slam_env as sse
from filters.catalogue.presets import MovingBodiesEKF
from filters.geometry import rotations
from stereo_slam_env.benchmark.storage.run_files import load_run, packed_run
from stereo_slam_env.evaluation.figures import FIGURES
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.run_figures import score_of

from ..benchmark.small_recordings import small_recording
from .test_batch_run import alone, in_a_batch

BODY_FIGURES = {name for name, figure in FIGURES.items() if figure.is_optional}
TOWN = {"route": "town", "moving_cars": 30, "pedestrians": 10, "moving_landmarks": 12}


@pytest.fixture(scope="module")
def town():
    return sse.record("StereoSlam/Drive-v0", seed=0, policy="route", sigma=0.5, max_landmarks=90, frames=60, **TOWN)


@pytest.fixture(scope="module")
def run(town):
    return run_filter(town, "moving-bodies", seed=0)


def figures(run):
    return score_of(run, divergence_percent=10.0).figures


class Bold(MovingBodiesEKF):
    """A quarter of the covariances of the bodies."""

    @property
    def bodies(self):
        belief = super().bodies
        return replace(belief, covariances=0.25 * belief.covariances)

    def belief(self, *names):
        belief = super().belief(*names)
        return replace(belief, covariance=0.25 * belief.covariance)


def test_the_figures_are_there_for_filters_with_bodies_and_one_for_others(town, run):
    assert figures(run).keys() >= BODY_FIGURES
    assert 0.5 < FIGURES["body_pose_nees_median"].of(figures(run)) < 3.0
    assert figures(run)["bodies_found_percent"] > 80.0
    for name in ("inverse-depth", "dual-bearing"):
        other = sse.evaluate(name, town)
        assert BODY_FIGURES & other.figures.figures.keys() == {"mover_points_used_as_static_percent"}
        assert other.figures.mover_points_used_as_static_percent > figures(run)["mover_points_used_as_static_percent"]


def test_a_body_scored_slowly_has_the_same_score(town, run):
    """The body that is scored most, by matrices (4, 4), numerical Jacobians and its landmarks one by one."""
    scores = run.bodies
    numbers = scores.numbers[np.isfinite(scores.pose_nees)]
    number = int(np.bincount(numbers).argmax())
    expected, first, body = {}, None, None
    for moment in sse.run("moving-bodies", town):
        belief, truth = moment.slam.bodies, moment.frame.bodies
        if number not in belief.ids:
            continue
        j = belief.ids.tolist().index(number)
        camera, estimate, at = matrix_of(moment.truth), matrix_of(moment.pose), matrix_of(belief, j)
        body_of = dict(zip(moment.observation.ids.tolist(), truth.of_measurements.tolist(), strict=True))
        labels = [body_of[i] for i in belief.landmarks[j].tolist() if i in body_of]
        if first is None:
            first = moment.time, truth, camera @ np.linalg.inv(estimate) @ at
        if not labels:
            continue
        body = max(set(labels), key=labels.count) if body is None else body
        born, then, start = first
        now, before = (matrix_of(t, t.ids.tolist().index(body)) for t in (truth, then))
        true = now @ np.linalg.inv(before) @ start
        if moment.time - born < 1.0 - 1e-6:
            continue
        joint = moment.slam.belief("pose", f"body-{number}").covariance
        seen = relative(camera, true)
        e = difference_of(seen, relative(estimate, at))
        J = np.array([difference_of(seen, nudged(estimate, at, i, -1e-6)) - e for i in range(12)]).T / 1e-6
        i = truth.ids.tolist().index(body)
        turn = truth.angular[i]
        velocity = truth.linear[i] + np.cross(turn, true[:3, 3] - truth.positions[i])
        off = np.concatenate([velocity - belief.linear[j], turn - belief.angular[j]])
        expected[moment.number] = (
            e @ np.linalg.solve(J @ joint[:12, :12] @ J.T, e),
            off @ np.linalg.solve(joint[12:, 12:], off),
            np.linalg.norm(belief.linear[j]) - np.linalg.norm(velocity),
        )
    mine = (scores.numbers == number) & np.isfinite(scores.pose_nees)
    assert scores.frames[mine].tolist() == list(expected)
    assert len(expected) > 20
    rows = np.column_stack([scores.pose_nees, scores.twist_nees, scores.speed_errors])[mine]
    np.testing.assert_allclose(rows, list(expected.values()), rtol=1e-3)


def matrix_of(poses, row=None):
    p, q = (poses.position, poses.orientation) if row is None else (poses.positions[row], poses.orientations[row])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotations.matrix(q), p
    return T


def relative(camera, body):
    return np.linalg.inv(camera) @ body


def nudged(camera, body, axis, step):
    moved = [camera.copy(), body.copy()]
    T, part = moved[axis // 6], np.eye(3)[axis % 3] * step
    if axis % 6 < 3:
        T[:3, 3] += part
    else:
        T[:3, :3] = T[:3, :3] @ rotations.exp(part)
    return relative(*moved)


def difference_of(true, estimate):
    return np.concatenate([(true - estimate)[:3, 3], rotations.log(estimate[:3, :3].T @ true[:3, :3])])


def test_points_and_bodies_counted_one_by_one_are_as_many(town, run):
    first_time, sighted, findable, delays = town.frames[0].timestamp, {}, {}, {}
    as_static = on_movers = found = to_find = 0
    born, matched = {}, {}
    for moment in sse.run("moving-bodies", town):
        belief, truth, report = moment.slam.bodies, moment.frame.bodies, moment.report
        body_of = dict(zip(moment.observation.ids.tolist(), truth.of_measurements.tolist(), strict=True))
        on_bodies = {*np.concatenate([report.left, *belief.landmarks]).tolist()}
        if moment.time - first_time > 0.95:
            movers = [i for i, body in body_of.items() if body >= 0]
            on_movers += len(movers)
            as_static += sum(i in report.updated and i not in on_bodies for i in movers)
        there = set()
        for number, landmarks in zip(belief.ids.tolist(), belief.landmarks, strict=True):
            born.setdefault(number, moment.time)
            labels = [body_of[i] for i in landmarks.tolist() if i in body_of]
            if labels:
                there.add(max(set(labels), key=labels.count))
                matched.setdefault(number, max(set(labels), key=labels.count))
        for body, place, velocity in zip(truth.ids.tolist(), truth.positions, truth.linear, strict=True):
            if list(body_of.values()).count(body) >= 4:
                sighted.setdefault(body, moment.time)
                if np.linalg.norm(velocity) > 0.7 and np.linalg.norm(place - moment.truth.position) < 40.0:
                    since = findable.setdefault(body, moment.time)
                    to_find += moment.time - since > 0.95
                    found += moment.time - since > 0.95 and body in there
    for number, body in matched.items():
        delays.setdefault(body, born[number] - sighted[body])
    expected = {
        "mover_points_used_as_static_percent": 100.0 * as_static / on_movers,
        "bodies_found_percent": 100.0 * found / to_find,
        "body_delay_s": np.median(list(delays.values())),
    }
    assert {name: figures(run)[name] for name in expected} == pytest.approx(expected)


def test_a_quarter_of_the_covariance_has_four_times_the_nees(town, run):
    claims = run_filter(town, Bold, seed=0)
    for name in ("body_pose_nees", "body_pose_nees_median", "body_twist_nees", "body_twist_nees_median"):
        assert figures(claims)[name] == pytest.approx(4.0 * figures(run)[name], rel=1e-3), name
    assert figures(claims)["body_speed_rmse_m_s"] == figures(run)["body_speed_rmse_m_s"]


def exchanged(frame, first, second):
    labels = frame.bodies.of_measurements.copy()
    labels[frame.bodies.of_measurements == first] = second
    labels[frame.bodies.of_measurements == second] = first
    return replace(frame, bodies=replace(frame.bodies, of_measurements=labels))


def test_bodies_that_change_places_are_swapped_and_points_that_stand_are_no_body(town, run):
    scores = run.bodies
    late = scores.true_bodies[scores.frames == 50]
    first, second = late[:2].tolist()
    frames = [exchanged(frame, first, second) if k >= 40 else frame for k, frame in enumerate(town.frames)]
    swapped = run_filter(replace(town, frames=tuple(frames)), "moving-bodies")
    mine = np.isin(scores.at_birth, (first, second)) & (scores.frames >= 40) & (scores.ages > 1.0 - 1e-6)
    share = 100.0 * (mine.sum() + scores.swapped.sum()) / len(scores.swapped)
    assert figures(swapped)["body_swapped_percent"] == pytest.approx(share)
    assert mine.sum() > 10
    still = [
        replace(f, bodies=replace(f.bodies, of_measurements=0 * f.bodies.of_measurements - 1)) for f in town.frames
    ]
    none = figures(run_filter(replace(town, frames=tuple(still)), "moving-bodies"))
    assert none["bodies_false"] == len(np.unique(scores.numbers))
    assert none["body_swapped_percent"] == 100.0
    assert none["static_points_on_bodies_percent"] > 1.0
    assert "body_pose_nees" not in none
    assert "bodies_found_percent" not in none


def test_a_body_that_is_taken_away_and_comes_back_is_not_scored_from_there_on(town, run):
    scores = run.bodies
    scored = np.isfinite(scores.pose_nees)
    (body, *_), late = scores.at_birth[scored & (scores.frames == 50)], scored & (scores.frames >= 40)
    gone = [removed(frame, body) if k == 40 else frame for k, frame in enumerate(town.frames)]
    after = run_filter(replace(town, frames=tuple(gone)), "moving-bodies").bodies
    assert not np.isfinite(after.pose_nees[(after.at_birth == body) & (after.frames >= 40)]).any()
    others = late & (scores.at_birth != body)
    kept = np.isfinite(after.pose_nees) & (after.frames >= 40)
    np.testing.assert_array_equal(after.pose_nees[kept], scores.pose_nees[others])


def removed(frame, body):
    truth, rest = frame.bodies, frame.bodies.ids != body
    names = ("ids", "positions", "orientations", "linear", "angular")
    labels = np.where(truth.of_measurements == body, -1, truth.of_measurements)
    kinds = tuple(kind for kind, stays in zip(truth.kinds, rest, strict=True) if stays)
    values = {name: getattr(truth, name)[rest] for name in names}
    return replace(frame, bodies=replace(truth, **values, kinds=kinds, of_measurements=labels))


def test_filters_in_a_batch_have_the_same_share_of_mover_points(town):
    batch = in_a_batch([town, town], "inverse-depth")
    single = alone([town], "inverse-depth")
    assert figures(single[0])["mover_points_used_as_static_percent"] > 10.0
    for run in batch:
        assert BODY_FIGURES & figures(run).keys() == {"mover_points_used_as_static_percent"}
        for name in ("movers_as_static", "movers_measured"):
            np.testing.assert_array_equal(run.counts[name], single[0].counts[name])


def test_a_recording_without_bodies_has_none_of_the_figures():
    recording = small_recording(frames=30)
    for name in ("inverse-depth", "moving-bodies"):
        evaluation = sse.evaluate(name, recording)
        assert not BODY_FIGURES & evaluation.figures.as_dict().keys()
        assert not BODY_FIGURES & figures(evaluation.series).keys()
        assert evaluation.series.bodies is None


def test_they_are_stored_with_the_run_and_runs_without_them_still_load(town, run, tmp_path):
    path = tmp_path / "run.npz"
    for whole in (True, False):
        path.write_bytes(packed_run(run, {}, score_of(run, divergence_percent=10.0), whole=whole))
        stored = load_run(path)
        assert dict(stored.score.figures) == figures(run)
    path.write_bytes(packed_run(run, {}))
    assert figures(load_run(path).run) == figures(run)
    plain = run_filter(small_recording(frames=12), "inverse-depth")
    path.write_bytes(packed_run(plain, {}, score_of(plain, divergence_percent=10.0), whole=False))
    assert load_run(path).score is not None
