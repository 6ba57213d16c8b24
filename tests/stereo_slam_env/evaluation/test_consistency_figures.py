"""Bands of NEES and NIS over runs, against made-up runs that are what they should be (1 s)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, t

from stereo_slam_env.evaluation.bands import consistency_figures, mean_band
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


@pytest.mark.parametrize("what", ["pose", "position", "rotation", "nis"])
def test_bands_and_the_share_of_frames_inside_are_chi_square_written_out(honest, what):
    runs = honest[:5]
    figure = consistency_figures(runs)[what]
    if what == "nis":
        nis, dof = (np.array([getattr(run, name)[1:] for run in runs]).sum(axis=0) for name in ("nis", "nis_dof"))
        low, high = chi2.ppf([[0.025], [0.975]], dof) / dof
        mean, inside = nis.sum() / dof.sum(), (nis / dof >= low) & (nis / dof <= high)
        band = chi2.ppf([0.025, 0.975], dof.sum()) / dof.sum()
    else:
        values, dof = np.array([getattr(run, f"{what}_nees")[1:] for run in runs]), {"pose": 6}.get(what, 3)
        band = chi2.ppf([0.025, 0.975], 5 * dof) / 5
        by_frame = values.mean(axis=0)
        mean, inside = values.mean(), (by_frame >= band[0]) & (by_frame <= band[1])
    assert figure.band == pytest.approx(band, rel=1e-12)
    assert figure.mean == pytest.approx(mean, rel=1e-12)
    assert figure.inside_percent == pytest.approx(100.0 * inside.mean(), rel=1e-12)


def test_the_band_of_landmarks_is_students_of_the_means_of_runs(honest):
    runs = honest[:6]
    means = np.array([run.landmark_nees[1:].mean() for run in runs])
    reach = t.ppf(0.975, 5) * means.std(ddof=1) / np.sqrt(6)
    widest = chi2.ppf([0.025, 0.975], 18) / 6
    assert widest[0] < 3.0 - reach  # the scatter decides here
    assert consistency_figures(runs)["landmark"].band == pytest.approx((3.0 - reach, 3.0 + reach), rel=1e-12)
    wild = [
        replace(run, landmark_nees=factor * run.landmark_nees)
        for factor, run in zip(10.0 ** np.arange(6), runs, strict=True)
    ]
    assert consistency_figures(wild)["landmark"].band == pytest.approx(tuple(widest), rel=1e-12)


def test_the_ends_of_a_band_belong_to_it(honest):
    """Landmarks whose NEES is 3 in every run have no scatter: their band is 3, and holds them."""
    exact = [replace(run, landmark_nees=np.full(FRAMES, 3.0)) for run in honest]
    figure = consistency_figures(exact)["landmark"]
    assert (figure.band, figure.inside_percent) == ((3.0, 3.0), 100.0)
