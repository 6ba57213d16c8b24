"""Readers of real recordings: `load` gives a `Recording` of tracks or of images, whatever layout a folder or file has.

A layout is one of `layouts`, ours or a third party's, and is recognised by its files.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from filters.contract.noise import ColouredNoise
from filters.contract.validation import require_known
from stereo_slam_env.datasets.bag_images import grey_of
from stereo_slam_env.datasets.bag_motion import TRUTH
from stereo_slam_env.datasets.image_files import BrokenPair
from stereo_slam_env.datasets.layouts import (
    FolderLayout,
    available_recordings,
    file_layout,
    image_layouts,
    track_layouts,
)
from stereo_slam_env.datasets.restated import Recalibrated, WithTruth
from stereo_slam_env.datasets.sequence import Choice, OnBroken
from stereo_slam_env.datasets.single_data_sets import read_gtsam
from stereo_slam_env.datasets.writing import FORMATS, SOURCE, reference_beside, write_recording
from stereo_slam_env.evaluation.body_frames import read_body
from stereo_slam_env.files.opening import is_there, require_inside, require_links_inside
from stereo_slam_env.frontend.camera_motion import set_up_for_tracks, with_moving_start
from stereo_slam_env.frontend.rectification_errors import calibrated
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.track_noise import with_measured_noise
from stereo_slam_env.frontend.track_recorder import record_tracks
from stereo_slam_env.recording.archive import load_recording
from stereo_slam_env.recording.recording import ImageSequence, Recording
from stereo_slam_env.sensing.projections import require_baseline
from stereo_slam_env.sensing.rigs import Rig, calibration_of

EXAMPLE = "gtsam"
_CHOICE = ("first", "last", "on_broken", "rig", "truth", "body")

__all__ = [
    "FORMATS",
    "BrokenPair",
    "available_recordings",
    "grey_of",
    "holds_images",
    "image_layouts",
    "layout_of",
    "load",
    "open_for_front_end",
    "open_image_sequence",
    "track_layouts",
    "write_recording",
]


def load(source: str | Path, **options: Any) -> Recording:
    """Load a real recording, whatever `stereo-slam replay` takes.

    Parameters
    ----------
    source : str or Path
        A folder, whose layout is recognised by its files; a ROS bag; a file of `save_recording` (`NAME.npz`); or
        `gtsam`, the example data inside the gtsam wheel.
    **options
        Options of the reader, see its `read`; for images those of `open_for_front_end`.

    Returns
    -------
    Recording
        The measurements in time order, with what is known of truth and odometry. If it is not simulated, with what its
        tracks say of errors that last (`with_measured_noise`), unless it says so itself. But for a file, which states
        its own, with the setup of filters that tracks of real pictures need (`set_up_for_tracks`).

    Raises
    ------
    ValueError
        No such folder, no known layout, an unknown option, a damaged file, or a link that leads out of the folder: one
        line that names it.
    ImportError
        The example data needs gtsam, which is not installed.
    """
    path = Path(source)
    if source == EXAMPLE and not is_there(path):
        _require_options(EXAMPLE, read_gtsam, options)
        return set_up_for_tracks(_with_its_noise(read_gtsam(**options)))
    if path.suffix == ".npz" and is_there(path) and path.is_file():
        require_known("a recording in one file has no option", options, [])
        return _with_its_noise(load_recording(path))
    layout = layout_of_tracks(path)
    if layout is None:
        return set_up_for_tracks(record_tracks(*open_for_front_end(path, **options)))
    _require_options(layout.NAME, layout.read, options)
    require_links_inside(path)
    return set_up_for_tracks(_with_its_noise(layout.read(path, **options)))


def layout_of_tracks(path: Path) -> Any | None:
    """Layout of tracks that a folder or a file has; None of images.

    Raises
    ------
    ValueError
        There is no such folder, or nothing that is known in it.
    """
    if (layout := _of_file(path)) is None:
        _require_folder(path, f", a bag, a recording in one file (NAME.npz) or {EXAMPLE!r}")
        layout = _recognised(path, track_layouts())
    if layout is not None and hasattr(layout, "read"):
        return layout
    if not holds_images(path):
        raise _unknown_layout(path, (*track_layouts(), *image_layouts()))
    return None


def _with_its_noise(recording: Recording) -> Recording:
    stated = isinstance(recording.noise, ColouredNoise) or recording.truth_from.kind == "simulation"
    stated |= not all(frame.observation.has_disparity for frame in recording.frames)  # one camera shows no motion
    return recording if stated else with_measured_noise(with_moving_start(recording))


def open_for_front_end(path: str | Path, **options: Any) -> tuple[ImageSequence, TrackerSettings]:
    """Open a recording of images, with settings of the front end for it.

    Parameters
    ----------
    path : str or Path
        Folder of a layout of images.
    **options
        Those of `open_image_sequence`, and `front_end`, a mapping with fields of `TrackerSettings`. Where that does
        not say `disparity_offset`, the first pairs are measured to find what the rectification left.

    Raises
    ------
    ValueError
        As `open_image_sequence`, or an unknown field of the front end, or an impossible value of one.
    """
    front_end_options: Mapping[str, Any] = options.pop("front_end", {})
    fields = [field.name for field in dataclasses.fields(TrackerSettings)]
    require_known("the front end has no setting", front_end_options, fields)
    settings = TrackerSettings(**front_end_options)
    sequence = open_image_sequence(path, **options)
    return sequence, settings if "disparity_offset" in front_end_options else calibrated(sequence, settings)


def open_image_sequence(
    path: str | Path,
    *,
    first: int | None = None,
    last: int | None = None,
    on_broken: OnBroken = "raise",
    rig: Rig | None = None,
    truth: str | Path | None = None,
    body: str | Path | None = None,
    **options: Any,
) -> ImageSequence:
    """Open a recording of stereo images; the layout is recognised by the files in the folder.

    Parameters
    ----------
    path : str or Path
        A folder of a known layout, or one that holds exactly one such folder, up to two levels down; or a bag.
    first, last : int, optional
        Frame numbers to start and to end with, both included.
    on_broken : {"raise", "skip"}
        What is done about pairs that cannot be used; "skip" leaves them out and counts them in `skipped`.
    rig : str, StereoCamera or mapping, optional
        Calibration in place of that of the recording, see `sensing.rigs.camera_of`; raw images are rectified by it.
    truth : str or Path, optional
        True poses in place of those of the recording: a trajectory of the left camera in any layout, see
        `load_trajectory`, with times of the clock of the images.
    body : str or Path, optional
        JSON with R and t of the left camera's pose in the body whose poses are in `truth`.
    **options
        Options of the reader, see its `open_sequence`.

    Raises
    ------
    ValueError
        No such folder, no known layout, an unknown option, something is missing or damaged, or a link leads out of the
        folder: one line that names it.
    """
    place = _with_its_bag(Path(path))
    layout = _of_file(place)
    folder = place
    if layout is None:
        _require_folder(place, " or a bag")
        recordings = _image_recordings(place)
        if len(recordings) > 1:
            names = ", ".join(str(folder.relative_to(place)) for folder in recordings)
            raise ValueError(f"{place} holds {len(recordings)} recordings, give one of them: {names}")
        layout = _recognised(recordings[0], image_layouts()) if recordings else None
        if layout is None:
            raise _unknown_layout(place, image_layouts())
        folder = require_inside(recordings[0], place)
        require_links_inside(folder)
    parameters = _require_options(layout.NAME, layout.open_sequence, options, _CHOICE)
    if body is not None and truth is None:
        raise ValueError("body is that of the poses in truth: give truth, too")
    if "rig" in parameters:
        options["rig"], rig = rig, None
    sequence: ImageSequence = layout.open_sequence(folder, Choice(first, last, on_broken), **options)
    if rig is not None:
        sequence = Recalibrated(sequence, calibration_of(rig), str(rig))
    require_baseline(place, sequence.camera.baseline)
    stated = getattr(sequence, "stated_truth", None)
    if truth is not None:
        sequence = WithTruth(sequence, str(truth), None if body is None else read_body(Path(body)))
    elif stated is not None:
        sequence = WithTruth(sequence, f"{folder}:{TRUTH}", stated.T_bc, (stated.trajectory, stated.motion))
    reference = stated.reference if stated is not None else reference_beside(folder)
    if truth is None and sequence.truth_from.kind != "none" and reference is not None:
        restated: Any = sequence
        restated.truth_from = reference
    return sequence


def holds_images(path: str | Path) -> bool:
    """Whether the folder or file is a recording of images, and not one of tracks or none at all."""
    folder = _with_its_bag(Path(path))
    if (layout := _of_file(folder)) is not None:
        return hasattr(layout, "open_sequence")
    return folder.is_dir() and _recognised(folder, track_layouts()) is None and bool(_image_recordings(folder))


def _with_its_bag(path: Path) -> Path:
    """The bag in the folder of a drive that `write_recording` made; anything else as it is."""
    drives = [path / form.file for form in FORMATS.values() if form.file is not None]
    bags = [bag for bag in drives if is_there(bag) and is_there(path / SOURCE)]
    return bags[0] if len(bags) == 1 else path


def _of_file(path: Path) -> Any | None:
    """The layout of a recording in one file; None of what is none."""
    return file_layout(path) if is_there(path) and path.is_file() else None


def layout_of(folder: Path) -> str | None:
    """Name of the layout that the folder itself has; None where it has none of those known."""
    layout = _recognised(folder, (*track_layouts(), *image_layouts()))
    return None if layout is None else str(layout.NAME)


def _recognised(folder: Path, layouts: Iterable[Any]) -> Any | None:
    return next((layout for layout in layouts if not _lacking(folder, layout)), None)


def _lacking(folder: Path, layout: FolderLayout) -> list[str]:
    """The entries that the folder lacks to have the layout, of the set that comes nearest."""
    return _nearest_set(folder, layout)[0]


def _nearest_set(folder: Path, layout: FolderLayout) -> tuple[list[str], float]:
    """The entries that the folder lacks of the set that comes nearest, and their share of the set."""
    missing = [[entry for entry in entries if not _holds(folder, entry)] for entries in layout.FILES]
    shares = [(len(lacking) / len(entries), lacking) for lacking, entries in zip(missing, layout.FILES, strict=True)]
    share, lacking = min(shares, key=lambda one: one[0])
    return lacking, share


def _holds(folder: Path, entry: str) -> bool:
    parent = folder.resolve().parent if entry.startswith("../") else folder
    return any(parent.glob(entry.removeprefix("../")))


def _image_recordings(folder: Path) -> list[Path]:
    """The folder itself if it has a layout of images, else those up to two levels below it that have one."""
    if _recognised(folder, image_layouts()) is not None:
        return [folder]
    folders = [below for below in _folders(folder) if _recognised(below, image_layouts())]
    return [
        below for below in folders if below.parent not in folders
    ]  # a recording's own folder may look like one, too


def _folders(folder: Path) -> list[Path]:
    """The folder and those up to two levels below it, level by level."""
    below = (path for pattern in ("*", "*/*") for path in sorted(folder.glob(pattern)))
    return [folder, *(path for path in below if path.is_dir())]


def _require_folder(path: Path, others: str = "") -> None:
    exists = is_there(path)
    if not exists or not path.is_dir():
        what = "is a file, not a folder" if exists else "does not exist"
        raise ValueError(f"{path} {what}: give a folder with a recording{others}")


def _require_options(
    reader: str, read: Callable[..., Any], options: Mapping[str, Any], others: Sequence[str] = ()
) -> list[str]:
    """Names of the keyword-only parameters of a reader, one of which or of `others` every option must be."""
    parameters = inspect.signature(read).parameters.values()
    option_names = [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
    require_known(f"the reader {reader} has no option", options, [*others, *option_names])
    return option_names


def _unknown_layout(path: Path, layouts: Sequence[Any]) -> ValueError:
    """The error for a folder without a known layout: one line with the nearest one and what it lacks of it."""
    for folder in _folders(path):
        lacking = {layout.NAME: _nearest_set(folder, layout) for layout in layouts}
        nearest = min(layouts, key=lambda layout: lacking[layout.NAME][1])
        if lacking[nearest.NAME][1] < 1:
            where = "" if folder == path else f", in {folder.relative_to(path)}"
            missing = ", ".join(lacking[nearest.NAME][0])
            return ValueError(f"{path} has no known layout: nearest is {nearest.NAME}{where}, which lacks {missing}")
    what = "has no known layout: it holds no file of one" if any(path.iterdir()) else "is empty"
    return ValueError(
        f"{path} {what}; stereo-slam convert --list says which are known (their files: docs/real_data.md)"
    )
