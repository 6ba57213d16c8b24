"""Recordings of images written for other programs, in a stream: what each format keeps, resumed where it was stopped.

Everything is told in the frames of `SensorSuite`: true poses of the body B and of the left camera in the world U, whose
z axis points up, stamps in ns since 1970. Inertial rows are stamped in the middle of the period that they are the mean
of, which readers that take them for instants, or join them by straight lines, read rightly.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from filters import StereoCamera
from filters.contract.validation import plain, require_known
from stereo_slam_env.datasets.asl_writer import AslWriter
from stereo_slam_env.datasets.bag_motion import BIAS, TRUTH
from stereo_slam_env.datasets.bag_writer import IMU, LEFT_IMAGES, ODOMETRY, RIGHT_IMAGES, BagWriter
from stereo_slam_env.datasets.kitti_odometry import KittiWriter, poses_file
from stereo_slam_env.datasets.settings_files import Topics, readme, settings_files
from stereo_slam_env.datasets.written_frame import (
    INERTIAL,
    KINDS,
    POSES,
    STATES,
    STEPS,
    TrueTrajectories,
    WrittenFrame,
    frames_of,
)
from stereo_slam_env.files.folders import CLAIM, claimed_folder, json_text, write_text
from stereo_slam_env.files.readers import read_json
from stereo_slam_env.recording.archive import reference_of
from stereo_slam_env.recording.recording import ImageSequence, Reference, StereoPair
from stereo_slam_env.sensing.sensor_suite import SensorSuite

EPOCH_NS = 1_700_000_000 * 10**9
"""Stamp of the first pair of a simulated drive: programs take stamps near zero for missing ones."""
PARTIAL = ".partial"
"""Ending of a folder or file that is not yet complete."""
SOURCE = "source.json"
"""File in the folder of a drive that says what it is of."""
log = logging.getLogger(__name__)
_FILES = (".mcap", ".bag")
"""Endings of drives that are one file."""
TOPICS = Topics(
    f"{LEFT_IMAGES}/image_rect",
    f"{RIGHT_IMAGES}/image_rect",
    f"{LEFT_IMAGES}/camera_info",
    f"{RIGHT_IMAGES}/camera_info",
    IMU,
    ODOMETRY,
)


class FrameWriter(Protocol):
    """Writer of one format."""

    def has_images(self, number: int, stamp: int) -> bool:
        """Whether the images of a pair are there from a writing that was stopped; by number and stamp, ns."""

    def write(self, frame: WrittenFrame) -> None:
        """Write what came with a pair."""

    def close(self) -> None:
        """Write what makes it complete."""


@dataclass(frozen=True)
class WrittenFormat:
    """A format that drives are written in."""

    line: str
    """What it is, in a line."""
    keeps: frozenset[str]
    """Data beside images and calibration that it has a place for."""
    writer: Callable[..., FrameWriter]
    """Called with where it goes and the sensors."""
    states: str = ""
    """Where its true velocities and biases are."""
    file: str | None = None
    """Name of its only file in the folder of a drive; None: it is the folder."""


_OF_EUROC, _OF_BAGS = "`mav0/state_groundtruth_estimate0/data.csv`", f"`{TRUTH}` and `{BIAS}` of the bag"
_TUM_VI = partial(AslWriter, of_tum_vi=True)
_DB3, _ROS1 = (partial(BagWriter, kind=kind) for kind in ("db3", "bag"))
FORMATS: Mapping[str, WrittenFormat] = {
    "euroc": WrittenFormat("EuRoC's ASL folder, `mav0`", KINDS, partial(AslWriter, of_tum_vi=False), _OF_EUROC),
    "tum-vi": WrittenFormat("TUM-VI's folder: `mav0`, Kalibr's files in `dso`", KINDS - {STATES}, _TUM_VI),
    "kitti": WrittenFormat("KITTI odometry: sequences/NN, poses/NN.txt", frozenset({POSES}), KittiWriter),
    "mcap": WrittenFormat("ROS 2, one MCAP file", KINDS, partial(BagWriter, kind="mcap"), _OF_BAGS, "drive.mcap"),
    "db3": WrittenFormat("ROS 2, a folder with a database", KINDS, _DB3, _OF_BAGS, "drive"),
    "bag": WrittenFormat("ROS 1, one file", KINDS, _ROS1, _OF_BAGS, "drive.bag"),
}
"""Formats by name."""


def write_recording(
    sequence: ImageSequence,
    out: str | Path,
    format_name: str | None = None,
    *,
    name: str = "00",
    time_offset: float = 0.0,
    compressed: bool = False,
    may_lose: Collection[str] = (),
    about: Mapping[str, str] | None = None,
    keep_same: bool = False,
    on_pair: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a recording of images with all that came with it; what was stopped goes on where it was.

    Parameters
    ----------
    sequence : ImageSequence
        What to write; it is read once, a pair at a time.
    out : str or Path
        Folder; of KITTI that of `sequences` and `poses`. NAME.mcap and NAME.bag are one file, without settings.
    format_name : str, optional
        One of `FORMATS`; None: by the ending, else "kitti".
    name : str
        Of a KITTI sequence, two digits in the benchmark; other formats have none.
    time_offset : float
        Added to the stamps of the inertial unit, s.
    compressed : bool
        Whether images in a bag are PNG.
    may_lose : collection of str
        Data that may be left out where the format has no place for them.
    about : mapping of str to str, optional
        Further facts, by title, for a README.md in the folder; None: there is none.
    keep_same : bool
        Whether the same recording that is there already, whole, is left as it is. Otherwise it is refused.
    on_pair : callable, optional
        Called after every pair with the number written and the number expected.

    Returns
    -------
    Path
        The folder or file of the drive; of KITTI that of the sequence.

    Raises
    ------
    ValueError
        No such format; it has no place for what the recording has; something is there already, or a part of it from
        another writing; the name is no file name; an image is not of the camera's size; there are no pairs.
    """
    out = Path(out)
    if format_name is None:
        format_name = out.suffix[1:] if out.suffix in _FILES else "kitti"
    require_known("there is no format", [format_name], FORMATS)
    form = FORMATS[format_name]
    if compressed and form.file is None:
        raise ValueError(f"compressed must be left out of the format {format_name}: its images are PNG")
    if out.suffix in _FILES and out.suffix != f".{format_name}":
        right = f"end in .{format_name}, or be a folder," if f".{format_name}" in _FILES else "be a folder"
        raise ValueError(f"out must {right} for the format {format_name}, got {out}")
    place = _place(out, format_name, name)
    source = {"name": sequence.name, "format": format_name, "time_offset": time_offset, "compressed": compressed}
    source |= sequence.source
    source["truth_from"] = asdict(replace(sequence.truth_from, settled_at=None))  # what is written has settled
    if keep_same and _is_of(place, source):
        return place
    unfinished = place.with_name(place.name + PARTIAL)
    _require_free(place, unfinished, source)
    epoch = round(1e9 * float(sequence.source["epoch_s"])) if "epoch_s" in sequence.source else EPOCH_NS
    epoch = 0 if format_name == "kitti" else epoch  # its times are those of the drive
    writer: FrameWriter | None = None

    def is_drawn(number: int, time: float) -> bool:
        return writer is None or not writer.has_images(number, epoch + round(1e9 * time))

    drawn: Any = sequence
    every = drawn.pairs(is_drawn) if getattr(sequence, "draws_on_demand", False) else sequence.pairs()
    ahead = list(islice(every, 2))
    if not ahead:
        raise ValueError(f"sequence {sequence.name!r} has no pairs: nothing was written")
    writable = form.keeps | set(may_lose)
    _require_kept(ahead, writable, format_name)
    _require_read(getattr(sequence, "not_read", {}), may_lose)
    suite = _suite(sequence, ahead, time_offset)
    if INERTIAL not in form.keeps:  # settings are of what is there
        suite = replace(suite, unit=None)
    if STEPS not in form.keeps:
        suite = replace(suite, odometry=None)
    with claimed_folder(unfinished):
        write_text(unfinished / SOURCE, json_text(source))
        file = place.name if place.suffix in _FILES else form.file
        options: dict[str, Any] = {"compressed": True} if compressed else {}
        options |= {"truth_from": source["truth_from"]} if file is not None else {}
        writer = form.writer(unfinished if file is None else unfinished / file, suite, **options)
        truths = None if place.suffix in _FILES else TrueTrajectories(unfinished)
        lost = set[str]()
        for frame in frames_of(chain(ahead, every), suite, epoch):
            lost |= _data_of(frame.pair) - form.keeps
            _require_kept([frame.pair], writable, format_name)
            writer.write(frame)
            if truths is not None:
                truths.write(frame)
            if on_pair is not None:
                on_pair(frame.number + 1, len(sequence))
        writer.close()
        if truths is not None:
            truths.close()
            texts = {f"settings/{one}": text for one, text in settings_files(suite, sequence.name, TOPICS).items()}
            if about is not None:
                states = form.states if ahead[0].velocity is not None else ""
                texts["README.md"] = readme(suite, sequence.name, {"Format": form.line, **about}, states)
            for one, text in texts.items():
                write_text(unfinished / one, text)
    if lost:
        log.warning("%s: left out, as the format %s has no place for them: %s", place, format_name, _listed(lost))
    (unfinished / CLAIM).unlink(missing_ok=True)
    return _completed(place, unfinished)


def reference_beside(place: Path) -> Reference | None:
    """The reference of a drive in the folder `place` that was written here and says so; None of others."""
    for folder in (place, place.parent):
        if not (file := folder / SOURCE).is_file():
            continue
        try:
            source = read_json(file)
        except ValueError as error:  # of somebody else, perhaps
            log.warning("not read: %s", error)
            continue
        form = FORMATS.get(str(source.get("format"))) if isinstance(source, dict) else None
        if form is not None and "truth_from" in source and (folder == place or place.name == "mav0"):
            try:
                return reference_of(source)
            except (TypeError, ValueError, KeyError) as error:
                raise ValueError(f"{file}: truth_from is no reference ({error}): remove the file") from error
    return None


def _place(out: Path, format_name: str, name: str) -> Path:
    if format_name != "kitti":
        if name != "00":
            raise ValueError(f"name {name!r} is of a KITTI sequence: leave it out of the format {format_name}")
        return out
    if not name or Path(name).name != name or name.startswith("."):
        raise ValueError(f"name must be a plain folder name such as '00', got {name!r}")
    return out / "sequences" / name


def _is_of(folder: Path, source: Mapping[str, Any]) -> bool:
    """Whether a folder says that it is of this writing."""
    file = folder / SOURCE
    return file.is_file() and read_json(file) == json.loads(json_text(source))


def _require_free(place: Path, partial: Path, source: Mapping[str, Any]) -> None:
    """Refuse what is there already, but for what the same writing left when it was stopped."""
    remove = "choose another name or folder, or remove it"
    if place.exists() and (not place.is_dir() or any(place.iterdir())):
        raise ValueError(f"{place} is not empty: {remove}" if place.is_dir() else f"{place} is there already: {remove}")
    if partial.exists() and not _is_of(partial, source):
        raise ValueError(f"{partial} was left by a writing that was interrupted, of something else: remove it")
    if place.parent.name == "sequences" and poses_file(place).exists():
        raise ValueError(f"{poses_file(place)} is there already: {remove}")


def _completed(place: Path, unfinished: Path) -> Path:
    """Give what was written its name."""
    if place.suffix in _FILES:
        (unfinished / place.name).replace(place)
        (unfinished / SOURCE).unlink()
        unfinished.rmdir()
        return place
    if (poses := unfinished / KittiWriter.POSES).exists():
        poses_file(place).parent.mkdir(exist_ok=True)
        poses.replace(poses_file(place))
    if place.exists():
        place.rmdir()
    unfinished.rename(place)
    return place


def _data_of(pair: StereoPair) -> set[str]:
    data = {INERTIAL: pair.inertial, STEPS: pair.odometry, POSES: pair.truth, STATES: pair.velocity}
    return {kind for kind, value in data.items() if value is not None}


def _listed(kinds: Collection[str]) -> str:
    return " and ".join(sorted(kinds))


def _require_read(not_read: Mapping[str, str], may_lose: Collection[str]) -> None:
    """Refuse a bag with topics of a unit or an odometry that were not asked for."""
    if topics := [topic for topic, kind in not_read.items() if kind not in may_lose]:
        raise ValueError(
            f"the recording has {' and '.join(map(plain, topics))}, which would be lost, since it is not read unasked: "
            "name it (--odometry-topic, --imu-topic), or leave it out (convert --lossy)"
        )


def _require_kept(pairs: Sequence[StereoPair], writable: Collection[str], format_name: str) -> None:
    lost = set().union(*map(_data_of, pairs)) - set(writable)
    if lost:
        formats = ", ".join(name for name, form in FORMATS.items() if lost <= form.keeps)
        raise ValueError(
            f"the format {format_name} has no place for {_listed(lost)}, which the recording has: choose "
            f"{formats}, or leave them out (--lossy of convert)"
        )


def _suite(sequence: ImageSequence, ahead: Sequence[StereoPair], time_offset: float) -> SensorSuite:
    """Sensors of a sequence, by its first two pairs."""
    camera: StereoCamera = sequence.camera
    first, last = ahead[0], ahead[-1]
    rate = _rounded(1.0 / (last.timestamp - first.timestamp)) if len(ahead) > 1 else 10.0
    about: dict[str, Any] = {}
    if (samples := last.inertial) is not None:
        step = float(np.median(np.diff(samples.times))) if len(samples.times) > 1 else float(samples.times[0])
        about = {"unit": samples.unit, "imu_rate": _rounded(1.0 / step), "time_offset": time_offset}
    if (gravity := getattr(sequence, "gravity", None)) is not None:
        about["gravity"] = tuple(np.asarray(gravity).tolist())
    if last.odometry is not None:
        about["odometry"] = last.odometry.covariance
    return SensorSuite(camera, rate, **about)


def _rounded(rate: float) -> float:
    """A rate by the difference of two times, to the digits that it has."""
    return float(f"{rate:.9g}")
