"""Every figure draws for every kind of run, and shows what it says (about 10 s)."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.evaluation.trial import position_rmse
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.accuracy import plot_error_by_run, plot_trajectory, plot_velocity
from stereo_slam_env.report.charts.axes import filter_colours
from stereo_slam_env.report.charts.factors import plot_time_per_frame
from stereo_slam_env.report.charts.nees import (
    error_limits,
    plot_depth,
    plot_error_bounds,
    plot_nees,
    plot_nis,
)

from ....synthetic_runs import THREE, THREE_ONE_DIVERGING, make_runs
from .reading import panels, values


def failed(run, at):
    """The run as the runner leaves it when the filter raises at frame `at`."""
    cut = {
        name: np.where(np.arange(len(run)).reshape(-1, *[1] * (value.ndim - 1)) < at, value, np.nan)
        for name, value in vars(run).items()
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and not name.startswith(("true_", "time"))
    }
    return replace(run, failure=f"frame {at}: ValueError: singular", **cut)


def one_failed():
    runs = make_runs(frames=60)
    return [failed(run, 30) if run.filter_name == "euclidean" and run.seed == 0 else run for run in runs]


CASES = {
    "five seeds": lambda: make_runs(frames=60),
    "one diverging": lambda: make_runs(THREE_ONE_DIVERGING, frames=60),
    "one failed": one_failed,
    "real data, gaps in the truth": lambda: make_runs(seeds=[None], frames=60, truth="gaps"),
    "no truth": lambda: make_runs(seeds=[None], frames=60, truth="none"),
    "one filter": lambda: make_runs(THREE[:1], frames=60),
    "no traces": lambda: [replace(run, traces=()) for run in make_runs(seeds=[3], frames=60)],
}
PLOTS = {
    "trajectory": plot_trajectory,
    "error by run": plot_error_by_run,
    "velocity": plot_velocity,
    "time": plot_time_per_frame,
    "nees": plot_nees,
    "nis": plot_nis,
    "error bounds": lambda runs: plot_error_bounds(runs[-1], error_limits(runs)),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", PLOTS)
def test_every_figure_draws_without_a_warning(name, case):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        svg = PLOTS[name](CASES[case]()).svg()
    assert svg.startswith("<svg")
    assert "NaN" not in svg


def test_a_diverging_filter_does_not_flatten_the_others():
    errors = panels(plot_trajectory(make_runs(THREE_ONE_DIVERGING, frames=240)))[1]
    assert errors.y[1] < 1.0
    assert any(words.startswith("↑ euclidean to") for words in errors.words())


def test_the_errors_of_runs_stand_over_those_of_the_best_filter_on_the_same_recording():
    runs = make_runs(frames=60)
    rmse = {(run.filter_name, run.seed): position_rmse(run) for run in runs}
    names = {run.filter_name for run in runs}
    best = min(names, key=lambda name: sum(value**2 for (other, _), value in rmse.items() if other == name))
    absolute, paired = panels(plot_error_by_run(runs))
    assert len(absolute.rows("dots")) == len(runs)
    drawn = sorted(float(row["x"][0]) for row in paired.rows("dots"))
    assert drawn == pytest.approx(
        sorted(v / rmse[best, seed] for (name, seed), v in rmse.items() if name != best), rel=1e-3
    )
    assert len(panels(plot_error_by_run([run for run in runs if run.filter_name == best]))) == 1


def test_a_median_is_never_cut_off():
    runs = make_runs(THREE[:1], seeds=range(2), frames=60)
    errors = panels(plot_trajectory(runs))[1]
    assert np.nanmax(values(errors.curves()["inverse-depth"])) < errors.y[1]


def test_trajectories_have_equal_scales():
    panel = panels(plot_trajectory(make_runs(frames=60)))[0]
    assert np.ptp(panel.x) / panel.size[0] == pytest.approx(np.ptp(panel.y) / panel.size[1], rel=0.01)


def test_a_line_has_the_colour_of_its_filter():
    runs = make_runs(seeds=[0], frames=60)
    drawn = {name: row["colour"] for name, row in panels(plot_velocity(runs))[0].curves().items() if name}
    assert drawn == filter_colours(run.filter_name for run in runs)


def test_the_nees_band_narrows_with_the_number_of_runs():
    def band_height(seeds):
        (band,) = panels(plot_nees(make_runs(THREE[:1], seeds=range(seeds), frames=20)))[0].rows("bands")
        return values(band, "high")[-1] / values(band, "low")[-1]

    assert band_height(8) < band_height(2)


def test_depth_shows_estimate_truth_and_raw_measurements():
    near, far, *_ = panels(plot_depth(make_runs(frames=60)))
    assert near.title.startswith("Near")
    assert far.title.startswith("Far")
    assert len(near.rows("lines")) == 1 + len(THREE)
    assert len(near.rows("dots")[0]["x"]) == 11


def test_depth_without_a_trace_says_so():
    with pytest.raises(ValueError, match="trace"):
        plot_depth([replace(run, traces=()) for run in make_runs(seeds=[0], frames=60)])


def test_belief_error_is_the_contract_of_the_pose_belief():
    run = make_runs(THREE[:1], seeds=[0], frames=60)[0]
    error, sigma = series.belief_error(run)
    np.testing.assert_allclose(error, run.pose_errors, atol=1e-12)
    np.testing.assert_allclose(sigma**2, np.diagonal(run.pose_covariances, axis1=1, axis2=2))


def test_heading_turns_to_the_right_and_does_not_jump():
    angles = np.linspace(0.0, 3 * np.pi, 50)
    orientations = Rotation.from_rotvec(angles[:, None] * [0.0, 1.0, 0.0]).as_quat()
    np.testing.assert_allclose(series.heading(orientations), angles, atol=1e-9)


def test_distance_is_measured_over_frames_with_truth():
    run = make_runs(THREE[:1], seeds=[0], frames=60, truth="gaps")[0]
    travelled = series.distance(run)
    assert np.isnan(travelled[1])
    assert series.last_known(travelled) == pytest.approx(
        np.linalg.norm(np.diff(run.true_positions[::3], axis=0), axis=1).sum()
    )


@pytest.mark.parametrize("frames", [2, 60, 81, 82, 200, 201, 1000])
def test_the_band_of_nis_has_bins_of_one_size(frames):
    """With as many innovations in each frame the band is two straight lines: no sawtooth of bins of 2 and 3 frames."""
    (run,) = make_runs(THREE[:1], (0,), frames=frames)
    dofs = np.where(np.arange(frames) > 0, 150, 0)
    (panel,) = panels(plot_nis([replace(run, nis=1.0 * dofs, nis_dof=dofs)]))
    (band,) = panel.rows("bands")
    for end in ("low", "high"):
        assert np.ptp(values(band, end)) < 1e-9
    np.testing.assert_allclose(values(panel.rows("lines")[0]), 1.0)
