"""A plain folder: `left/` and `right/` with images in the order of their names, and `recording.toml`.

    rig = "calib.yaml"        # a calibration file, see `sensing.rig_files`, or a table of numbers
    rate_hz = 20              # or: times = "times.txt" (one a line), or "names" (of the files): s, ms, us or ns
    truth = "truth.tum"       # optional: a trajectory of the left camera
    reference = "surveyed"    # optional: what the truth is
    body = "T_body_camera.json"   # optional: pose of the left camera in the body of the truth, R and t

Raw images are rectified by the rig.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from filters import StereoCamera
from filters.contract.validation import first_line, positive, require_known
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.image_files import MOST_FRAMES
from stereo_slam_env.datasets.restated import Recalibrated, WithTruth
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence
from stereo_slam_env.evaluation.body_frames import read_body
from stereo_slam_env.files.opening import require_inside
from stereo_slam_env.files.readers import parse_toml, read_table, read_text
from stereo_slam_env.recording.recording import NO_REFERENCE, ImageSequence
from stereo_slam_env.recording.trajectory_layouts import scale_of
from stereo_slam_env.sensing.rigs import Rig, calibration_of

NAME = "stereo_folder"
ABOUT = "recording.toml"
FILES = (("left", "right", ABOUT),)
log = logging.getLogger(__name__)
_KEYS = ("rig", "rate_hz", "times", "truth", "reference", "body")


def open_sequence(path: Path, choice: Choice, *, rig: Rig | None = None, use_truth: bool = True) -> ImageSequence:
    """Open the folder.

    Parameters
    ----------
    path : Path
        Folder with the entries named in `FILES`.
    choice : Choice
        Frames to use, see `open_image_sequence`, also for what is raised.
    rig : str, StereoCamera or mapping, optional
        In place of that in the file, see `sensing.rigs.camera_of`.
    use_truth : bool
        Whether to read the trajectory that the file names, if it does.
    """
    path = path.resolve()
    about, folders = _about(path / ABOUT), (path / "left", path / "right")
    images = _images(folders)
    seconds, epoch, times_file = _times(path, about, images[0])
    if rig is None and "rig" not in about:
        raise ValueError(f"{path / ABOUT} lacks 'rig': a calibration file, or a table of its numbers")
    calibration = calibration_of(_inside(path, about["rig"]) if rig is None else rig)
    camera = calibration if isinstance(calibration, StereoCamera) else calibration.camera
    files = ImageFiles(folders, images, seconds, times_file)
    source: dict[str, Any] = {"reader": NAME, "path": str(path), "epoch_s": epoch}
    sequence: ImageSequence = RecordedSequence(path.name, files, choice, lambda image: camera, source, NO_REFERENCE)
    sequence = Recalibrated(sequence, calibration, str(about.get("rig") if rig is None else rig))
    if not use_truth or "truth" not in about:
        return sequence
    truth = str(require_inside(path / str(about["truth"]), path))
    body = read_body(require_inside(path / str(about["body"]), path)) if "body" in about else None
    with_truth = WithTruth(sequence, truth, body)
    if "reference" in about:
        with_truth.truth_from = replace(with_truth.truth_from, kind=about["reference"])
    return with_truth


def _about(path: Path) -> Mapping[str, Any]:
    text = read_text(path)
    try:
        about = parse_toml(text)
    except ValueError as error:
        raise ValueError(f"{path} is no TOML ({first_line(error)}): correct it") from error
    require_known(f"{path} has no entry", about, _KEYS)
    if ("rate_hz" in about) == ("times" in about):
        raise ValueError(f"{path} must say either rate_hz or times ('times.txt', or 'names' of files that are times)")
    return about


def _inside(path: Path, rig: Any) -> Rig:
    """The rig with its files inside the folder."""
    if isinstance(rig, str):
        return str(require_inside(path / rig, path)) if (path / rig).exists() else rig
    if isinstance(rig, Mapping):
        files = ("name", "left", "right")
        return {
            key: _inside(path, value) if key in files and isinstance(value, str) else value
            for key, value in rig.items()
        }
    raise ValueError(f"{path / ABOUT}: rig must be a calibration file or a table of its numbers, got {rig!r}")


def _images(folders: tuple[Path, Path]) -> tuple[dict[int, Path], dict[int, Path]]:
    """Images of both folders by their number in the order of names; of one name, where the names of both are alike."""
    left, right = ({file.name: file for file in folder.iterdir() if _is_image(file)} for folder in folders)
    names = sorted({*left, *right}) if left.keys() & right.keys() else []
    if len(left) > MOST_FRAMES:
        raise ValueError(f"{folders[0]} holds {len(left)} images: more than {MOST_FRAMES} are refused")
    if names:
        return {k: left[n] for k, n in enumerate(names) if n in left}, {
            k: right[n] for k, n in enumerate(names) if n in right
        }
    if len(left) != len(right) or not left:
        raise ValueError(
            f"{folders[0]} has {len(left)} images and {folders[1]} {len(right)}, with other names: give both "
            "images of a pair one name"
        )
    return dict(enumerate(left[name] for name in sorted(left))), dict(enumerate(right[name] for name in sorted(right)))


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in (".png", ".jpg", ".jpeg") and not path.name.startswith(".")


def _times(path: Path, about: Mapping[str, Any], left: Mapping[int, Path]) -> tuple[FloatArray, float, Path]:
    """Times of the frames since the first, s, that of the first by its clock, s, and where they stand."""
    count = max(left, default=-1) + 1
    if "rate_hz" in about:
        return np.arange(count) / positive("rate_hz", about["rate_hz"]), 0.0, path / ABOUT
    if about["times"] != "names":
        file = require_inside(path / str(about["times"]), path)
        stamps = read_table(file, 1, finite=False).reshape(-1)
        first: int | float = next(iter(stamps[np.isfinite(stamps)]), 0.0)
        since = stamps - first
    else:
        file, names = path / "left", [_stamp(left[k]) if k in left else np.nan for k in range(count)]
        first = next((name for name in names if np.isfinite(name)), 0)
        since, stamps = np.array([name - first for name in names]), np.array(names, dtype=np.float64)
    unit, notes = scale_of(stamps[np.isfinite(stamps)])
    for note in notes:
        log.warning("%s: %s", file, note)
    return unit * since, float(unit * first), file


def _stamp(image: Path) -> int | float:
    if not re.fullmatch(r"\d{1,19}(\.\d{1,9})?", image.stem):
        raise ValueError(
            f"{image} is no time in s, ms, us or ns, as times = 'names' of {ABOUT} says: name it so, or give a file"
        )
    return int(image.stem) if image.stem.isdecimal() else float(image.stem)
