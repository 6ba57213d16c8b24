"""Landmarks on moving bodies and the truth of these (15 s)."""

from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env as sse
from filters.geometry import rotations
from stereo_slam_env.envs.arguments import DriveOptions
from stereo_slam_env.envs.core_rows import CoreRows
from stereo_slam_env.recording.body_truth import BODY_KINDS
from stereo_slam_env.sensing.corruptions import corrupted

TRAFFIC = {"route": "right-turn", "moving_cars": 12, "pedestrians": 8, "moving_landmarks": 7, "sigma": 0.5}
ONE = np.ones(1, dtype=bool)


def driven(seed=2, frames=70, **arguments):
    """Frames of a drive, infos, and the arrays of its scene."""
    options = DriveOptions.checked({"policy": "route", **TRAFFIC, **arguments})
    with closing(CoreRows(options, 1)) as rows:
        rows.reset(ONE, [seed], {})
        taken, infos = [rows.frame(0)], [rows.observe()[1]]
        assert {key: value[0].shape for key, value in rows.observe()[0].items()} == {
            key: space.shape for key, space in rows.observation_space.items()
        }
        for _ in range(frames - 1):
            rows.step(np.zeros((1, 2)), ONE)
            taken.append(rows.frame(0))
            infos.append(rows.observe()[1])
        return taken, infos, rows.simulator.scenes[0], rows.camera, rows.noise


@pytest.fixture(scope="module")
def drive():
    return driven()


def on_bodies(frame):
    """Ids, (u, v, d), and places of their bodies in the truth, of what is measured on moving bodies."""
    is_moving = frame.bodies.of_measurements >= 0
    labels = frame.bodies.of_measurements[is_moving]
    places = np.searchsorted(frame.bodies.ids, labels)
    np.testing.assert_array_equal(frame.bodies.ids[places], labels)  # all of these are in the truth
    return frame.observation.ids[is_moving], frame.observation.uvd[is_moving], places


def in_camera(frame, vectors_w, *, points=True):
    return (vectors_w - points * frame.truth.position) @ frame.truth.R_wc


def test_an_id_is_a_point_fixed_to_its_body_measured_with_white_noise_of_the_stated_covariance(drive):
    frames, _, scene, camera, noise = drive
    whitening, surface = np.linalg.inv(np.linalg.cholesky(noise.R)), scene.traffic.surface
    residuals = {}
    for frame in frames:
        ids, uvd, places = on_bodies(frame)
        points, bodies = surface[ids - len(scene.landmarks)], frame.bodies
        np.testing.assert_array_equal(points[:, 6], bodies.ids[places])
        R_wb = rotations.matrix(bodies.orientations[places])
        points_w = bodies.positions[places] + np.einsum("nij,nj->ni", R_wb, points[:, :3])
        errors = (uvd - camera.project(in_camera(frame, points_w))) @ whitening.T
        facing = np.einsum("ni,ni->n", frame.truth.position - points_w, np.einsum("nij,nj->ni", R_wb, points[:, 3:6]))
        assert (facing > 0.0).all()
        for i, error in zip(ids, errors, strict=True):
            residuals.setdefault(i, []).append(error)
    every = np.concatenate([*residuals.values()])
    pairs = np.concatenate([np.array(run)[:-1] * np.array(run)[1:] for run in residuals.values()])
    few = 4.0 / np.sqrt(len(every))
    assert len(every) > 3000
    np.testing.assert_allclose(every.mean(axis=0), 0.0, atol=few)
    np.testing.assert_allclose(np.cov(every.T), np.eye(3), atol=1.5 * few)
    np.testing.assert_allclose(pairs.mean(axis=0), 0.0, atol=1.2 * few)


def test_points_are_all_over_the_body_but_its_underside(drive):
    surface, moving = drive[2].traffic.surface, drive[2].scene.moving
    for m, body in enumerate(moving):
        points = surface[surface[:, 6] == m]
        assert len(points) == 8 * (4 if body.kind == "pedestrian" else 7)
        np.testing.assert_allclose(np.linalg.norm(points[:, 3:6], axis=1), 1.0)
        assert (points[:, 5] > -0.6).all()
        for axis in (0, 1):  # on all sides
            assert points[:, 3 + axis].min() < -0.5 < 0.5 < points[:, 3 + axis].max()


def test_so_many_are_tracked_on_each_beside_those_that_stand_which_stay_the_same(drive):
    frames, infos, scene, *_ = drive
    without, plain, *_ = driven(moving_landmarks=0)
    most = {}
    for frame, other, info in zip(frames, without, infos, strict=True):
        labels = frame.bodies.of_measurements
        np.testing.assert_array_equal(frame.observation.ids[labels < 0], other.observation.ids)
        np.testing.assert_array_equal(info["truth_body_of"][0, : len(labels)], labels)
        assert (info["truth_body_of"][0, len(labels) :] == -1).all()
        for number in set(labels) - {-1}:
            most[number] = max(most.get(number, 0), (labels == number).sum())
    limits = {m: 4 if body.kind == "pedestrian" else 7 for m, body in enumerate(scene.scene.moving)}
    assert all(count <= limits[number] for number, count in most.items())
    assert sum(count == limits[number] for number, count in most.items()) >= 5
    assert other.bodies is None
    assert plain[0].keys() == infos[0].keys() - {"truth_bodies", "truth_body_of"}


def test_what_is_hidden_for_pybullet_is_not_seen(drive):
    frames, bullet = drive[0][:40], driven(frames=40, physics="bullet")[0]
    ids = [(set(on_bodies(one)[0]), set(on_bodies(other)[0])) for one, other in zip(frames, bullet, strict=True)]
    assert sum(len(one) for one, _ in ids) > 1000
    assert sum(len(one ^ other) for one, other in ids) < 0.01 * sum(len(one) for one, _ in ids)


def test_velocities_are_those_between_poses_and_who_comes_or_goes_is_not_there(drive):
    frames, infos, *_ = drive
    moved = turned = changed = 0
    for before, frame, info in zip(frames[:-1], frames[1:], infos[1:], strict=True):
        old, new = before.bodies, frame.bodies
        table = info["truth_bodies"][0]
        assert table.shape == (20, 14)
        np.testing.assert_array_equal(np.flatnonzero(table[:, 0]), new.ids)
        assert tuple(BODY_KINDS[int(code) - 1] for code in table[new.ids, 0]) == new.kinds
        columns = new.positions, new.orientations, new.linear, new.angular
        np.testing.assert_array_equal(table[new.ids, 1:], np.column_stack(columns))
        assert (np.abs(new.positions[:, 1]) < 2.0).all()
        both, i, j = np.intersect1d(old.ids, new.ids, return_indices=True)
        dt = frame.timestamp - before.timestamp
        np.testing.assert_allclose((new.positions[j] - old.positions[i]) / dt, new.linear[j], atol=1e-9)
        turns = rotations.between(old.orientations[i], new.orientations[j])
        R_old = rotations.matrix(old.orientations[i])
        by_poses = np.einsum("nij,nj->ni", R_old, rotations.log(rotations.matrix(turns))) / dt
        np.testing.assert_allclose(by_poses, new.angular[j], atol=1e-6)
        moved += (np.linalg.norm(new.linear[j], axis=1) > 1.0).sum()
        turned += (np.abs(new.angular[j, 1]) > 0.1).sum()
        changed += len(old.ids) + len(new.ids) - 2 * len(both)
    assert min(moved, turned, changed) > 0


def test_a_recording_keeps_them_and_corrupted_measurements_stay_those_of_their_bodies(tmp_path):
    recording = sse.record("StereoSlam/Drive-v0", seed=3, frames=12, **TRAFFIC)
    sse.save_recording(tmp_path / "drive.npz", recording)
    for frame, loaded in zip(recording.frames, sse.load_recording(tmp_path / "drive.npz").frames, strict=True):
        assert loaded.bodies.kinds == frame.bodies.kinds
        for name in ("ids", "positions", "orientations", "linear", "angular", "of_measurements"):
            np.testing.assert_array_equal(getattr(loaded.bodies, name), getattr(frame.bodies, name))
    by_id = {}
    for frame in recording.frames:
        by_id.update(zip(frame.observation.ids, frame.bodies.of_measurements, strict=True))
    missed = corrupted(
        recording, [{"kind": "missed-detections", "probability": 0.3}, {"kind": "latency", "frames": 1}], 1
    )
    for frame in missed.frames:
        assert [by_id[i] for i in frame.observation.ids] == frame.bodies.of_measurements.tolist()


@pytest.mark.parametrize("bus", ["pulls-away", "leads"])
def test_a_bus_is_on_the_lane_ahead_and_hides_what_is_behind_it(bus):
    alone = {"moving_cars": 0, "pedestrians": 0, "moving_landmarks": 40, "route": "straight", "perturbation": 0.0}
    frames, *_ = driven(frames=80, bus=bus, **alone)
    free = driven(frames=80, moving_landmarks=1, **{k: v for k, v in alone.items() if k != "moving_landmarks"})[0]
    ahead = np.array([in_camera(frame, frame.bodies.positions)[0, 2] for frame in frames])
    speeds = np.array([np.linalg.norm(frame.bodies.linear[0]) for frame in frames])
    assert all(frame.bodies.kinds == ("bus",) for frame in frames)
    assert (np.abs(np.diff(speeds)) < 0.16).all()
    if bus == "leads":
        np.testing.assert_allclose(ahead, 13.0, atol=0.3)
    else:
        assert ahead[0] == pytest.approx(25.0)
        assert speeds[:8].max() == 0.0 < speeds[10]
        assert ahead[-1] == pytest.approx(13.0, abs=1.0)
    counts = [(frame.bodies.of_measurements == 0).sum() for frame in frames]
    assert min(counts) >= 15  # its rear, of the 320 that are all over it
    middle = [np.abs(frame.observation.uvd[:, 0] - 672.0) < 40.0 for frame in (frames[-1], free[-1])]
    far = [
        (frame.observation.uvd[:, 2] < 15.0) & one for frame, one in zip((frames[-1], free[-1]), middle, strict=True)
    ]
    assert far[0].sum() == 0 < far[1].sum()


@pytest.mark.parametrize("task", ["ActiveGaze", "Branches", "ClosedLoop", "Explore", "Follow", "Revisit"])
def test_tasks_take_them(task):
    arguments = {"moving_cars": 3, "moving_landmarks": 6, "bus": "leads"}
    with gym.make(f"StereoSlam/{task}-v0", arguments=arguments, disable_env_checker=True) as env:
        env.reset(seed=1)
        env.action_space.seed(1)
        _, reward, *_, info = env.step(env.action_space.sample())
        assert np.isfinite(reward)
        assert info["truth_bodies"].shape == (4, 14)
        assert (info["truth_body_of"] >= 0).any()


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="moving_landmarks must be 0 with sensor='images'"):
        DriveOptions.checked({"moving_landmarks": 3, "sensor": "images"})
    with pytest.raises(ValueError, match="bus must be one of"):
        DriveOptions.checked({"bus": "stands"})
