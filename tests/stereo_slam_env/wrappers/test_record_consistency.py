"""Is the filter in the loop as sure as it is right (2 s)."""

import numpy as np
import pytest

from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.wrappers import BeliefObservation, RecordConsistency

from ..benchmark.small_recordings import small_recording
from .replayed import ReplayEnv, episode


def judged(recording=None, loop=None, **arguments):
    env = RecordConsistency(BeliefObservation(ReplayEnv(recording), **(loop or {})), **arguments)
    return env, episode(env)[2]


@pytest.mark.parametrize("name", ["shared-anchor", "right-invariant"])
def test_it_says_what_the_benchmark_says(name):
    recording = small_recording(frames=20)
    run = run_filter(recording, name)
    _, infos = judged(recording, {"filter": name})
    for part in ("position", "rotation", "pose"):
        told = [info[f"consistency_nees_{part}"] for info in infos]
        np.testing.assert_allclose(told, getattr(run, f"{part}_nees"), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose([info["consistency_nis"] for info in infos], run.nis, rtol=1e-9)
    assert [info["consistency_nis_dof"] for info in infos] == run.nis_dof.tolist()


@pytest.mark.parametrize("window", [None, 1, 4])
def test_running_means_with_their_band(window):
    _, infos = judged(window=window)
    assert [infos[0][f"consistency_{key}"] for key in ("anees", "low", "high", "nis_ratio")] == [0.0] * 4
    nees = [info["consistency_nees_pose"] for info in infos]
    nis, dof = ([info[f"consistency_{key}"] for info in infos] for key in ("nis", "nis_dof"))
    for k, info in enumerate(infos[1:], start=1):
        recent = slice(1 if window is None else max(1, k + 1 - window), k + 1)
        assert info["consistency_anees"] == pytest.approx(np.mean(nees[recent]))
        assert (info["consistency_low"], info["consistency_high"]) == mean_band(6, len(nees[recent]))
        assert info["consistency_nis_ratio"] == pytest.approx(np.sum(nis[recent]) / np.sum(dof[recent]))


def test_every_episode_leaves_a_summary():
    env = RecordConsistency(BeliefObservation(ReplayEnv()), window=2, buffer_length=2)
    for count in (1, 2, 2):
        infos = episode(env)[2]
        assert len(env.episodes) == count
    last = env.episodes[-1]
    assert last.steps == len(infos) - 1
    assert last.anees_pose == pytest.approx(np.mean([info["consistency_nees_pose"] for info in infos[1:]]))
    assert last.anees_position == pytest.approx(np.mean([info["consistency_nees_position"] for info in infos[1:]]))
    assert last.pose_band == mean_band(6, last.steps)
    episode(env, steps=3)
    env.reset()
    assert env.episodes[-1] is last  # an episode that was broken off is none


def test_an_over_confident_filter_is_found_out():
    honest, _ = judged(small_recording(frames=25), {"noise": 1.0, "options": {"gate": None}})
    too_sure, _ = judged(small_recording(frames=25), {"noise": 1 / 3, "options": {"gate": None}})
    assert honest.episodes[-1].anees_pose < 12 < too_sure.episodes[-1].anees_pose
    assert honest.episodes[-1].nis_ratio < 1.3 < 4 < too_sure.episodes[-1].nis_ratio


def test_observation_and_reward_are_left_alone():
    inner = BeliefObservation(ReplayEnv())
    seen, rewards, _ = episode(RecordConsistency(inner), steps=4)
    assert rewards[1:] == (1.0,) * 4
    assert seen[-1].keys() == inner.observation_space.spaces.keys()


def test_the_keys_of_info_are_always_the_same_scalars():
    _, infos = judged()
    kinds = [{key: type(value) for key, value in info.items() if key.startswith("consistency_")} for info in infos]
    assert all(kind == kinds[0] for kind in kinds)
    assert set(kinds[0].values()) == {np.float64, np.int64}


def test_arguments_are_checked_when_it_is_made():
    with pytest.raises(ValueError, match="window must be a whole number >= 1, got 0"):
        RecordConsistency(BeliefObservation(ReplayEnv()), window=0)
    with pytest.raises(ValueError, match="RecordConsistency needs 'slam'"):
        RecordConsistency(ReplayEnv())
