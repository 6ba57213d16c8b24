"""Readers of real recordings. Each yields the same `Recording` that the environment yields.

To add a layout: a module with `NAME`, `FILES`, `recognises(path)` and `read(path, **options)`, listed in `READERS`;
for one of images see `datasets.image_sequences`, whose sequences go through the front end.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from filters.known_names import require_known
from stereo_slam_env.datasets import gtsam_examples, kitti00_stereo_tracks, kitti07_tracks, starry_night
from stereo_slam_env.datasets.image_sequences import (
    IMAGE_READERS,
    folders_in,
    known_image_layouts,
    open_image_sequence,
    recordings_in,
)
from stereo_slam_env.datasets.known_options import keyword_options
from stereo_slam_env.datasets.unknown_folder import no_known_layout, require_folder
from stereo_slam_env.files.inside import is_there, require_links_inside
from stereo_slam_env.frontend.calibration import calibrated
from stereo_slam_env.frontend.recorder import record_tracks
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.recording.archive import load_recording
from stereo_slam_env.recording.image_sequence import ImageSequence
from stereo_slam_env.recording.recording import Recording

READERS = (kitti07_tracks, kitti00_stereo_tracks, starry_night)

__all__ = ["READERS", "holds_images", "known_layouts", "open_for_front_end", "read_recording"]


def known_layouts() -> dict[str, str]:
    """What `read_recording` takes: name -> the files that tell a folder of this layout, or what to write."""
    layouts = {reader.NAME: "folder with " + ", ".join(reader.FILES) for reader in READERS}
    layouts |= known_image_layouts()
    for name in gtsam_examples.EXAMPLES:
        layouts[f"{gtsam_examples.PREFIX}:{name}"] = "example data of the gtsam wheel, no folder needed"
    layouts["recording"] = "file NAME.npz written by save_recording"
    return layouts


def read_recording(path: str | Path, **options: Any) -> Recording:
    """Read a real recording; the layout is recognised by the files in the folder.

    Parameters
    ----------
    path : str or Path
        A folder, or `gtsam` / `gtsam:NAME` for the example data of the gtsam wheel, or a file of `save_recording`.
    **options
        Options of the reader, see its `read`; for images those of `open_image_sequence`, and `front_end`, a mapping
        with fields of `TrackerSettings`.

    Raises
    ------
    ValueError
        No such folder, no known layout, an unknown option, a damaged file, or a link that leads out of the folder: one
        line that names it.
    ImportError
        The example data needs gtsam, which is not installed.
    """
    text = str(path)
    prefix, _, name = text.partition(":")
    if prefix == gtsam_examples.PREFIX and not is_there(Path(text)):
        require_known("the reader has no option", options, keyword_options(gtsam_examples.read))
        return gtsam_examples.read(name or "kitti00", **options)
    folder = Path(path)
    if folder.suffix == ".npz" and is_there(folder) and folder.is_file():
        require_known("a recording in one file has no option", options, [])
        return load_recording(folder)
    require_folder(folder, f", a recording in one file (NAME.npz) or {gtsam_examples.PREFIX!r}")
    for reader in READERS:
        if reader.recognises(folder):
            require_known("the reader has no option", options, keyword_options(reader.read))
            require_links_inside(folder)
            read: Callable[..., Recording] = reader.read
            return read(folder, **options)
    if not holds_images(folder):
        layouts = {reader.NAME: reader.FILES for reader in (*READERS, *IMAGE_READERS)}
        raise ValueError(no_known_layout(folder, folders_in(folder), layouts))
    return record_tracks(*open_for_front_end(folder, **options))


def open_for_front_end(path: str | Path, **options: Any) -> tuple[ImageSequence, TrackerSettings]:
    """A recording of images, and how the front end is to look at it.

    Parameters
    ----------
    path : str or Path
        Folder of a layout of images.
    **options
        Options of the reader, and `front_end`, a mapping with fields of `TrackerSettings`. Where that does not say
        `disparity_offset`, the first pairs are looked at to find what the rectification left.
    """
    given = options.pop("front_end", {})
    settings = front_end_settings(given)
    sequence = open_image_sequence(path, **options)
    return sequence, settings if "disparity_offset" in given else calibrated(sequence, settings)


def holds_images(path: str | Path) -> bool:
    """Whether the folder is a recording of images, or one of tracks (or none at all)."""
    folder = Path(path)
    if not folder.is_dir() or any(reader.recognises(folder) for reader in READERS):
        return False
    return bool(recordings_in(folder))


def front_end_settings(fields: Mapping[str, Any]) -> TrackerSettings:
    """Settings of the front end from their JSON form.

    Raises
    ------
    ValueError
        An unknown field, or an impossible value.
    """
    known = [field.name for field in dataclasses.fields(TrackerSettings)]
    require_known("the front end has no setting", fields, known)
    return TrackerSettings(**fields)
