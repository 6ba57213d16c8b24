"""Scenarios whose measurements come from images: who is given what, what is looked at how often. About 15 s."""

import json
import re
import shutil

import numpy as np
import pytest

from stereo_slam_env import datasets
from stereo_slam_env.benchmark import run_benchmark
from stereo_slam_env.benchmark.recordings import sources
from stereo_slam_env.benchmark.recordings.sources import DatasetSource, StreetSource
from stereo_slam_env.benchmark.running import tasks
from stereo_slam_env.benchmark.running.tasks import watch_search
from stereo_slam_env.benchmark.scenarios.scenario import Scenario, filter_choice
from stereo_slam_env.benchmark.scenarios.streams import (
    check_source,
    make_recording,
    make_sequence,
    stream_digest,
    without_measurements,
)
from stereo_slam_env.benchmark.scenarios.study import Study, preset
from stereo_slam_env.benchmark.storage.result_tables import write_results
from stereo_slam_env.benchmark.storage.store import prepared_study, read_study
from stereo_slam_env.envs import recorder
from stereo_slam_env.envs.recorder import RenderedDrive
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.frontend import track_recorder as recorder_of_tracks
from stereo_slam_env.frontend.rectification_errors import PRIOR_SIGMA
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.rendering.renderers import renderer_identity
from stereo_slam_env.report.benchmark_report import write_report_of
from stereo_slam_env.report.run_report import write_report

from ...datasets.small_image_folders import FRAMES, kitti_odometry

STREET = Scenario(
    "seen",
    StreetSource({"route": "right-turn", "rig": "qvga", "sensor": "images", "max_landmarks": 40}),
    filters=(filter_choice("inverse-depth"), filter_choice("euclidean")),
    frames=4,
)


@pytest.fixture(autouse=True)
def _nothing_kept():
    sources._tracked.cache_clear()
    sources._opened.cache_clear()


@pytest.fixture
def folder(tmp_path):
    kitti_odometry(tmp_path / "kitti")
    return tmp_path / "kitti"


@pytest.fixture
def in_this_process(monkeypatch):
    """Work that would have a process of its own is done here, where it can be watched."""
    monkeypatch.setattr(tasks, "run_isolated", lambda work, **_: work(lambda done, total: None))


def of(folder, **changes):
    filters = (filter_choice("inverse-depth"), filter_choice("euclidean"))
    return Scenario("seen", DatasetSource(str(folder)), filters=filters).replaced(**changes)


def counted(monkeypatch, module, name):
    """Count the calls of a function."""
    calls, function = [], getattr(module, name)

    def count(*args, **kwargs):
        calls.append(args)
        return function(*args, **kwargs)

    monkeypatch.setattr(module, name, count)
    return calls


# --- what a scenario may ask for -------------------------------------------------------------------------------------


def test_scenarios_that_take_images_are_told_apart(folder, tmp_path):
    assert STREET.source.takes_images
    assert of(folder).source.takes_images
    assert not of(tmp_path / "nowhere").source.takes_images
    assert not preset("quick").source.takes_images
    assert not preset("reference-turn").source.takes_images


def test_a_scenario_of_the_simulated_world_can_be_measured_in_images():
    seen = preset("turn").with_sensor("images", "gl")
    assert [seen.source.options[key] for key in ("sensor", "renderer", "route")] == ["images", "gl", "right-turn"]
    assert (seen.noise, seen.gate, seen.consensus) == (None, 0.99, True)
    assert seen.name == "turn-gl-images"
    with pytest.raises(ValueError, match="needs a scenario of kind 'street', this one is of kind 'reference'"):
        preset("reference-turn").with_sensor("images", "tiny")


@pytest.mark.parametrize(
    ("scenario", "complaint"),
    [
        (preset("reference-turn").replaced(search="forecast"), "search 'forecast' needs images: .* has none"),
        (STREET.replaced(noise={"independent_pixels": 1.0}), "each measurement comes with its own covariance"),
        (STREET.replaced(source=STREET.source.replaced(renderer="foo")), "renderer must be one of 'tiny', 'gl'"),
        (STREET.replaced(source=STREET.source.replaced(rout="town")), "did you mean 'route'"),
    ],
    ids=["no images", "noise", "renderer", "option"],
)
def test_what_cannot_be_run_is_refused_before_any_work(scenario, complaint, tmp_path):
    with pytest.raises(ValueError, match=complaint):
        run_benchmark(scenario, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_renderer_that_is_missing_is_wrong_input(missing_gl):
    with pytest.raises(ValueError, match=re.escape(missing_gl)):
        check_source(STREET.replaced(source=STREET.source.replaced(renderer="gl")))


def test_without_images_there_is_no_sequence(tmp_path):
    with pytest.raises(ValueError, match="scenario 'quick' has no images: give sensor='images'"):
        make_sequence(preset("quick"), 0)
    with pytest.raises(ValueError, match="does not exist"):
        make_recording(of(tmp_path / "nowhere"), None)


# --- where the measurements come from --------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_stream_and_another_one_another():
    short = STREET.replaced(frames=2)
    digests = []
    for seed in (3, 3, 4):
        sources._tracked.cache_clear()
        recording = make_recording(short, seed)
        digests.append(stream_digest(recording))
    assert digests[0] == digests[1] != digests[2]
    source = json.loads(json.dumps(recording.source))
    assert (source["renderer"], source["arguments"]["sensor"]) == (renderer_identity("tiny"), "images")


def test_the_images_of_a_scenario_are_those_its_recording_was_made_of():
    """Without a filter, tracks through the sequence are the stream, bit by bit."""
    scenario = STREET.replaced(source=STREET.source.replaced(refill_below=30), frames=3)
    sequence, settings = make_sequence(scenario, 7)
    assert isinstance(sequence, RenderedDrive)
    assert (settings.max_landmarks, settings.refill_below, len(sequence)) == (40, 30, 3)
    recording, found = make_recording(scenario, 7), []
    watch_search(scenario.replaced(seeds=(7,)), lambda pair, tracked: found.append((pair, tracked.observation)))
    for frame, (pair, seen) in zip(recording.frames, found, strict=True):
        assert frame.timestamp == pair.timestamp
        np.testing.assert_array_equal(frame.observation.uvd, seen.uvd)
        np.testing.assert_array_equal(frame.observation.ids, seen.ids)


def test_settings_of_the_front_end_are_options_of_a_recording(folder):
    given = DatasetSource(str(folder), {"front_end": {"max_misses": 1}})
    sequence, settings = make_sequence(of(folder, source=given), None)
    assert len(sequence) == FRAMES
    assert settings == TrackerSettings(max_misses=1, disparity_offset_sigma=PRIOR_SIGMA)  # so few pairs say nothing
    with pytest.raises(ValueError, match="no setting 'max_mises', did you mean 'max_misses'"):
        make_sequence(of(folder, source=DatasetSource(str(folder), {"front_end": {"max_mises": 1}})), None)


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("search", ["flow", "forecast"])
def test_images_are_followed_without_a_filter_once_and_calibrated_once(folder, tmp_path, monkeypatch, search):
    looked = counted(monkeypatch, recorder_of_tracks, "record_tracks")
    opened = counted(monkeypatch, datasets, "open_for_front_end")
    told = []
    make_recording(of(folder, search=search), None, lambda done, of: told.append((done, of)))
    result = run_benchmark(of(folder, search=search), tmp_path / "out", jobs=1)
    assert [r.failure for r in result.runs] == [None, None]
    assert (len(looked), len(opened)) == (1, 1)
    assert told == [(k + 1, FRAMES) for k in range(FRAMES)]


def test_a_long_drive_is_refused_before_it_is_driven(monkeypatch):
    monkeypatch.setattr(recorder.CoreRows, "reset", lambda *_, **__: pytest.fail("it was driven"))
    with pytest.raises(ValueError, match="frames must be at most 80 on route 'right-turn', got 81"):
        make_recording(STREET.replaced(frames=81), 0)


# --- searching as each filter expects --------------------------------------------------------------------------------


@pytest.mark.usefixtures("in_this_process")
def test_a_guided_search_gives_each_filter_measurements_of_its_own(tmp_path, monkeypatch):
    heard = {}

    def listening(recording, name, *args, observe, **options):
        def listen(number, estimator):
            seen = observe(number, estimator)
            heard.setdefault(name, []).append(seen)
            return seen

        return run_filter(recording, name, *args, observe=listen, **options)

    monkeypatch.setattr(tasks, "run_filter", listening)
    result = run_benchmark(STREET.replaced(search="forecast"), tmp_path / "out", jobs=1)
    assert [r.failure for r in result.runs] == [None, None]
    assert [len(seen) for seen in heard.values()] == [4, 4]
    first, second = heard.values()
    np.testing.assert_array_equal(first[0].uvd, second[0].uvd)  # nobody knows anything yet
    assert any(not np.array_equal(a.uvd, b.uvd) for a, b in zip(first[1:], second[1:], strict=True))
    for one in result.runs:
        travelled = np.linalg.norm(np.diff(one.true_positions, axis=0), axis=1).sum()
        assert np.linalg.norm(one.positions[-1] - one.true_positions[-1]) < 0.1 * travelled


def test_landmarks_of_a_guided_search_are_not_judged_by_the_truth_of_other_tracks(tmp_path):
    """Each search numbers its own corners: the same id is another point in the stream without a filter."""
    result = run_benchmark(STREET.replaced(search="forecast", filters=STREET.filters[:1]), tmp_path / "out", jobs=1)
    (guided,) = result.runs
    assert np.isnan(guided.landmark_nees).all()
    assert np.isnan(guided.landmark_rmse).all()
    assert guided.traces == ()
    assert np.isfinite(guided.pose_nees).all()
    settings = result.cells[0].directory.settings()
    write_report(tmp_path, "guided", result.runs, result.summaries, result.figures, settings)


def test_without_measurements_everything_else_of_a_drive_stays(folder):
    recording = make_recording(of(folder), None)
    bare = without_measurements(recording)
    assert bare.landmarks is None
    for one, two in zip(recording.frames, bare.frames, strict=True):
        assert len(two.observation) == 0
        assert (two.timestamp, two.odometry, two.truth) == (one.timestamp, one.odometry, one.truth)


# --- watching --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("search", ["flow", "forecast"])
def test_every_pair_can_be_watched(folder, search):
    seen, told = [], []
    scenario = of(folder, search=search, frames=4)
    watch_search(scenario, lambda pair, tracked: seen.append(tracked), lambda *done: told.append(done))
    assert len(seen) == 4
    assert all(len(tracked.search.ids) > 0 for tracked in seen[1:])
    assert told == [(k + 1, 4) for k in range(4)]


def test_a_search_that_fails_is_not_passed_over(folder):
    def break_down(pair, tracked):
        raise OSError("the disk is full")

    with pytest.raises(ValueError, match="guided by inverse-depth failed: frame 0: OSError: the disk is full"):
        watch_search(of(folder, search="forecast"), break_down)
    with pytest.raises(ValueError, match="has no images"):
        watch_search(preset("quick"), break_down)


# --- keeping results apart -------------------------------------------------------------------------------------------


def test_results_of_another_renderer_are_not_mixed_in(tmp_path):
    prepared_study(tmp_path / "out", Study.of(STREET)).write_settings()
    other = STREET.replaced(name="another", source=STREET.source.replaced(renderer="gl"))
    with pytest.raises(ValueError, match=r'holds a run with options\.renderer = null, now it is "gl": choose another'):
        prepared_study(tmp_path / "out", Study.of(other)).write_settings()


@pytest.mark.usefixtures("in_this_process")
def test_recordings_drawn_by_different_renderers_are_not_compared(tmp_path, monkeypatch):
    """Another version or device of the renderer of the same name draws other pictures, too."""
    short = STREET.replaced(filters=STREET.filters[:1], frames=2)
    run_benchmark(short, tmp_path / "out", jobs=1)
    monkeypatch.setattr(recorder, "renderer_identity", lambda name: {"name": name, "version": "next"})
    with pytest.raises(ValueError, match=r"were drawn by different renderers, .*next.* not to be compared"):
        run_benchmark(short, tmp_path / "out", seeds=(0, 1), jobs=1)


def test_a_finished_run_does_not_need_its_recording_any_more(folder, tmp_path):
    scenario = of(folder, filters=(filter_choice("inverse-depth"),))
    before = run_benchmark(scenario, tmp_path / "out", jobs=1).summaries
    shutil.move(folder, tmp_path / "elsewhere")
    again = read_study(tmp_path / "out")
    results = write_results(again)
    assert results[0].summaries == before
    assert write_report_of(again, results).is_file()
