"""Bands of NEES and NIS over runs, and intervals, hold what they promise (3 s)."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import chi2, t

from filters.checks.consistency import nees
from stereo_slam_env.benchmark.statistics.differences import level
from stereo_slam_env.evaluation.bands import (
    consistency_figures,
    mean_band,
    rms_ratio_interval,
    share_inside,
    studentised_interval,
)
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
    assert consistency_figures(honest[:1])["landmark"].band == pytest.approx(mean_band(3, 1))
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


def test_the_band_of_50_poses_is_the_published_one():
    low, high = mean_band(6, 50)
    assert (low / 6, high / 6) == pytest.approx((0.846, 1.166), abs=2e-3)


@pytest.mark.parametrize(
    ("arguments", "complaint"), [((0, 5), "dof"), ((6, 0), "runs"), ((6, 5, 1.0), "probability"), ((6, 5, 0), "probab")]
)
def test_impossible_bands_are_refused(arguments, complaint):
    with pytest.raises(ValueError, match=complaint):
        mean_band(*arguments)


def test_nees_of_errors_drawn_from_their_covariance_averages_to_the_dof():
    rng = np.random.default_rng(1)
    factors = rng.standard_normal((4000, 6, 6))
    errors = np.einsum("kij,kj->ki", factors, rng.standard_normal((4000, 6)))
    assert nees(errors, factors @ factors.transpose(0, 2, 1)).mean() == pytest.approx(6.0, abs=0.2)


def test_nees_is_unknown_where_the_covariance_is_no_covariance():
    covariances = np.array([np.eye(2), np.diag([1.0, 0.0]), np.diag([1.0, -1.0]), np.full((2, 2), np.nan)])
    np.testing.assert_array_equal(nees(np.ones((4, 2)), covariances), [2.0, np.nan, np.nan, np.nan])


def test_share_inside_counts_finite_values_only():
    assert share_inside(np.array([1.0, 2.0, 3.0, np.nan]), (1.5, 3.0)) == pytest.approx(2 / 3)
    assert share_inside(np.array([np.nan, 0.5]), (0.0, 1.0)) == 1.0
    assert np.isnan(share_inside(np.array([np.nan]), (0.0, 1.0)))


DRAWS = {
    "normal": lambda rng, shape: rng.standard_normal(shape),
    "heavy-tailed": lambda rng, shape: rng.standard_t(3, shape),
    "contaminated": lambda rng, shape: rng.standard_normal(shape) * np.where(rng.random(shape) < 0.1, 10.0, 1.0),
}


@pytest.mark.parametrize("draw", DRAWS)
@pytest.mark.parametrize("count", [8, 10, 20, 50])
def test_an_interval_holds_the_truth_in_at_least_93_of_100_cases(draw, count):
    data = DRAWS[draw](np.random.default_rng(count), (count, 400))
    low, high = studentised_interval(data, 0.95)
    assert np.mean((low <= 0.0) & (high >= 0.0)) >= 0.93


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_an_interval_is_halls_symmetric_studentised_one(confidence):
    """Written out with other random numbers: |mean* - mean| / error* of 200,000 resamples of nine rows."""
    data = np.random.default_rng(3).gamma(2.0, size=9)
    resamples = data[np.random.default_rng(4).integers(9, size=(200_000, 9))]
    errors = resamples.std(axis=1, ddof=1) / 3.0
    ratios = np.abs(resamples.mean(axis=1) - data.mean()) / np.where(errors > 1e-9, errors, np.inf)
    half = np.quantile(ratios, confidence) * data.std(ddof=1) / 3.0
    low, high = studentised_interval(data[:, None], confidence)
    assert float(high[0] + low[0]) / 2 == pytest.approx(data.mean(), rel=1e-12)
    assert float(high[0] - low[0]) / 2 == pytest.approx(half, rel=0.03)  # without ddof: 0.06 less


def test_resamples_of_a_single_row_count_as_no_shift():
    """Of the 27 equally likely resamples of three rows, three: the others are enumerated."""
    data = np.array([0.0, 1.0, 4.0])
    resamples = data[np.array(list(product(range(3), repeat=3)))]
    errors = resamples.std(axis=1, ddof=0) / np.sqrt(2.0)
    shifts = np.abs(resamples.mean(axis=1) - data.mean())
    ratios = np.divide(shifts, errors, out=np.zeros(27), where=errors > 1e-9)
    low, high = studentised_interval(data[:, None], 0.9)
    wanted = np.quantile(ratios, 0.9, method="inverted_cdf") * data.std(ddof=1) / np.sqrt(3.0)
    assert float(high[0] - low[0]) / 2 == pytest.approx(wanted, rel=1e-6)


def test_an_interval_for_many_comparisons_holds_for_all_of_them_together():
    data = DRAWS["heavy-tailed"](np.random.default_rng(5), (10, 12 * 60))
    low, high = studentised_interval(data, level(12))
    assert np.all(((low <= 0.0) & (high >= 0.0)).reshape(12, 60), axis=0).mean() >= 0.93


def test_same_seed_same_interval_and_a_column_does_not_depend_on_the_others():
    data = DRAWS["normal"](np.random.default_rng(6), (10, 3))
    once, again = studentised_interval(data, 0.95), studentised_interval(data, 0.95)
    assert np.array_equal(once, again)
    np.testing.assert_allclose(
        np.array(studentised_interval(data[:, 1:2], 0.95))[:, 0], np.array(once)[:, 1], rtol=1e-9
    )
    assert not np.array_equal(once, studentised_interval(data, 0.95, seed=1))


def test_the_interval_of_a_ratio_holds_that_of_the_root_mean_squares():
    rng = np.random.default_rng(0)
    first = rng.uniform(0.05, 0.1, 10)
    assert rms_ratio_interval(first, 2.0 * first) == pytest.approx((0.5, 0.5))
    inside = 0
    for _ in range(100):
        second = 0.08 * np.sqrt(rng.chisquare(6, 20) / 6)
        low, high = rms_ratio_interval(np.full(20, 0.08), second)
        assert 0 < low < high < 2
        inside += low <= 1 <= high
    assert 85 <= inside <= 99
