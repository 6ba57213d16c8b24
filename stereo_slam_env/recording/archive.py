"""A `Recording` as one npz file and back, bit for bit, without pickles.

What all frames have lies end to end in flat arrays. What a frame may lack (rows of the right image, covariances,
odometry, inertial samples, truth, moving bodies) is kept for the frames that have it, and `has.*` says which those are.
`about` is JSON: format version, name, camera, noise that lasts, source, and what the truth is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters import (
    BodyVelocity,
    ColouredNoise,
    InertialSamples,
    InertialUnit,
    Pose,
    Start,
    StereoCamera,
    StereoNoise,
    StereoObservation,
)
from filters.contract.inputs import FASTEST, LARGEST_SPEED_VARIANCE
from filters.contract.validation import at_most, covariance_matrix, first_line, unchecked
from filters.geometry.arrays import FloatArray
from stereo_slam_env.files.folders import write_atomically
from stereo_slam_env.files.opening import NotOpened
from stereo_slam_env.files.record_files import DAMAGE, Arrays, NoRecord, OtherFormat, packed, unpacked
from stereo_slam_env.recording.body_truth import BODY_COLUMNS, BODY_KINDS, BodyTruth
from stereo_slam_env.recording.filter_setup import FilterSetup
from stereo_slam_env.recording.recording import (
    GIVEN_TRUTH,
    SIMULATION,
    Frame,
    LandmarkTruth,
    Recording,
    Reference,
    Velocity,
)

FORMAT = 1
_PARTS: Mapping[str, tuple[type, Mapping[str, tuple[int, ...]]]] = {
    "odometry": (BodyVelocity, {"linear": (3,), "angular": (3,), "covariance": (6, 6)}),
    "truth": (Pose, {"position": (3,), "orientation": (4,)}),
    "truth_velocity": (Velocity, {"linear": (3,), "angular": (3,)}),
}
"""What a frame may have besides its observation: its type, and the shapes of its arrays."""
_UNIT_OF_SAMPLES: Mapping[str, tuple[int, ...]] = {"position": (3,), "orientation": (4,)} | dict.fromkeys(
    ("gyro_density", "accelerometer_density", "gyro_walk", "accelerometer_walk"), ()
)
_SAMPLES: Mapping[str, tuple[int, ...]] = {"times": (), "angular_rates": (3,), "specific_forces": (3,)}
_START = {"position": (3,), "orientation": (4,), "linear_velocity": (3,), "angular_velocity": (3,)}

_KINDS = {"numbers": "fiu", "integers": "iu", "truth values": "b"}
_MOST, _MOST_SQUARE, _MOST_PIXELS, _UNIT = 1e12, 1e24, 100_000, 1e-6
"""Largest number (m, px, s), (co)variance, and image that a recording can hold; how far from 1 a unit may be."""


def save_recording(path: str | Path, recording: Recording) -> None:
    """Write a recording; the file appears complete or not at all.

    Parameters
    ----------
    path : str or Path
        The npz file; its folder is made.
    recording : Recording
        What to keep.

    Raises
    ------
    ValueError
        `path` does not end in .npz, the source of the recording is not JSON-able, or its odometry or samples are of a
        subclass, whose additions would be lost.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"path of a recording must end in .npz, got {path}")
    content = packed_recording(recording)
    write_atomically(path, lambda stream: stream.write(content))


def packed_recording(recording: Recording) -> bytes:
    """Bytes that `save_recording` writes; raises as that."""
    for k, frame in enumerate(recording.frames):
        for entry, kind in ((frame.odometry, BodyVelocity), (frame.inertial, InertialSamples)):
            if entry is not None and type(entry) is not kind:
                raise ValueError(
                    f"frame {k} has a {type(entry).__name__}, not a {kind.__name__} itself: what it adds would be lost"
                )
    about = {
        "name": recording.name,
        "camera": {name: _plain(value) for name, value in dataclasses.asdict(recording.camera).items()},
        "source": dict(recording.source),
        "truth_from": dataclasses.asdict(recording.truth_from),
        **({"coloured_noise": recording.noise.parts} if isinstance(recording.noise, ColouredNoise) else {}),
    }
    if recording.stated_setup is not None:
        about["filter_setup"] = recording.stated_setup.as_dict()
    arrays = _arrays_of(recording)
    try:
        return packed(FORMAT, about, arrays)
    except (TypeError, ValueError) as error:
        raise ValueError(f"recording.source must consist of JSON values: {error}") from error


def unpacked_recording(content: bytes) -> Recording:
    """The recording of `packed_recording`; raises as `load_recording`."""
    return _read(content, "the recording")


def load_recording(path: str | Path) -> Recording:
    """Read what `save_recording` wrote.

    Parameters
    ----------
    path : str or Path
        The npz file.

    Returns
    -------
    Recording
        Bit for bit the one that was saved; tuples in `source` have become lists.

    Raises
    ------
    ValueError
        The file is missing, damaged, no recording, or of a format that this version does not know: one line.
    """
    return _read(path, path)


def _read(source: str | Path | bytes, path: str | Path) -> Recording:
    try:
        return _recording_of(*unpacked(source, FORMAT))
    except FileNotFoundError as error:
        raise ValueError(f"{path} does not exist: give a recording made by save_recording") from error
    except NotOpened:
        raise
    except NoRecord as error:
        raise ValueError(f"{path} is not a recording: give a file made by save_recording") from error
    except OtherFormat as error:
        raise ValueError(f"{path} is a recording of {error}: record it again") from error
    except DAMAGE as error:
        reason = f"lacks {first_line(error)}" if isinstance(error, KeyError) else first_line(error)
        raise ValueError(f"{path} is damaged ({reason}): copy or record it again") from error


def _arrays_of(recording: Recording) -> Arrays:
    frames = recording.frames
    observations = [frame.observation for frame in frames]
    arrays: Arrays = {
        "noise": recording.noise.R,
        "timestamps": np.array([frame.timestamp for frame in frames], dtype=np.float64),
        "counts": np.array([len(observation) for observation in observations], dtype=np.int64),
        "ids": _joined((observation.ids for observation in observations), (), np.int64),
        "uvd": _joined((observation.uvd for observation in observations), (3,)),
        **_some("v_right", [observation.v_right for observation in observations], ()),
        **_some("R", [observation.R for observation in observations], (3, 3)),
    }
    for part, (_, shapes) in _PARTS.items():
        present = [getattr(frame, part) for frame in frames]
        arrays[f"has.{part}"] = np.array([entry is not None for entry in present], dtype=np.bool_)
        for name, shape in shapes.items():
            stacked = (getattr(entry, name)[None] for entry in present if entry is not None)
            arrays[f"{part}.{name}"] = _joined(stacked, shape)
    arrays["has.head"] = np.array([frame.head is not None for frame in frames], dtype=np.bool_)
    arrays["head"] = _joined((frame.head[None] for frame in frames if frame.head is not None), (2,))
    arrays |= _inertial_arrays([frame.inertial for frame in frames])
    arrays |= _body_arrays([frame.bodies for frame in frames])
    arrays |= {f"start.{name}": np.asarray(getattr(recording.start, name)) for name in _START}
    if recording.start.covariance is not None:
        arrays["start.covariance"] = np.asarray(recording.start.covariance)
    if recording.landmarks is not None:
        arrays |= {"landmarks.ids": recording.landmarks.ids, "landmarks.positions": recording.landmarks.positions}
    return arrays


def _recording_of(about: Mapping[str, Any], arrays: Arrays) -> Recording:
    timestamps = _shaped(arrays, "timestamps", (-1,))
    if (np.diff(timestamps) <= 0).any():
        k = int(np.flatnonzero(np.diff(timestamps) <= 0)[0]) + 1
        raise ValueError(f"array timestamps must ascend, and does not in frame {k}")
    counts = _shaped(arrays, "counts", (len(timestamps),), "integers")
    if (counts < 0).any():
        raise ValueError("array counts must be >= 0")
    ends = np.cumsum(counts)
    total = int(counts.sum())
    ids = _shaped(arrays, "ids", (total,), "integers")
    uvd = _shaped(arrays, "uvd", (total, 3))
    v_right = _parts(arrays, "v_right", (), counts)
    R = _parts(arrays, "R", (3, 3), counts)
    optional_entries = {part: _entries(arrays, part, len(timestamps)) for part in _PARTS}
    optional_entries["head"] = _heads(arrays, len(timestamps))
    optional_entries["inertial"] = _inertial_entries(arrays, len(timestamps))
    optional_entries["bodies"] = _body_entries(arrays, counts)
    frames = []
    for k, (begin, end) in enumerate(zip((ends - counts).tolist(), ends.tolist(), strict=True)):
        observation = StereoObservation(ids[begin:end], uvd[begin:end], v_right[k], R[k])
        others_of_frame = {part: entries[k] for part, entries in optional_entries.items()}
        frames.append(Frame(float(timestamps[k]), observation, **others_of_frame))
    start = {name: _shaped(arrays, f"start.{name}", shape) for name, shape in _START.items()}
    covariance = _shaped(arrays, "start.covariance", (12, 12)) if "start.covariance" in arrays else None
    landmarks = None
    if "landmarks.ids" in arrays:
        landmark_ids = _shaped(arrays, "landmarks.ids", (-1,), "integers")
        landmarks = LandmarkTruth(landmark_ids, _shaped(arrays, "landmarks.positions", (len(landmark_ids), 3)))
    parts, noise = about.get("coloured_noise"), _shaped(arrays, "noise", (3, 3))
    return Recording(
        str(about["name"]),
        _camera(about["camera"]),
        tuple(frames),
        StereoNoise(noise) if parts is None else ColouredNoise(noise, **parts),
        Start(**start, covariance=covariance),
        landmarks,
        about["source"],
        reference_of(about),
        FilterSetup(**about["filter_setup"]) if "filter_setup" in about else None,
    )


def reference_of(about: Mapping[str, Any]) -> Reference:
    """Kind of the truth by the header of a file; files of earlier versions do not say, or say less."""
    if "truth_from" not in about:
        return GIVEN_TRUTH
    stated = dict(about["truth_from"])
    if stated["kind"] == "independent truth":  # which was also said of what a reader only guessed
        simulated = stated["description"] == SIMULATION.description
        stated |= {"kind": "simulation"} if simulated else dataclasses.asdict(GIVEN_TRUTH)
    elif stated["kind"] == "odometry from the same images":
        stated["kind"] = "odometry"
    return Reference(**stated)


def _joined(parts: Iterable[NDArray[Any]], shape: tuple[int, ...], dtype: type = np.float64) -> NDArray[Any]:
    return np.concatenate([np.zeros((0, *shape), dtype=dtype), *parts])


def _some(name: str, parts: Sequence[FloatArray | None], shape: tuple[int, ...]) -> Arrays:
    """The parts that are there, end to end, and which those are."""
    has = np.array([part is not None for part in parts], dtype=np.bool_)
    return {f"has.{name}": has, name: _joined((part for part in parts if part is not None), shape)}


def _parts(arrays: Arrays, name: str, shape: tuple[int, ...], counts: NDArray[Any]) -> list[NDArray[Any] | None]:
    """The part of each frame, or None."""
    has = _has(arrays, name, len(counts))
    lengths = np.where(has, counts, 0)
    joined = _shaped(arrays, name, (int(lengths.sum()), *shape))
    parts = np.split(joined, np.cumsum(lengths)[:-1])
    return [part if is_present else None for part, is_present in zip(parts, has, strict=True)] if len(has) else []


def _entries(arrays: Arrays, part: str, frames: int) -> list[Any]:
    """The pose or velocity of each frame, or None."""
    entry_type, shapes = _PARTS[part]
    has = _has(arrays, part, frames)
    columns = [_shaped(arrays, f"{part}.{name}", (int(has.sum()), *shape)) for name, shape in shapes.items()]
    if entry_type is BodyVelocity:
        present: Iterator[Any] = _odometry(*columns)
    else:
        present = (entry_type(**dict(zip(shapes, row, strict=True))) for row in zip(*columns, strict=True))
    return [next(present) if is_present else None for is_present in has]


def _odometry(linear: FloatArray, angular: FloatArray, covariance: FloatArray) -> Iterator[BodyVelocity]:
    """Odometry of each row; all are checked at once, which takes a tenth of the time."""
    covariance = covariance_matrix("odometry.covariance", covariance, 6, batch=len(covariance))
    at_most("odometry.linear", linear, FASTEST, "m/s")
    at_most("odometry.angular", angular, FASTEST, "rad/s")
    at_most("odometry.covariance", covariance, LARGEST_SPEED_VARIANCE, "m^2/s^2 or rad^2/s^2")
    for v, w, P in zip(linear, angular, covariance, strict=True):
        yield unchecked(BodyVelocity, linear=v, angular=w, covariance=P)


def _heads(arrays: Arrays, frames: int) -> list[FloatArray | None]:
    """Pan and tilt of each frame, or None; recordings made before there were heads have none."""
    if "has.head" not in arrays:
        return [None] * frames
    has = _has(arrays, "head", frames)
    angles = iter(_shaped(arrays, "head", (int(has.sum()), 2)))
    return [next(angles) if is_present else None for is_present in has]


def _inertial_arrays(samples: Sequence[InertialSamples | None]) -> Arrays:
    """Samples end to end, how many each frame has, and the unit of each frame that has some."""
    present = [entry for entry in samples if entry is not None]
    arrays = {
        "has.inertial": np.array([entry is not None for entry in samples], dtype=np.bool_),
        "inertial.counts": np.array([len(entry.times) for entry in present], dtype=np.int64),
    }
    for name, shape in _SAMPLES.items():
        arrays[f"inertial.{name}"] = _joined((getattr(entry, name) for entry in present), shape)
    for name, shape in _UNIT_OF_SAMPLES.items():
        units = (np.asarray(getattr(entry.unit, name))[None] for entry in present)
        arrays[f"inertial.unit.{name}"] = _joined(units, shape)
    return arrays


def _inertial_entries(arrays: Arrays, frames: int) -> list[InertialSamples | None]:
    """Samples of each frame, or None; recordings made before there were any have none."""
    if "has.inertial" not in arrays:
        return [None] * frames
    has = _has(arrays, "inertial", frames)
    counts = _shaped(arrays, "inertial.counts", (int(has.sum()),), "integers")
    if (counts < 1).any():
        raise ValueError("array inertial.counts must be >= 1")
    ends, total = np.cumsum(counts), int(counts.sum())
    times, rates, forces = (_shaped(arrays, f"inertial.{name}", (total, *s)) for name, s in _SAMPLES.items())
    units = [_shaped(arrays, f"inertial.unit.{name}", (len(counts), *s)) for name, s in _UNIT_OF_SAMPLES.items()]
    steps: list[InertialSamples | None] = [None] * frames
    for entry, k in enumerate(np.flatnonzero(has).tolist()):
        mine = slice(int(ends[entry] - counts[entry]), int(ends[entry]))
        unit = InertialUnit(*(numbers[entry] for numbers in units))
        steps[k] = InertialSamples(times[mine], rates[mine], forces[mine], unit)
    return steps


def _body_arrays(truths: Sequence[BodyTruth | None]) -> Arrays:
    """Moving bodies end to end, how many each frame has, and the body of each measurement; nothing without any."""
    present = [truth for truth in truths if truth is not None]
    if not present:
        return {}
    return {
        "has.bodies": np.array([truth is not None for truth in truths], dtype=np.bool_),
        "bodies.counts": np.array([len(truth.ids) for truth in present], dtype=np.int64),
        "bodies.ids": _joined((truth.ids for truth in present), (), np.int64),
        "bodies.kinds": _joined((truth.codes for truth in present), (), np.int64),
        "bodies.of_measurements": _joined((truth.of_measurements for truth in present), (), np.int64),
        **{
            f"bodies.{column}": _joined((getattr(truth, name) for truth in present), (4 if "orient" in name else 3,))
            for name, column in BODY_COLUMNS.items()
        },
    }


def _body_entries(arrays: Arrays, measurements: NDArray[Any]) -> list[BodyTruth | None]:
    """Moving bodies of each frame, or None; recordings without any do not have the arrays."""
    entries: list[BodyTruth | None] = [None] * len(measurements)
    has = _has(arrays, "bodies", len(measurements)) if "has.bodies" in arrays else np.zeros(0, dtype=np.bool_)
    if not has.any():
        return entries
    counts = _shaped(arrays, "bodies.counts", (int(has.sum()),), "integers")
    if (counts < 0).any():
        raise ValueError("array bodies.counts must be >= 0")
    total, ends = int(counts.sum()), np.cumsum(counts)[:-1]
    ids, codes = (_shaped(arrays, f"bodies.{name}", (total,), "integers") for name in ("ids", "kinds"))
    if not set(codes.tolist()) <= set(range(1, 1 + len(BODY_KINDS))):
        raise ValueError(f"array bodies.kinds must be from 1 to {len(BODY_KINDS)}")
    labels = _shaped(arrays, "bodies.of_measurements", (int(measurements[has].sum()),), "integers")
    numbers = {
        name: np.split(_shaped(arrays, f"bodies.{column}", (total, 4 if "orient" in name else 3)), ends)
        for name, column in BODY_COLUMNS.items()
    }
    split = np.split(ids, ends), np.split(codes, ends), np.split(labels, np.cumsum(measurements[has])[:-1])
    for entry, k in enumerate(np.flatnonzero(has).tolist()):
        kinds = tuple(BODY_KINDS[code - 1] for code in split[1][entry].tolist())
        columns = {name: parts[entry] for name, parts in numbers.items()} | {"of_measurements": split[2][entry]}
        entries[k] = BodyTruth(split[0][entry], kinds, **columns)
    return entries


def _has(arrays: Arrays, name: str, frames: int) -> NDArray[Any]:
    return _shaped(arrays, f"has.{name}", (frames,), "truth values")


def _camera(numbers: Mapping[str, Any]) -> StereoCamera:
    for name in ("width", "height"):
        if type(numbers[name]) is not int or not 0 < numbers[name] <= _MOST_PIXELS:
            raise ValueError(f"{name} of the camera must be a whole number up to {_MOST_PIXELS}, got {numbers[name]!r}")
    for name, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _MOST:
            raise ValueError(f"{name} of the camera must be a number of at most {_MOST:g}, got {value!r}")
    return StereoCamera(**numbers)


def _shaped(arrays: Arrays, name: str, shape: tuple[int, ...], of: str = "numbers") -> NDArray[Any]:
    """The array, if its shape is that one, -1 standing for any length, and it holds what can be."""
    array = arrays[name]
    if array.ndim != len(shape) or any(want not in (-1, got) for want, got in zip(shape, array.shape, strict=True)):
        raise ValueError(f"array {name} has shape {array.shape}, expected {shape}")
    if array.dtype.kind not in _KINDS[of]:
        raise ValueError(f"array {name} must hold {of}, got {array.dtype}")
    if of != "numbers":
        return array
    most = _MOST_SQUARE if name.endswith(("covariance", "R", "noise")) else _MOST
    if not (np.abs(array) <= most).all():
        raise ValueError(f"array {name} has NaN, infinity or a number beyond {most:g}")
    if name.endswith("orientation") and (np.abs(np.linalg.norm(array, axis=-1) - 1.0) > _UNIT).any():
        raise ValueError(f"array {name} must hold unit quaternions")
    return array.astype(np.float64, copy=False)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
