"""Figures of where policies look, from a made-up recording (2 s)."""

import dataclasses

import numpy as np
import pytest

from stereo_slam_env.policies.ppo import merit
from stereo_slam_env.report.charts.policies import plot_claim_and_truth, plot_gaze, plot_gaze_map, plot_learning

from ....synthetic_runs import Behaviour, make_runs
from ...benchmark.small_recordings import small_recording
from .reading import panels, series_of, values


def looking(pan):
    recording = small_recording(0, frames=21)
    frames = tuple(
        dataclasses.replace(frame, head=np.array([pan * k / 20, 0.1])) for k, frame in enumerate(recording.frames)
    )
    return dataclasses.replace(recording, frames=frames)


RECORDINGS = {"fixed": looking(0.0), "sweep": looking(1.0), "random": looking(-0.5)}


def test_every_policy_has_its_pan_in_degrees():
    shown = panels(plot_gaze(RECORDINGS))
    ends = [values(panel.curves()[name])[-1] for panel, name in zip(shown, RECORDINGS, strict=True)]
    assert ends == pytest.approx(np.rad2deg([0.0, 1.0, -0.5]), rel=1e-4)
    low, high = shown[0].y
    assert low == -high < -np.rad2deg(1.0)


def test_the_map_shows_what_was_seen_and_where_it_looked():
    chart = plot_gaze_map(RECORDINGS)
    shown = panels(chart)
    assert [panel.title.split(":")[0] for panel in shown] == list(RECORDINGS) == list(series_of(chart))
    recording = RECORDINGS["fixed"]
    seen = np.unique(np.concatenate([frame.observation.ids for frame in recording.frames]))
    assert f"{len(seen)} landmarks seen" in shown[0].title
    looks, path = shown[0].rows("lines")
    ends = np.stack([values(looks, "x"), values(looks)], axis=1).reshape(-1, 3, 2)
    assert len(ends) == 5  # twice a second of 2 s
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 6.0, rtol=1e-3)
    assert np.isnan(ends[:, 2]).all()
    assert len(path["x"]) == len(recording.frames)


def test_a_map_has_equal_scales():
    panel = panels(plot_gaze_map(RECORDINGS))[0]
    assert np.ptp(panel.x) / panel.size[0] == pytest.approx(np.ptp(panel.y) / panel.size[1], rel=0.01)


def test_claims_and_truth_have_one_scale():
    runs = make_runs((Behaviour("fixed", 0.1), Behaviour("boasts", 0.1, overconfidence=2.0)), range(6), frames=40)
    claimed, true = panels(plot_claim_and_truth(runs))
    assert claimed.y == true.y
    ends = {name: values(row)[-1] for name, row in claimed.curves().items()}
    assert ends["fixed"] == pytest.approx(2.0 * ends["boasts"], rel=1e-3)


def test_a_policy_whose_runs_failed_leaves_the_others_their_curves():
    sound, lost = (make_runs((Behaviour(name, 0.1),), range(2), frames=20) for name in ("fixed", "lost"))
    nothing = np.full((20, 3), np.nan)
    lost = [dataclasses.replace(run, positions=nothing, pose_covariances=np.full((20, 6, 6), np.nan)) for run in lost]
    claimed, _ = panels(plot_claim_and_truth([*sound, *lost]))
    assert np.isfinite(values(claimed.curves()["fixed"])).all()


def test_a_learning_curve_marks_what_is_kept_and_what_it_is_held_against():
    values_of = {"final_position_sigma_m": 2.0, "position_rmse_m": 1.0}
    errors = enumerate((1.0, 0.5, 0.7))
    rows = [{"decisions": 1000.0 * k, "final_position_error_m": found, **values_of} for k, found in errors]
    for panel in panels(plot_learning([rows], {"final_position_sigma_m": 1.0, "position_rmse_m": 2.0}, merit)):
        assert values(panel.curves("dots")["learnt"], "x").tolist() == [1.0]
        assert {"kept", "straight ahead"} <= set(panel.words())


def test_a_learning_curve_of_returns_has_one_panel_and_what_idle_agents_get():
    rows = [{"decisions": 1000.0 * k, "validation_return": found} for k, found in enumerate((-9.0, 4.0, 3.0))]
    (panel,) = panels(plot_learning([rows], {"validation_return": -8.0}, merit))
    assert values(panel.curves("dots")["learnt"], "x").tolist() == [1.0]
    assert {"kept", "action 0"} <= set(panel.words())
