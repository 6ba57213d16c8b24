"""Figures of where policies look, from a made-up recording (2 s)."""

import dataclasses

import numpy as np
import pytest

from stereo_slam_env.report.charts import gaze_figures
from stereo_slam_env.report.charts.interactive import plotly_figure

from ....synthetic_runs import Behaviour, make_runs
from ...benchmark.small_recordings import small_recording


def looking(pan):
    recording = small_recording(0, frames=21)
    frames = tuple(
        dataclasses.replace(frame, head=np.array([pan * k / 20, 0.1])) for k, frame in enumerate(recording.frames)
    )
    return dataclasses.replace(recording, frames=frames)


RECORDINGS = {"fixed": looking(0.0), "sweep": looking(1.0), "random": looking(-0.5)}


def test_every_policy_has_its_pan_in_degrees():
    figure = gaze_figures.plot_gaze(RECORDINGS)
    named = {line.get_label(): line for ax in figure.axes for line in ax.lines}
    assert [named[name].get_ydata()[-1] for name in RECORDINGS] == pytest.approx(np.rad2deg([0.0, 1.0, -0.5]))
    low, high = figure.axes[0].get_ylim()
    assert low == -high < -np.rad2deg(1.0)


def test_the_map_shows_what_was_seen_and_where_it_looked():
    figure = gaze_figures.plot_gaze_map(RECORDINGS)
    shown = [ax for ax in figure.axes if ax.axison]
    assert [ax.get_title(loc="left").split(":")[0] for ax in shown] == list(RECORDINGS)
    recording = RECORDINGS["fixed"]
    seen = np.unique(np.concatenate([frame.observation.ids for frame in recording.frames]))
    assert f"{len(seen)} landmarks seen" in shown[0].get_title(loc="left")
    looks = next(line for line in shown[0].lines if line.get_label() == "looks").get_xydata()
    assert len(looks) == 3 * 5  # twice a second of 2 s
    ends = looks.reshape(-1, 3, 2)
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 6.0)
    assert np.isnan(ends[:, 2]).all()


def test_claims_and_truth_have_one_scale():
    runs = make_runs((Behaviour("fixed", 0.1), Behaviour("boasts", 0.1, overconfidence=2.0)), range(6), frames=40)
    claimed, true = gaze_figures.plot_claim_and_truth(runs).axes
    assert claimed.get_ylim() == true.get_ylim()
    ends = [{line.get_label(): line.get_ydata()[-1] for line in ax.lines} for ax in (claimed, true)]
    assert ends[0]["fixed"] == pytest.approx(2.0 * ends[0]["boasts"], rel=1e-6)


def test_a_policy_whose_runs_failed_leaves_the_others_their_curves():
    sound, lost = (make_runs((Behaviour(name, 0.1),), range(2), frames=20) for name in ("fixed", "lost"))
    nothing = np.full((20, 3), np.nan)
    lost = [dataclasses.replace(run, positions=nothing, pose_covariances=np.full((20, 6, 6), np.nan)) for run in lost]
    claimed, _ = gaze_figures.plot_claim_and_truth([*sound, *lost]).axes
    assert np.isfinite(claimed.lines[0].get_ydata()).all()


def test_all_of_them_can_be_used_in_the_page():
    runs = make_runs((Behaviour("fixed", 0.1),), range(2), frames=20)
    for figure in (
        gaze_figures.plot_gaze(RECORDINGS),
        gaze_figures.plot_gaze_map(RECORDINGS),
        gaze_figures.plot_claim_and_truth(runs),
    ):
        assert plotly_figure(figure)["data"]
