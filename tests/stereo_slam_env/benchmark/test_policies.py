"""Policies x seeds: paired drives, the same bits again, resumption, failures (15 s)."""

import json
import sqlite3
from contextlib import closing

import numpy as np
import pytest

from stereo_slam_env.benchmark import PolicyChoice, Scenario, campaign, compare, preset, run_benchmark
from stereo_slam_env.benchmark.campaign import check_study
from stereo_slam_env.benchmark.recordings.sources import GazeSource, StreetSource
from stereo_slam_env.benchmark.scenarios.streams import drive_episode, make_recording, stream_digest
from stereo_slam_env.benchmark.scenarios.study import Study, load_study
from stereo_slam_env.benchmark.statistics.policy_verdict import baseline_of
from stereo_slam_env.benchmark.storage.store import read_study
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.policies import available_policies
from stereo_slam_env.recording.archive import load_recording
from stereo_slam_env.report.benchmark_report import write_report_of

from ..third_party import install

SHORT = preset("gaze").replaced(
    source=GazeSource({"route": "right-turn", "rig": "qvga"}),
    seeds=(0, 1),
    frames=8,
    policies=(PolicyChoice("fixed", "fixed"), PolicyChoice("sweep", "sweep", {"period": 2.0})),
)
FIXED, SWEEP = SHORT.competitors

THIRD_PARTY = '''
"""Policies of somebody else."""

import os

from stereo_slam_env.policies.named_policies import FixedGaze


class Raises(FixedGaze):
    frame = 0

    def act(self, observation):
        self.frame += 1
        if self.frame == 3:
            self.give_up()
        return super().act(observation)

    def give_up(self):
        raise RuntimeError("my neck hurts")


class Crashes(Raises):
    def give_up(self):
        os._exit(7)


class Hangs(Raises):
    def give_up(self):
        while True:
            pass
'''


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run_benchmark(SHORT, tmp_path_factory.mktemp("gaze") / "out", jobs=1, write_report=write_report_of)


@pytest.fixture
def third_party(tmp_path, monkeypatch):
    folder = tmp_path / "site"
    folder.mkdir()
    entries = {"raises": "Raises", "crashes": "Crashes", "hangs": "Hangs"}
    install(folder, "somebodys_policies", THIRD_PARTY, entries, "stereo_slam.policies")
    monkeypatch.syspath_prepend(str(folder))


# ---- scenarios ------------------------------------------------------------------------------------------------------


def test_a_scenario_file_with_policies_is_read_and_stored(tmp_path):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\nkind = "gaze"\nseeds = 2\ngate = false\nfilters = ["shared-anchor"]\n'
        'policies = ["fixed", { name = "sweep", label = "slow", options = { period = 9.0 } }]\n'
        '[options]\nroute = "right-turn"\n'
    )
    scenario = load_study(tmp_path / "mine.toml").only_scenario()
    assert scenario.policies == (PolicyChoice("fixed", "fixed"), PolicyChoice("slow", "sweep", {"period": 9.0}))
    again = Scenario.from_dict(json.loads(json.dumps(scenario.as_dict())))
    assert again == scenario
    assert [choice.label for choice in again.competitors] == ["fixed", "slow"]


def test_with_several_filters_a_competitor_has_both_names():
    two = Scenario("two", GazeSource(), filters=SHORT.filters + preset("quick").filters[:1], policies=SHORT.policies)
    names = ["shared-anchor", "inverse-depth"]
    assert [choice.label for choice in two.competitors] == [f"{p}+{f}" for p in ("fixed", "sweep") for f in names]
    assert [choice.name for choice in two.competitors] == names * 2
    with pytest.raises(ValueError, match="every policy drives its own episode"):
        make_recording(SHORT, 0)


def test_the_preset_has_fifty_scenes_and_known_policies():
    scenario = preset("gaze")
    assert len(scenario.seeds) == 50
    assert {choice.name for choice in scenario.policies} <= set(available_policies())
    assert baseline_of(scenario.competitors) == "fixed"
    assert not scenario.has_bound
    check_study(Study.of(scenario))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"policies": (PolicyChoice("swep", "swep"),)}, "did you mean 'sweep'"),
        ({"policies": (PolicyChoice("s", "sweep", {"perod": 1.0}),)}, "did you mean 'period'"),
        ({"source": GazeSource({"environment": "StereoSlam/Drive-v0", "policy": "route"})}, "no head that a policy"),
        ({"source": GazeSource({"environment": "StereoSlam/DriveGaze-v0"})}, "must follow its route"),
        ({"source": GazeSource({"environment": "StereoSlam/Gase-v0"})}, "did you mean 'StereoSlam/Gaze-v0'"),
        ({"source": GazeSource({"rout": "town"})}, "route"),
        ({"frames": 9000}, "frames must be at most 200"),
        ({"search": "forecast"}, "search 'forecast'"),
    ],
)
def test_what_cannot_be_run_is_known_before_any_work(changes, said):
    with pytest.raises(ValueError, match=said):
        check_study(Study.of(preset("gaze").replaced(**changes)))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"source": StreetSource()}, "policies need a scenario of kind 'gaze'"),
        ({"policies": ()}, "must name at least one policy"),
        ({"policies": SHORT.policies * 2}, "different labels"),
        ({"corruptions": ({"kind": "outliers"},)}, "corruptions do not go with"),
    ],
)
def test_what_makes_no_sense_is_no_scenario(changes, said):
    with pytest.raises(ValueError, match=said):
        SHORT.replaced(**changes)


# ---- runs -----------------------------------------------------------------------------------------------------------


def test_every_policy_drives_the_same_drive_and_sees_something_else(finished):
    for seed in (0, 1):
        episodes = [drive_episode(SHORT, seed, choice) for choice in (FIXED, SWEEP)]
        bodies = [[pose.position for pose in episode.drive] for episode in episodes]
        np.testing.assert_array_equal(*bodies)
        assert stream_digest(episodes[0].recording) != stream_digest(episodes[1].recording)
        for choice, episode in zip((FIXED, SWEEP), episodes, strict=True):
            kept = load_recording(finished.cells[0].directory.recording_path(seed, choice))
            assert stream_digest(kept) == stream_digest(episode.recording)
    about = json.loads((finished.out / "summary.json").read_text())["recordings"]
    assert [set(seed["streams"]) for seed in about] == [{"fixed", "sweep"}] * 2
    assert about[0]["drive_sha256"] != about[1]["drive_sha256"]


def test_a_kept_recording_is_a_recording_like_any_other(finished):
    kept = load_recording(finished.cells[0].directory.recording_path(0, SWEEP))
    before = next(one for one in finished.runs if (one.filter_name, one.seed) == ("sweep", 0))
    run_again = run_filter(kept, SWEEP.name, {**SWEEP.options, "gate": None})
    np.testing.assert_array_equal(run_again.positions, before.positions)
    assert run_filter(kept, "inverse-depth").failure is None
    assert kept.source["policy"] == {"label": "sweep", "name": "sweep", "options": {"period": 2.0}}


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, monkeypatch):
    made, run = [], campaign.run_all_trials

    def running(tasks, **how):
        made.extend((task.seed, task.choice.label) for task in tasks)
        return run(tasks, **how)

    monkeypatch.setattr(campaign, "run_all_trials", running)

    def stop_in_the_third_trial(done, total):
        assert total == 4
        if done > 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_benchmark(SHORT, tmp_path / "out", jobs=1, progress=stop_in_the_third_trial)
    made.clear()
    result = run_benchmark(SHORT, tmp_path / "out", policies=[*SHORT.policies, "random"], jobs=1)
    assert made == [(0, "random"), (1, "fixed"), (1, "sweep"), (1, "random")]
    assert [summary.runs for summary in result.summaries] == [2, 2, 2]


@pytest.mark.usefixtures("third_party", "finished")  # after the latter nothing has to be compiled within the limit
def test_policies_that_raise_crash_or_hang_never_take_the_run_down(tmp_path):
    scenario = SHORT.replaced(frame_time_limit=5.0, seeds=(0,))
    result = run_benchmark(scenario, tmp_path / "out", policies=["raises", "crashes", "hangs", "fixed"], jobs=1)
    raising, crashing, hanging, sound = result.summaries
    assert raising.failures == ("seed 0, frame 2: policy: RuntimeError: my neck hurts",)
    assert crashing.failures == ("seed 0, its process ended with code 7",)
    assert hanging.failures == ("seed 0, no sign of life for 5 s",)
    assert (raising.diverged, crashing.diverged, hanging.diverged, sound.diverged) == (1, 1, 1, 0)
    assert all(np.isfinite(one.true_positions).all() for one in result.runs)


def test_a_filter_that_fails_in_the_loop_says_so_itself(tmp_path):
    scenario = SHORT.replaced(seeds=(0,), use_odometry=False)
    result = run_benchmark(scenario, tmp_path / "out", policies=["sweep"], jobs=1)
    failure = result.summaries[0].failures[0]
    assert failure.startswith("seed 0, frame 1: ValueError: odometry must be given")


# ---- what is written ------------------------------------------------------------------------------------------------


def test_the_trial_table_says_who_looked_and_what_was_claimed(finished):
    with closing(sqlite3.connect(finished.out / "trials.sqlite")) as database:
        rows = database.execute(
            "SELECT filter, policy, final_position_sigma_m, final_pose_logdet, end_error_m FROM trials ORDER BY series"
        ).fetchall()
        meanings = dict(database.execute("SELECT name, unit FROM columns").fetchall())
    assert [row[0] for row in rows] == ["fixed", "sweep"] * 2
    assert json.loads(rows[1][1]) == {"label": "sweep", "name": "sweep", "options": {"period": 2.0}}
    last = next(one for one in finished.runs if (one.filter_name, one.seed) == ("fixed", 0))
    assert rows[0][2] == pytest.approx(np.sqrt(np.trace(last.pose_covariances[-1, :3, :3])))
    assert rows[0][3] == pytest.approx(np.log(np.linalg.eigvalsh(last.pose_covariances[-1])).sum())
    assert rows[0][4] == pytest.approx(np.linalg.norm(last.positions[-1] - last.true_positions[-1]))
    assert meanings["final_position_sigma_m"] == "m"


def test_the_page_says_what_is_claimed_and_what_is_true(finished):
    page = finished.report.read_text()
    words = ("2 policies on identical drives", "2 paired runs are too few", "figure-gaze_map", "figure-claim_and_truth")
    assert [said for said in words if said not in page] == []
    truths = {path.name for path in (finished.out / "trajectories" / "seed-0000").glob("*-truth.tum")}
    assert truths == {"fixed-truth.tum", "sweep-truth.tum"}


def test_two_runs_are_compared_drive_by_drive(finished, tmp_path):
    other = run_benchmark(SHORT, tmp_path / "other", policies=[PolicyChoice("sweep", "sweep", {"period": 4.0})], jobs=1)
    comparison = compare(finished.out, other.out)
    assert comparison.paired
    assert comparison.filters_before == ("fixed",)
    assert any("the options of sweep" in warning for warning in comparison.warnings)


def test_drives_that_are_not_the_same_are_refused(finished, tmp_path):
    directory = read_study(finished.out).cells[0]
    assert len(directory.load()[1]) == 2
    other = SHORT.replaced(source=SHORT.source.replaced(perturbation=0.0))
    run_benchmark(other, tmp_path / "other", jobs=1, seeds=[0])
    foreign = read_study(tmp_path / "other").cells[0].trial_path(0, SWEEP)
    kept = directory.trial_path(0, SWEEP)
    content = kept.read_bytes()
    try:
        kept.write_bytes(foreign.read_bytes())
        with pytest.raises(ValueError, match="were not given the same recording"):
            directory.load()
    finally:
        kept.write_bytes(content)
