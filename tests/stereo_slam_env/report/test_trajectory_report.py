"""The page of judged trajectories: the verdict first, tubes and errors to scale, hostile names (10 s)."""

import re
from dataclasses import replace

import numpy as np
import pytest

import stereo_slam_env as sse
from filters.geometry import rotations
from stereo_slam_env.evaluation.trajectory_runs import score_runs
from stereo_slam_env.report import write_trajectory_report
from stereo_slam_env.report.charts.trajectories import plot_calibration, plot_errors, plot_nees_over_time, plot_paths

SIGMA = 0.02  # m, rad


def straight(count=200, name="mine", sigma=SIGMA, seed=0, every=1):
    """An estimate of a straight drive along z at 10 m/s with independent errors of `SIGMA`, and the truth."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(count)
    positions = np.column_stack([0 * t, 0 * t, 10.0 * t])
    orientations = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    covariances = np.tile(sigma**2 * np.eye(6), (count, 1, 1))
    estimate = sse.Trajectory(positions + SIGMA * rng.normal(size=(count, 3)), orientations, t, covariances, name=name)
    return estimate.rows(slice(None, None, every)), sse.Trajectory(positions, orientations, t, name="truth")


def score(**about):
    return sse.evaluate_trajectory(*straight(**about))


def lists(chart, key):
    """Data of the lines and outlines of a series of a chart."""
    rows = (row for rows in chart.spec["datasets"].values() for row in rows)
    return [row for row in rows if row.get("key") == key and isinstance(row.get("x"), list)]


def test_errors_and_tubes_are_drawn_with_one_factor():
    judged = score()
    chart, factor = plot_paths([judged])
    (tube,) = [row for row in lists(chart, "mine") if row["said"] is None]
    path = next(row for row in lists(chart, "mine") if row["said"] is not None)
    # The drive goes along z, which is drawn across; x is drawn upwards.
    true = -factor * judged.position_errors[:, 0]
    assert factor > 1
    assert np.abs(path["y"]).max() == pytest.approx(np.abs(true).max(), rel=1e-3)
    n = len(judged.times)
    half = (np.array(tube["y"][:n]) - np.array(tube["y"][n:][::-1])) / 2
    assert np.abs(half) == pytest.approx(3 * SIGMA * factor, rel=1e-3)
    middle = (np.array(tube["y"][:n]) + np.array(tube["y"][n:][::-1])) / 2
    assert middle == pytest.approx(true, abs=2e-3 * factor)


def test_an_error_as_large_as_the_drive_is_drawn_as_it_is():
    estimate, truth = straight()
    far = replace(estimate, positions=estimate.positions + np.array([30.0, 0.0, 0.0]))
    assert plot_paths([sse.evaluate_trajectory(far, truth)])[1] == 1.0


def test_the_bounds_are_three_sigma():
    (chart,) = plot_errors([score()])
    bands = [row for rows in chart.spec["datasets"].values() for row in rows if isinstance(row.get("low"), list)]
    found = sorted({value for band in bands for value in band["high"]})
    assert found == pytest.approx([3 * SIGMA * 180.0 / np.pi, 3 * SIGMA * 100.0], rel=1e-3)  # degrees, cm


def test_estimates_with_other_frames_share_the_chart_without_gaps():
    chart = plot_nees_over_time([score(), score(name="theirs", every=3)])
    for key in ("mine", "theirs"):
        (row,) = [row for row in lists(chart, key) if row["said"] is not None]
        known = [k for k, value in enumerate(row["y"]) if value is not None]
        assert len(known) > 50
        assert None not in row["y"][known[0] : known[-1]]


def text_of(page):
    return re.sub(r"<script.*?</script>|<style.*?</style>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_the_verdict_comes_first(tmp_path):
    page = write_trajectory_report(tmp_path, [score(sigma=SIGMA / 3)])
    text = text_of(page)
    assert text.index("its covariance is overconfident: errors are 2") < text.index("<figure")
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {
        f"{name}.{ending}"
        for name in ("path", "errors_0", "nees", "calibration", "windows")
        for ending in ("png", "svg")
    }
    assert "pose NEES / 6" in text


def test_runs_are_judged_together_before_one_by_one(tmp_path):
    scores = [score(name=f"run {k}", seed=k) for k in range(6)]
    runs = score_runs(scores)
    text = text_of(write_trajectory_report(tmp_path, scores, runs=runs))
    assert text.index("6 runs together: pose ANEES / 6") < text.index("<figure") < text.index("one run can tell")
    assert "6 runs, judged together" in text
    assert " m each · aligned: " in text
    assert "The first 4 of 6 runs, here and below." in text
    assert (tmp_path / "figures" / "runs.svg").is_file()
    assert (tmp_path / "figures" / "errors_3.svg").is_file()
    assert not (tmp_path / "figures" / "errors_4.svg").exists()


def test_a_right_claim_has_the_calibration_of_the_diagonal():
    estimate, truth = straight(count=4000)
    rng = np.random.default_rng(4)
    turned = rotations.exp_quaternion(SIGMA * rng.normal(size=(4000, 3)))
    chart = plot_calibration([sse.evaluate_trajectory(replace(estimate, orientations=turned), truth)])
    inside, density = lists(chart, "mine")[0], lists(chart, "mine")[-1]
    assert np.array(inside["y"]) == pytest.approx(np.array(inside["x"]), abs=4.0)
    assert np.array(density["y"]) == pytest.approx(1.0, abs=0.4)


def test_the_claim_under_each_alignment_is_in_a_table(tmp_path):
    text = text_of(write_trajectory_report(tmp_path, [score()]))
    assert "Alignments" in text
    assert {"none", "start"} <= set(re.findall(r"<td[^>]*>\s*([\w-]+)\s*<", text))


def test_two_estimates_and_the_verdict_on_both(tmp_path):
    judged = [score(), score(seed=1)]
    page = write_trajectory_report(tmp_path, judged, judged[0].against(judged[1]))
    text = text_of(page)
    assert "mine (1)" in text
    assert "mine (2)" in text
    assert "not significant" in text


def test_without_covariances_there_is_nothing_to_believe(tmp_path):
    estimate, truth = straight()
    judged = sse.evaluate_trajectory(replace(estimate, covariances=None), truth)
    text = text_of(write_trajectory_report(tmp_path, [judged]))
    assert "it claims no covariance" in text
    assert "NEES" not in text
    assert "3σ" not in text


def test_names_of_strangers_are_plain_text(tmp_path):
    page = write_trajectory_report(tmp_path, [score(name="<script>alert(1)</script>")])
    assert "<script>alert" not in page.read_text(encoding="utf-8")


def test_no_scores_are_refused(tmp_path):
    with pytest.raises(ValueError, match="scores must not be empty"):
        write_trajectory_report(tmp_path, [])
