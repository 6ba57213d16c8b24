"""The public face: load or record, run, evaluate, compare (20 s)."""

import importlib
import json

import numpy as np
import pytest

import stereo_slam_env as sse
from filters import InverseDepthStereoEKF

from .benchmark.small_recordings import small_recording

RECORDING = small_recording()
ROOMS = ("", ".envs", ".policies", ".viewer")


class Worse(InverseDepthStereoEKF):
    """Believes measurements ten times worse than they are."""

    def __init__(self, camera, noise, **options):
        super().__init__(camera, type(noise)(100.0 * noise.R), **options)


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_can_be_had(room):
    module = importlib.import_module(f"stereo_slam_env{room}")
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name).__doc__
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = module.no_such_name


def test_the_public_face_can_be_read_at_a_glance():
    assert len([name for name in sse.__all__ if not name.startswith("__")]) <= 37


def test_run_stays_a_function_after_the_loop_has_been_imported():
    importlib.import_module("stereo_slam_env.loop")
    assert callable(sse.run)


def test_a_drive_is_recorded_run_and_evaluated():
    recording = sse.record("StereoSlam/Drive-v0", seed=3, route="right-turn", rig="qvga", policy="route", frames=6)
    assert (len(recording), recording.source["arguments"]["route"]) == (6, "right-turn")
    moments = [moment.nees for moment in sse.run("inverse-depth", recording, gate=0.99)]
    evaluation = sse.evaluate("inverse-depth", recording, gate=0.99)
    np.testing.assert_allclose(evaluation.series.pose_nees, moments)
    assert evaluation.figures.position_rmse_m > 0.0
    assert "position" in str(evaluation)


def test_a_head_that_turns_is_recorded_with_a_policy():
    ahead, sweep = (
        sse.record("StereoSlam/Gaze-v0", seed=1, policy=policy, frames=5, rig="qvga") for policy in ("route", "sweep")
    )
    assert len(ahead) == len(sweep) == 5
    assert np.abs([frame.head for frame in ahead.frames]).max() == 0.0
    assert np.abs([frame.head for frame in sweep.frames]).max() > 0.01
    with pytest.raises(ValueError, match="policy must be one of"):
        sse.record("StereoSlam/Gaze-v0", policy="swep", frames=3)


def test_a_filter_that_fails_is_a_result():
    def refuses(camera, noise):
        raise RuntimeError("not today")

    evaluation = sse.evaluate(refuses, RECORDING)
    assert "not today" in evaluation.figures.failures[0]
    assert np.isnan(evaluation.series.positions).all()


def test_filters_are_compared_on_identical_recordings(tmp_path):
    done = []
    comparison = sse.compare(
        ["inverse-depth", Worse], "reference-turn", seeds=6, frames=20, progress=lambda *step: done.append(step)
    )
    assert done[-1] == (12, 12)
    assert comparison.verdict.best == "inverse-depth"
    assert "inverse-depth" in comparison.verdict.headline
    assert all(word in comparison.table for word in ("inverse-depth", "Worse"))
    assert comparison.verdict.headline in str(comparison)
    for seed in range(6):
        runs = [run for run in comparison.runs if run.seed == seed]
        np.testing.assert_array_equal(runs[0].true_positions, runs[1].true_positions)
    with pytest.raises(AssertionError, match="Worse is"):
        comparison.between("Worse", "inverse-depth").assert_consistent()
    page = comparison.report(tmp_path / "page")
    assert page.is_file()
    assert json.dumps(comparison.settings)


def test_recordings_of_ones_own_can_be_compared_on():
    comparison = sse.compare(["inverse-depth", "euclidean"], [small_recording(1), small_recording(2)])
    assert len(comparison.runs) == 4
    assert sse.compare(["inverse-depth"], RECORDING).title == "small"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([],), "filters must be at least one"),
        ((["euclidean", "euclidean"],), "with different labels"),
        ((["euclidean"], "quik"), "preset must be one of"),
        ((["inverse-dept"], RECORDING), "did you mean 'inverse-depth'"),
    ],
)
def test_what_cannot_be_compared_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        sse.compare(*arguments)
    with pytest.raises(ValueError, match="options must be for one of euclidean, got 'other'"):
        sse.compare(["euclidean"], RECORDING, options={"other": {}})
    with pytest.raises(ValueError, match="seeds must be at least one"):
        sse.compare(["euclidean"], "reference-turn", seeds=0)


def test_what_cannot_be_recorded_or_evaluated_is_refused():
    with pytest.raises(ValueError, match=r"^seed must be a whole number >= 0, got -1"):
        sse.record(seed=-1)
    with pytest.raises(ValueError, match=r"^recording must be a Recording, as load and record give it, got 'gtsam'"):
        sse.evaluate("euclidean", "gtsam")


def test_a_recording_of_a_preset_is_that_of_the_benchmark():
    recording = sse.make_recording("reference-turn", seed=4)
    assert recording.source["seed"] == 4
    assert len(recording[:7]) == 7
    assert recording[:7].landmarks is recording.landmarks
