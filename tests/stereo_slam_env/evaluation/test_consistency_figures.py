"""Bands of NEES and NIS over runs, against made-up runs that are what they should be (1 s)."""

from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.evaluation.consistency import consistency_figures, mean_band
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics

from ...synthetic_runs import THREE, make_runs

RUNS, FRAMES = 20, 400


@pytest.fixture(scope="module")
def honest():
    """Runs of a filter that is as sure as it is right; 20 landmarks a frame that share most of their error."""
    rng = np.random.default_rng(3)
    made = []
    for run in make_runs(THREE[:1], range(RUNS), FRAMES):
        shared = rng.standard_normal((FRAMES, 1, 3))
        errors = np.sqrt(0.7) * shared + np.sqrt(0.3) * rng.standard_normal((FRAMES, 20, 3))
        landmarks = np.sum(errors**2, axis=2)
        series = {
            "position_nees": rng.chisquare(3, FRAMES),
            "rotation_nees": rng.chisquare(3, FRAMES),
            "landmark_nees": landmarks.mean(axis=1),
            "nis": np.where(run.nis_dof > 0, rng.chisquare(np.maximum(run.nis_dof, 1)), 0.0),
            "landmark_statistics": LandmarkStatistics(
                nees_count=np.full(5, 4.0 * FRAMES), nees=np.full(5, landmarks.sum() / 5)
            ),
        }
        made.append(replace(run, **series, pose_nees=series["position_nees"] + series["rotation_nees"]))
    return made


def scaled(runs, factor):
    """The same runs of a filter that claims a smaller covariance."""
    return [
        replace(
            run,
            **{f"{name}_nees": factor * getattr(run, f"{name}_nees") for name in ("pose", "position", "landmark")},
            nis=factor * run.nis,
            landmark_statistics=replace(run.landmark_statistics, nees=factor * run.landmark_statistics.nees),
        )
        for run in runs
    ]


@pytest.mark.parametrize(("what", "dof"), [("pose", 6), ("position", 3), ("rotation", 3), ("landmark", 3), ("nis", 1)])
def test_an_honest_filter_is_inside_its_bands(honest, what, dof):
    figure = consistency_figures(honest)[what]
    assert figure.dof == dof
    assert figure.band[0] < figure.mean < figure.band[1]
    assert figure.inside_percent == pytest.approx(95.0, abs=4.0)


@pytest.mark.parametrize("what", ["pose", "position", "landmark", "nis"])
@pytest.mark.parametrize("factor", [0.6, 1.7])
def test_one_that_claims_too_much_or_too_little_is_outside(honest, what, factor):
    figure = consistency_figures(scaled(honest, factor))[what]
    assert not figure.band[0] < figure.mean < figure.band[1]
    assert figure.inside_percent < 70.0


def test_the_bands_are_those_of_so_many_runs_and_innovations(honest):
    figures = consistency_figures(honest[:7])
    assert figures["pose"].band == pytest.approx(mean_band(6, 7))
    assert figures["rotation"].band == pytest.approx(mean_band(3, 7))
    assert figures["nis"].band == pytest.approx(mean_band(1, sum(int(run.nis_dof.sum()) for run in honest[:7])))


def test_the_band_of_landmarks_is_wider_than_of_independent_ones_and_narrower_than_of_one(honest):
    low, high = consistency_figures(honest)["landmark"].band
    independent, single = mean_band(3, 20 * FRAMES * RUNS), mean_band(3, RUNS)
    assert single[0] < low < independent[0]
    assert independent[1] < high < single[1]
    assert consistency_figures(honest[:1])["landmark"].band == pytest.approx(mean_band(3, 1))


def test_one_run_astray_does_not_excuse_itself_by_its_scatter(honest):
    astray = scaled(honest[:1], 500.0)[0]
    figure = consistency_figures([*honest[1:], astray])["landmark"]
    assert figure.mean > figure.band[1]


def test_frames_count_with_the_runs_that_have_a_value(honest):
    """A shorter run, and one without truth: every frame is judged by the band of those that are left."""
    short = {name: value[:100] for name, value in vars(honest[0]).items() if isinstance(value, np.ndarray)}
    without = replace(honest[1], pose_nees=np.full(FRAMES, np.nan))
    runs = [replace(honest[0], **short, counts={}), without, *honest[2:]]
    figure = consistency_figures(runs)["pose"]
    assert figure.band == pytest.approx(mean_band(6, RUNS - 1))
    assert figure.mean == pytest.approx(np.mean(np.concatenate([run.pose_nees[1:] for run in (runs[0], *runs[2:])])))
    assert figure.inside_percent == pytest.approx(95.0, abs=4.0)


def test_what_is_not_known_is_left_out():
    assert set(consistency_figures(make_runs(THREE[:1], (0,), 50, truth="none"))) == {"nis"}
    assert consistency_figures([]) == {}
