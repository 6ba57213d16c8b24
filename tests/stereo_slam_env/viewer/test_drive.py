"""A drive to watch, of a recording and of a finished run (8 s)."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from filters import InverseDepthStereoEKF
from stereo_slam_env.benchmark.storage.run_files import load_run, packed_run
from stereo_slam_env.benchmark.storage.store import read_study
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.viewer.rerun_view import LARGEST, SIGMAS, ellipsoids
from stereo_slam_env.viewer.watched_drive import Drive, revisit

from ..benchmark.small_recordings import small_recording


def stored(directory, name, seed):
    (run,) = read_study(directory).cells
    (choice,) = (choice for choice in run.scenario.competitors if choice.label == name)
    found = load_run(run.trial_path(seed, choice))
    return run.trial_path(seed, choice), (found.run, found.provenance)


def test_a_drive_is_what_the_benchmark_makes_of_the_recording():
    recording = small_recording()
    run = run_filter(recording, InverseDepthStereoEKF)
    drive = Drive.of(recording, InverseDepthStereoEKF, label="mine")
    assert (drive.label, drive.title, drive.frames) == ("mine", f"mine on {recording.name}", len(recording))
    with threadpool_limits(limits=1):  # as in a benchmark, for the same bits
        moments = list(drive.moments())
    np.testing.assert_array_equal([m.pose.position for m in moments], run.positions)
    np.testing.assert_array_equal([m.nees for m in moments], run.pose_nees)
    np.testing.assert_array_equal([m.report.nis for m in moments], run.nis)
    np.testing.assert_array_equal([len(m.landmarks.ids) for m in moments], run.counts["map_size"])


@pytest.mark.parametrize(("name", "seed"), [("inverse-depth", 3), ("euclidean", 4)])
def test_a_run_is_revisited_to_the_bit(finished_run, name, seed):
    _, (run, _) = stored(finished_run, name, seed)
    drive = revisit(finished_run, name, seed)
    assert (drive.label, drive.frames) == (name, 8)
    np.testing.assert_array_equal([m.nees for m in drive.moments()], run.pose_nees)


@pytest.mark.parametrize(
    ("look", "message"),
    [
        (
            lambda run: revisit(run, "dual-bearing"),
            "filter must be one of inverse-depth, euclidean, got 'dual-bearing'",
        ),
        (lambda run: revisit(run, None, 7), r"seed must be one of the run's \(3, 4\), got 7"),
        (lambda run: revisit(run.parent), "holds no run"),
        (lambda run: revisit(run / "nowhere"), "nowhere does not exist: give the directory of a run"),
        (lambda run: Drive.of(replace(small_recording(), frames=()), InverseDepthStereoEKF), "has no frames"),
    ],
)
def test_what_is_not_there_is_refused_by_name(finished_run, look, message):
    assert revisit(finished_run).title == "inverse-depth: short turn, seed 3"
    with pytest.raises(ValueError, match=message):
        look(finished_run)


def test_a_run_that_failed_is_shown_as_far_as_it_came(finished_run):
    path, (run, provenance) = stored(finished_run, "euclidean", 3)
    positions = run.positions.copy()
    positions[5:] = np.nan
    before = path.read_bytes()
    try:
        failed = replace(run, positions=positions, failure="frame 5: LinAlgError: no")
        path.write_bytes(packed_run(failed, provenance))
        drive = revisit(finished_run, "euclidean", 3)
        failed = replace(run, positions=np.full_like(positions, np.nan), failure="start: no")
        path.write_bytes(packed_run(failed, provenance))
        with pytest.raises(ValueError, match="nothing to show, it failed in start: no"):
            revisit(finished_run, "euclidean", 3)
    finally:
        path.write_bytes(before)
    assert len(list(drive.moments())) == drive.frames == 5
    assert drive.title.endswith("until it failed in frame 5: LinAlgError: no")


@pytest.mark.parametrize("size", [2, 3])
def test_an_ellipsoid_has_the_covariance_it_was_made_from(size):
    root = np.random.default_rng(0).normal(size=(20, size, size))
    covariances = root @ root.transpose(0, 2, 1)
    half_sizes, axes, drawn = ellipsoids(covariances)
    again = axes * (half_sizes[:, None, :] / SIGMAS) ** 2 @ axes.transpose(0, 2, 1)
    np.testing.assert_allclose(again, covariances, atol=1e-10)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    np.testing.assert_array_equal(drawn, half_sizes.max(axis=1) <= LARGEST)


def test_an_ellipsoid_that_is_none_is_not_drawn():
    covariances = np.stack([np.eye(3), np.full((3, 3), np.nan), np.diag([1.0, 1.0, -1.0]), 1e4 * np.eye(3)])
    assert ellipsoids(covariances).drawn.tolist() == [True, False, False, False]
    assert ellipsoids(np.zeros((0, 3, 3))).quaternions.shape == (0, 4)
