"""Runs on disk: what goes in comes out, and damage is named (0.5 s)."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from stereo_slam_env.benchmark.storage import run_files
from stereo_slam_env.benchmark.storage.run_files import load_run, packed_run
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.recording.recording import GIVEN_TRUTH, Reference

from ..small_recordings import small_recording


@pytest.fixture(scope="module")
def run():
    recording = replace(small_recording(), truth_from=Reference("odometry", "By hand."))
    return run_filter(recording, "euclidean", {"min_disparity": 5.0}, seed=7, label="xyz")


def same(a, b):
    for f in fields(a):
        x, y = getattr(a, f.name), getattr(b, f.name)
        if isinstance(x, np.ndarray):
            np.testing.assert_array_equal(x, y)
            assert x.dtype == y.dtype
        elif f.name == "counts":
            assert {k: v.tolist() for k, v in x.items()} == {k: v.tolist() for k, v in y.items()}
        elif f.name == "traces":
            for s, t in zip(x, y, strict=True):
                same(s, t)
        elif f.name == "landmark_statistics":
            same(x, y)
        else:
            assert x == y


NOTHING = object()


def stored(path, run, whole=True, about=None, **arrays):
    """The file of a run with other arrays, or other words about it."""
    path.write_bytes(packed_run(run, {}, whole=whole))
    with np.load(path) as archive:
        kept = {name: archive[name] for name in archive.files}
    about = {**json.loads(str(kept["about"])), **(about or {})}
    about = {key: value for key, value in about.items() if value is not NOTHING}
    np.savez(path, **{**kept, **arrays, "about": np.array(json.dumps(about))})
    return path


def test_a_run_comes_back_as_it_was(tmp_path, run):
    (tmp_path / "run.npz").write_bytes(packed_run(run, {"from": "here", "n": 3}))
    loaded = load_run(tmp_path / "run.npz")
    assert loaded.run.final_map is None, "the map at the end is shown and not kept"
    same(replace(run, final_map=None), loaded.run)
    assert loaded.provenance == {"from": "here", "n": 3}


def test_a_run_kept_before_it_said_what_its_truth_is_has_a_true_one(tmp_path, run):
    assert load_run(stored(tmp_path / "run.npz", run)).run.reference.kind == "odometry"
    assert load_run(stored(tmp_path / "old.npz", run, about={"truth_from": NOTHING})).run.reference == GIVEN_TRUTH


@pytest.mark.parametrize("keep", [0, 100, -200])
def test_a_truncated_run_is_named_with_the_remedy(tmp_path, run, keep):
    path = tmp_path / "run.npz"
    path.write_bytes(packed_run(run, {})[:keep])
    with pytest.raises(ValueError, match=r"run\.npz is damaged \(.*\): delete it and run the same command again") as e:
        load_run(path)
    assert "\n" not in str(e.value)


def test_numbers_that_cannot_be_are_damage(tmp_path, run):
    for frames in (2**57, -1, 3.5, None):
        path = stored(tmp_path / "run.npz", run, whole=False, about={"frames": frames, "series": []})
        with pytest.raises(ValueError, match=r"damaged \(frames must be 0 to 10000000, got "):
            load_run(path)
    for count in (2**57, -1):
        path = stored(tmp_path / "run.npz", run, **{"count.used": np.full(len(run), count)})
        with pytest.raises(ValueError, match=r"damaged \(counts must be integers from 0 to 1000000\)"):
            load_run(path)


def test_a_run_of_an_older_format_is_named_with_the_remedy(tmp_path, run, monkeypatch):
    monkeypatch.setattr(run_files, "FORMAT", 1)
    (tmp_path / "run.npz").write_bytes(packed_run(run, {}))
    monkeypatch.undo()
    with pytest.raises(ValueError, match=r"damaged \(format 1, this version reads 4\): delete it and run the same"):
        load_run(tmp_path / "run.npz")


def test_another_archive_is_not_taken_for_a_run(tmp_path):
    np.savez(tmp_path / "x.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match=r"x\.npz is damaged"):
        load_run(tmp_path / "x.npz")
