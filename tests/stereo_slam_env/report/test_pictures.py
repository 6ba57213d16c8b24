"""One call from a run to a picture."""

from __future__ import annotations

import numpy as np
import pytest

import stereo_slam_env as sse
from stereo_slam_env.recording.trajectory import Trajectory

from ...synthetic_runs import make_runs


@pytest.fixture(scope="module")
def recording():
    return sse.record("StereoSlam/Drive-v0", seed=3, route="right-turn", frames=30)


@pytest.fixture(scope="module")
def evaluation(recording):
    return sse.evaluate("right-invariant", recording, drop_unseen=False)


@pytest.mark.parametrize("show", [sse.show_nees, sse.show_errors, sse.show_map])
@pytest.mark.parametrize("ending", ["svg", "png"])
def test_a_run_is_one_call_from_a_picture(evaluation, tmp_path, show, ending):
    picture = show(evaluation)
    picture.save(tmp_path / f"run.{ending}", str(tmp_path / f"again.{ending}"))
    assert (tmp_path / f"run.{ending}").read_bytes() == (tmp_path / f"again.{ending}").read_bytes()
    shown = picture._repr_mimebundle_()
    assert "right-invariant" in shown["image/svg+xml"]
    assert (tmp_path / f"run.{ending}").read_bytes().startswith(b"<svg" if ending == "svg" else b"\x89PNG")


def test_the_map_has_the_landmarks_that_the_filter_ends_with(evaluation, recording):
    belief = evaluation.series.final_map
    moments = list(sse.run("right-invariant", recording, drop_unseen=False))
    np.testing.assert_array_equal(belief.positions, moments[-1].slam.landmarks.positions)
    svg = sse.show_map(evaluation).svg()
    assert "landmarks of the last frame with 3σ ellipses" in svg
    assert "truth" in svg


def test_a_trajectory_is_shown_as_a_run_is(evaluation):
    run = evaluation.series
    estimate = Trajectory(run.positions, run.orientations, run.timestamps, run.pose_covariances, name="mine")
    truth = Trajectory(run.true_positions, run.true_orientations, run.timestamps, name="truth")
    score = sse.evaluate_trajectory(estimate, truth, align="none")
    for show in (sse.show_nees, sse.show_errors, sse.show_map):
        assert "mine" in show(score).svg()


def test_nees_of_many_runs_are_averaged_and_other_pictures_want_one_of_them():
    runs = make_runs(seeds=range(3))
    assert "mean of 3 runs" in sse.show_nees(runs).svg()
    for show in (sse.show_errors, sse.show_map):
        with pytest.raises(ValueError, match="single one, got 9: give one of them"):
            show(runs)


def test_what_is_no_run_or_has_nothing_to_show_is_refused():
    (blind, *_) = make_runs(seeds=[0], truth="none")
    for show, said in ((sse.show_nees, "there is no NEES to show"), (sse.show_errors, "no errors to show")):
        with pytest.raises(ValueError, match=said):
            show(blind)
    assert "truth" not in sse.show_map(blind).svg()
    for thing in ("drive.npz", 3, []):
        with pytest.raises(ValueError, match="run must be what"):
            sse.show_nees(thing)
