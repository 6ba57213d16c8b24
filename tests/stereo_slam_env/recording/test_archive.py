"""Recordings in one file: what goes in comes out, bit for bit, and damage is named (1 s)."""

import dataclasses
import json
import re
import time

import numpy as np
import pytest

from filters import BodyVelocity, InertialSamples, InertialUnit, Start, StereoNoise, StereoObservation
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.benchmark.scenarios.streams import stream_digest
from stereo_slam_env.datasets import load
from stereo_slam_env.recording.archive import load_recording, save_recording
from stereo_slam_env.recording.body_truth import BodyTruth
from stereo_slam_env.recording.recording import GIVEN_TRUTH, SIMULATION, Recording, Reference

from ..benchmark.small_recordings import small_recording


def with_everything() -> Recording:
    """Frames with and without each thing that a frame can have, one of them without any landmark."""
    recording = small_recording(3, 6)
    frames = list(recording.frames)
    rng = np.random.default_rng(0)
    for k in (1, 4):
        seen = frames[k].observation
        root = rng.standard_normal((len(seen), 3, 3))
        R = root @ root.transpose(0, 2, 1) + np.eye(3)
        changed = StereoObservation(seen.ids[::-1], seen.uvd, rng.uniform(0, 100, len(seen)), R)
        frames[k] = dataclasses.replace(frames[k], observation=changed, odometry=None)
    nothing = StereoObservation([], np.zeros((0, 3)), [], np.zeros((0, 3, 3)))
    frames[2] = dataclasses.replace(frames[2], observation=nothing, truth=None, truth_velocity=None)
    for k in (0, 3):
        frames[k] = dataclasses.replace(frames[k], head=rng.standard_normal(2))
    for k in (0, 2, 3):  # two moving bodies, of one measurement each, and none
        kinds, count = ("car", "bus")[:k], len(frames[k].observation)
        orientations = np.tile([0.6, 0.0, -0.8, 0.0], (len(kinds), 1))
        poses = rng.standard_normal((len(kinds), 3)), orientations, *rng.standard_normal((2, len(kinds), 3))
        labels = np.full(count, -1)
        labels[: len(kinds)] = [4, 7][: min(len(kinds), count)]
        truth = BodyTruth(np.array([4, 7])[: len(kinds)], kinds, *poses, labels)
        frames[k] = dataclasses.replace(frames[k], bodies=truth)
    for k in (1, 2, 5):
        orientation = rng.standard_normal(4)
        unit = InertialUnit(rng.standard_normal(3), orientation / np.linalg.norm(orientation), *rng.uniform(0, 1, 4))
        times = np.cumsum(rng.uniform(0.01, 0.02, k + 1))
        frames[k] = dataclasses.replace(
            frames[k], inertial=InertialSamples(times, *rng.standard_normal((2, k + 1, 3)), unit)
        )
    return dataclasses.replace(
        recording,
        frames=tuple(frames),
        noise=StereoNoise.diagonal(1.0, 2.0, 3.0),
        source={"deep": [{"er": None}], "x": 0.1},
        truth_from=Reference("odometry", "By hand."),
    )


def leaves(value, name="recording"):
    """Every array and scalar of a recording, with its path."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from leaves(getattr(value, field.name), f"{name}.{field.name}")
    elif isinstance(value, tuple):
        for k, entry in enumerate(value):
            yield from leaves(entry, f"{name}[{k}]")
    elif isinstance(value, np.ndarray):
        yield name, (value.dtype.str, value.shape, value.tobytes())
    else:
        yield name, value


@pytest.mark.parametrize(
    "recording",
    [
        with_everything(),
        small_recording(truth=False, odometry=False),
        dataclasses.replace(small_recording(), frames=(), start=Start()),
        long_drive(0, frames=10),
    ],
    ids=["everything", "bare", "no-frames", "right-rows"],
)
def test_a_recording_comes_back_bit_for_bit(tmp_path, recording):
    save_recording(tmp_path / "deep" / "drive.npz", recording)
    loaded = load_recording(tmp_path / "deep" / "drive.npz")
    assert dict(leaves(loaded)) == dict(leaves(recording))
    assert stream_digest(loaded) == stream_digest(recording)


def test_a_recording_whose_samples_would_be_lost_is_not_saved(tmp_path):
    class Accelerations(BodyVelocity):
        """With more in it."""

    recording = small_recording()
    odd = dataclasses.replace(recording.frames[1], odometry=Accelerations(np.zeros(3), np.zeros(3), np.eye(6)))
    frames = (recording.frames[0], odd, *recording.frames[2:])
    with pytest.raises(ValueError, match=r"^frame 1 has a Accelerations, not a BodyVelocity itself: what it adds"):
        save_recording(tmp_path / "drive.npz", dataclasses.replace(recording, frames=frames))
    assert not (tmp_path / "drive.npz").exists()


def test_a_file_is_read_like_any_recording(tmp_path):
    """The noise of a simulation is what it says; of other tracks it is measured."""
    path, drive = tmp_path / "drive.npz", dataclasses.replace(small_recording(), truth_from=SIMULATION)
    save_recording(path, drive)
    assert stream_digest(load(str(path))) == stream_digest(drive)
    with pytest.raises(ValueError, match="a recording in one file has no option 'sigma_px'"):
        load(path, sigma_px=2.0)


def test_a_long_drive_is_written_and_read_in_a_moment(tmp_path):
    short = long_drive(0, frames=100)
    frames = tuple(
        dataclasses.replace(frame, timestamp=80.0 * i + frame.timestamp) for i in range(8) for frame in short.frames
    )
    began = time.process_time()
    save_recording(tmp_path / "drive.npz", dataclasses.replace(short, frames=frames))
    assert len(load_recording(tmp_path / "drive.npz")) == 800
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize("keep", [0, 100, -200])
def test_a_truncated_file_is_named_with_the_remedy(tmp_path, keep):
    path = tmp_path / "drive.npz"
    save_recording(path, small_recording())
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"\A.*drive\.npz is damaged \(.*\): copy or record it again.*\Z"):
        load_recording(path)
    with pytest.raises(ValueError, match="does not exist"):
        load_recording(tmp_path / "nowhere.npz")


def changed(path, **arrays):
    with np.load(path) as archive:
        kept = {name: archive[name] for name in archive.files}
    if "truth_from" in arrays:
        kept["about"] = np.array(json.dumps(json.loads(str(kept["about"])) | {"truth_from": arrays.pop("truth_from")}))
    np.savez(path, **{name: value for name, value in (kept | arrays).items() if value is not None})


@pytest.mark.parametrize(
    ("arrays", "complaint"),
    [
        ({"uvd": None}, r"damaged \(lacks 'uvd'\)"),
        ({"uvd": np.zeros((3, 3))}, r"damaged \(array uvd has shape \(3, 3\), expected"),
        ({"truth.position": np.zeros((1, 3))}, r"damaged \(array truth\.position has shape"),
        ({"ids": np.zeros(3)}, r"damaged \(array ids has shape"),
        ({"about": None}, "is not a recording"),
        ({"about": np.array("{")}, "is not a recording"),
        ({"about": np.array('{"format": 9}')}, "is a recording of format 9, this version reads 1"),
        ({"about": np.array('{"format": 1, "name": "x"}')}, r"damaged \(lacks 'camera'\)"),
        ({"truth_from": {"kind": "hearsay", "description": ""}}, r"damaged \(kind of a reference must be one of"),
        ({"truth_from": "GPS"}, "is damaged"),
    ],
)
def test_what_does_not_fit_together_is_named(tmp_path, arrays, complaint):
    path = tmp_path / "drive.npz"
    save_recording(path, small_recording())
    changed(path, **arrays)
    with pytest.raises(ValueError, match=rf"\A.*{complaint}.*\Z"):
        load_recording(path)


def test_what_cannot_be_kept_is_refused_before_anything_is_written(tmp_path):
    recording = dataclasses.replace(small_recording(), source={"when": object()})
    with pytest.raises(ValueError, match=r"recording\.source must consist of JSON values"):
        save_recording(tmp_path / "drive.npz", recording)
    with pytest.raises(ValueError, match=r"must end in \.npz"):
        save_recording(tmp_path / "drive.dat", small_recording())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("kind", "description", "now"),
    [
        ("independent truth", SIMULATION.description, SIMULATION),
        ("independent truth", "Motion capture; no camera has a part in it.", GIVEN_TRUTH),
        ("odometry from the same images", "By hand.", Reference("odometry", "By hand.")),
    ],
)
def test_recordings_made_before_kinds_had_short_names_are_read_and_not_believed(tmp_path, kind, description, now):
    """What an earlier reader guessed of a layout is not taken over."""
    path = tmp_path / "drive.npz"
    save_recording(path, small_recording())
    changed(path, truth_from={"kind": kind, "description": description})
    assert load_recording(path).truth_from == now


def test_recordings_made_before_there_were_samples_heads_and_references_have_none(tmp_path):
    path, made = tmp_path / "drive.npz", with_everything()
    save_recording(path, made)
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in stored.files if not re.search("inertial|head|bodies", name)}
    about = json.loads(str(arrays["about"]))
    del about["truth_from"]
    np.savez(path, **arrays | {"about": np.array(json.dumps(about))})
    old = load_recording(path)
    assert old.reference == GIVEN_TRUTH
    bare = tuple(dataclasses.replace(frame, inertial=None, head=None, bodies=None) for frame in made.frames)
    assert dict(leaves(old.frames)) == dict(leaves(bare))


def test_without_a_true_pose_there_is_no_reference_whatever_the_source_says():
    recording = with_everything()
    assert recording.reference.kind == "odometry"
    assert dataclasses.replace(recording, frames=recording.frames[2:3]).reference.kind == "none"
    assert small_recording(truth=False).reference.kind == "none"
