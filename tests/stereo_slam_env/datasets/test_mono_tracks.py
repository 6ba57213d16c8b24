"""Tracks of one camera with an inertial unit: what is read, scored by filters, and refused to those of a pair."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import stereo_slam_env as sse
from filters import FilterBatch, StereoEKF, StereoObservation, make_filter
from fuzz.seeds_of_others import mono_tracks
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_flight
from stereo_slam_env.benchmark.scenarios.recording_description import recording_words
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import save_trajectory

NEEDS = r"^observation has no disparity, which measurement=\w+\(\) needs: take measurement='left' with inertial samples"


def written(recording: sse.Recording, folder: Path) -> Path:
    """The folder of a recording, without its disparities."""
    rows, samples = [], [[0.0, *np.zeros(6)]]
    for frame in recording.frames:
        seen, t = frame.observation, frame.timestamp
        rows += [[t, i, u, v] for i, (u, v, _) in zip(seen.ids.tolist(), seen.uvd, strict=True)]
        if (given := frame.inertial) is not None:
            begin = t - given.times[-1]
            samples += np.column_stack([begin + given.times, given.angular_rates, given.specific_forces]).tolist()
    samples[0][1:] = samples[1][1:]
    np.savetxt(folder / "tracks.csv", rows, delimiter=",", header="t,id,u,v", comments="", fmt="%.9g")
    np.savetxt(folder / "imu.csv", samples, delimiter=",", header="t,wx,wy,wz,ax,ay,az", comments="", fmt="%.12g")
    camera, unit = recording.camera, recording.frames[1].inertial.unit
    numbers = ", ".join(f"{name} = {getattr(camera, name)}" for name in ("fx", "fy", "cx", "cy", "width", "height"))
    about = f'camera = {{ {numbers} }}\nsigma_px = 1.0\ntruth = "truth.tum"\nreference = "surveyed"\n[unit]\n'
    about += f"position = {unit.position.tolist()}\norientation = {unit.orientation.tolist()}\n"
    densities = "gyro_density", "accelerometer_density", "gyro_walk", "accelerometer_walk"
    about += "".join(f"{name} = {getattr(unit, name)}\n" for name in densities)
    (folder / "recording.toml").write_text(about, encoding="utf-8")
    poses = [frame.truth for frame in recording.frames]
    times = np.array([frame.timestamp for frame in recording.frames])
    truth = Trajectory(np.array([p.position for p in poses]), np.array([p.orientation for p in poses]), times)
    save_trajectory(folder / "truth.tum", truth)
    return folder


def test_a_flight_with_a_rest_is_read_stored_and_followed(tmp_path: Path) -> None:
    """4 s at rest, then 4 s: .01 to .05 m, from the folder and from the stored recording."""
    flight = inertial_flight(2, frames=160, period=0.05, rest=(0.0, 4.0))
    read = sse.load(written(flight, tmp_path))
    assert read.truth_from.kind == "surveyed"
    assert read.source["reader"] == "mono_tracks"
    assert [len(f.observation) for f in read.frames] == [len(f.observation) for f in flight.frames]
    assert not any(frame.observation.has_disparity for frame in read.frames)
    sse.save_recording(tmp_path / "stored.npz", read)
    for one in (read, sse.load(tmp_path / "stored.npz")):
        for name, options in (("inertial", {}), ("msckf", {"map_landmarks": 0, "motion": "strapdown"})):
            error = sse.evaluate(name, one, measurement="left", **options).figures.position_rmse_m
            assert error is not None
            assert error < 0.15


def test_its_words_name_no_disparity_and_no_baseline(tmp_path: Path) -> None:
    words = recording_words(sse.load(written(inertial_flight(0, frames=8), tmp_path)))
    assert words["rig"].endswith("px, one camera")
    assert words["its noise"].endswith("median sigma 1.00 / 1.00 px of u / v; no disparity is measured")


def test_filters_of_a_pair_refuse_one_camera() -> None:
    flight = inertial_flight(0, frames=4)
    alone = StereoObservation.of_left([1, 2], [[600.0, 200.0], [700.0, 100.0]], np.eye(2))
    rig = {"camera": flight.camera, "noise": flight.noise}
    ours = "inverse-depth", "dual-bearing", "euclidean", "inertial", "msckf", "submaps"
    for name in (*ours, "batch", "frame-to-frame", "filterpy-ekf"):
        slam = make_filter(name, **rig)
        before = slam.pose.covariance
        with pytest.raises(ValueError, match=NEEDS):
            slam.update(alone)
        np.testing.assert_array_equal(slam.pose.covariance, before)
    batch = FilterBatch(lambda: StereoEKF(**rig), 2)
    with pytest.raises(ValueError, match=NEEDS):
        batch.update([alone, None])
    with pytest.raises(ValueError, match=r"^R must be that of measured disparities"):
        batch.step_arrays(0.1, np.array([[1], [1]]), np.zeros((2, 1, 3)), alone.R[0])


def test_a_landmark_of_one_camera_starts_from_the_stated_inverse_depth() -> None:
    """0.25 ± 0.1 / m on the axis, of a camera whatever its baseline: 4 m away, ± 1.6 m to first order."""
    flight = inertial_flight(0, frames=4)
    sensor = {"name": "left", "inverse_depth": 0.25, "sigma_inverse_depth": 0.1}
    for baseline in (0.1, 1.0):
        camera = replace(flight.camera, baseline=baseline)
        slam = make_filter("inertial", camera=camera, noise=flight.noise, measurement=sensor)
        slam.update(StereoObservation.of_left([1], [[camera.cx, camera.cy]], np.eye(2)))
        np.testing.assert_allclose(slam.landmarks.positions, [[0.0, 0.0, 4.0]], atol=1e-9)
        assert np.sqrt(slam.landmarks.covariances[0, 2, 2]) == pytest.approx(1.6, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("tracks.csv", b"0.0,0,10,5", b"0.0,0.5,10,5", r"tracks.csv has ids that are no whole numbers"),
        ("recording.toml", b"fx = 30.0", b"fx = -30.0", r"camera.fx must be a finite number > 0, got -30.0: correct"),
        ("recording.toml", b"sigma_px = 1.0", b"", r"recording.toml: sigma_px must be the deviation of a pixel"),
        ("recording.toml", b"gyro_walk = 1e-5", b"", r"recording.toml: unit must be a table of position, orientation"),
        ("recording.toml", b"fx = 30.0", b"baseline = 1.0", r"recording.toml: camera must be a table of fx, fy"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, name: str, old: bytes, new: bytes, message: str) -> None:
    files = {**mono_tracks()}
    assert old in files[name]
    files[name] = files[name].replace(old, new, 1)
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        sse.load(tmp_path)


def test_samples_that_end_early_are_named(tmp_path: Path) -> None:
    files = {**mono_tracks()}
    files["imu.csv"] = b"".join(files["imu.csv"].splitlines(keepends=True)[:8])
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
    with pytest.raises(ValueError, match=r"imu.csv does not cover the step to the frame at 0.2 s: cut tracks.csv$"):
        sse.load(tmp_path)
