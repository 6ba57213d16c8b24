"""Registry of the layouts of recordings: ours, and those of third parties.

A third party adds a layout with an entry point in the group `stereo_slam.recordings`, whose object (a module will do)
has `NAME`, `FILES` and one of two readers::

    [project.entry-points."stereo_slam.recordings"]
    my-robot = "my_package.my_robot"

`FILES` holds one or more sets of entries, any of which tells a folder of this layout; `*` stands for anything, `../`
for the folder around. A recording that may be one file has its endings in `SUFFIXES`. Of tracks, `read(path,
**options)` gives the `Recording`; of images, `open_sequence(path, choice, **options)` an `ImageSequence`, which then
goes through the front end. Options are keyword-only parameters.

Makers of the true poses of public recordings, known by a digest of their positions.

A layout says how files are written, not who made them: anybody may use that of KITTI. So a reader names a maker only
where the positions are, to the last bit, those that he published; others are stated by the recording. The errors of
their poses are those that the maker states, or that the poses themselves show (docs/covariances.md has the sources and
`benchmarks/reference_jitter.py` the figures).
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from filters.contract.validation import first_line, plain, type_name
from filters.geometry.arrays import FloatArray
from stereo_slam_env.recording.recording import Reference

ENTRY_POINT_GROUP = "stereo_slam.recordings"
NOT_AVAILABLE = "not available"
"""Begins the line of a layout that is there and cannot be used."""
_OURS = (
    *("kitti07_tracks", "kitti00_stereo_tracks", "starry_night", "mono_tracks"),
    *("kitti06_stereo51", "kitti_odometry", "kitti_raw", "karlsruhe", "euroc", "tartanair", "vslam_lab"),
    *("stereo_folder", "ros_bag"),
)
_SINGLE = ("kitti07_tracks", "kitti00_stereo_tracks", "starry_night", "kitti06_stereo51", "karlsruhe")
"""Rows of the table in `single_data_sets`; the others are modules."""

_log = logging.getLogger(__name__)


class FolderLayout(Protocol):
    """A layout of recordings; besides, `read` or `open_sequence`, and perhaps `SUFFIXES`."""

    NAME: str
    FILES: Sequence[Sequence[str]]


@dataclass(frozen=True, eq=False)
class LayoutRow:
    """A layout that is a row of a table: where its truth stands, and its reader, whose first line describes it."""

    NAME: str
    FILES: tuple[tuple[str, ...], ...]
    truth: str
    reader: Callable[..., Any]

    def __post_init__(self) -> None:
        object.__setattr__(self, "__doc__", self.reader.__doc__)


class ImagesRow(LayoutRow):
    """A layout of stereo images that is a row of a table."""

    @property
    def open_sequence(self) -> Callable[..., Any]:
        """The reader, by the name that layouts have it under."""
        return self.reader


def track_layouts() -> tuple[Any, ...]:
    """The layouts of tracks."""
    return tuple(layout for layout in _usable() if hasattr(layout, "read"))


def image_layouts() -> tuple[Any, ...]:
    """The layouts of stereo images."""
    return tuple(layout for layout in _usable() if hasattr(layout, "open_sequence"))


def available_recordings() -> dict[str, str]:
    """Names of all layouts and one line on each; one that cannot be loaded says so instead."""
    lines = {}
    for point in _points():
        layout = _loaded(point)
        lines[point.name] = _line(layout) if not isinstance(layout, str) else f"{NOT_AVAILABLE}: {layout}"
    return lines


def file_layout(path: Path) -> Any | None:
    """The layout whose recordings may be a single file of this ending; None: of no layout."""
    return next((one for one in _usable() if path.suffix in getattr(one, "SUFFIXES", ())), None)


def _points() -> list[EntryPoint]:
    places = {name: f"single_data_sets:{name.upper()}" if name in _SINGLE else name for name in _OURS}
    ours = [EntryPoint(name, f"stereo_slam_env.datasets.{place}", ENTRY_POINT_GROUP) for name, place in places.items()]
    return [*ours, *(point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in _OURS)]


def _usable() -> list[Any]:
    layouts = []
    for point in _points():
        layout = _loaded(point)
        if isinstance(layout, str):
            _log.warning("the layout %s is %s: %s", plain(point.name), NOT_AVAILABLE, layout)
        else:
            layouts.append(layout)
    return layouts


@lru_cache(maxsize=256)
def _loaded(point: EntryPoint) -> Any:
    """The layout, or why there is none: a stranger's module must not take a reading down."""
    try:
        layout = point.load()
        if not isinstance(layout.NAME, str) or not all(isinstance(entry, str) for one in layout.FILES for entry in one):
            return "NAME must be text and FILES sets of names"
    except Exception as error:
        return f"{type_name(error)}: {first_line(error)}"
    readers = [name for name in ("read", "open_sequence") if callable(getattr(layout, name, None))]
    return layout if len(readers) == 1 else "it must have either read or open_sequence"


def _line(layout: Any) -> str:
    text = (getattr(layout, "__doc__", None) or "no description").strip().splitlines()
    return plain(text[0]) if text else "no description"


POSITION = np.s_[3::4]
"""Columns of the position in KITTI's rows of 12 numbers."""


@dataclass(frozen=True)
class KnownRecording:
    """A public recording: its reference, and the first frame to use or to score."""

    reference: Reference
    first_scored: int = 0


def digest(positions: FloatArray) -> str:
    """SHA-256 of positions (K, 3), m, as they stand in a file, whatever it writes around them."""
    return hashlib.sha256(np.ascontiguousarray(positions, dtype="<f8").tobytes()).hexdigest()


def known_by(positions: FloatArray) -> KnownRecording | None:
    """The recording whose truth has these positions (K, 3), m, all of them and no others; None: a stranger's."""
    return KNOWN.get(digest(positions))


def reference_for(positions: FloatArray, stated: str, seconds: FloatArray | None = None) -> Reference:
    """Reference of poses with these positions: of their maker where he is known, else unknown, `stated` so.

    Parameters
    ----------
    positions : (K, 3) ndarray
        All positions of the file, m.
    stated : str
        One sentence on where they stand.
    seconds : (K,) ndarray, optional
        Times of the frames, s, for a truth that is known to settle later than it begins; None: the reader leaves out
        what is before.
    """
    stated_reference = known_by(positions)
    if stated_reference is None:
        return Reference("unknown", stated)
    if seconds is None or not 0 < stated_reference.first_scored < len(seconds):
        return stated_reference.reference
    return replace(stated_reference.reference, settled_at=float(seconds[stated_reference.first_scored]))


_KITTI = Reference(
    "ins",
    "KITTI's ground truth, to about 0.1 m where RTK held, noisier from frame to frame.",
    position_jitter=1.5e-3,
    rotation_jitter=1.5e-4,
)


def _kitti(fault: str, first_scored: int) -> KnownRecording:
    return KnownRecording(replace(_KITTI, description=f"{_KITTI.description} {fault}"), first_scored)


_KITTI_00 = _kitti("Before frame 16 it is extrapolated, and wrong.", 16)
_KITTI_06 = _kitti("It is still settling in frames 0 to 10.", 12)
_EUROC = {"position_jitter": 1e-3, "rotation_jitter": 2.7e-3}
_MH = KnownRecording(Reference("surveyed", "EuRoC's ground truth: laser tracker, smoothed with the IMU.", **_EUROC))
_V1 = KnownRecording(Reference("surveyed", "EuRoC's ground truth: motion capture, smoothed with the IMU.", **_EUROC))
_TUM_VI = KnownRecording(
    Reference(
        "surveyed", "TUM-VI's ground truth: motion capture at 120 Hz.", position_jitter=1e-4, rotation_jitter=8e-4
    )
)
_TARTANAIR = KnownRecording(Reference("simulation", "TartanAir's exact poses."))
_STARRY = KnownRecording(
    Reference("surveyed", "Motion capture; its own errors are about 0.01 m and 0.01 to 0.03 rad."), 100
)

KNOWN: Mapping[str, KnownRecording] = {
    # KITTI odometry 00 and its first 154 frames, 02, 04, 05, 06 and its first 51 frames, 07, 08, 09
    "2aa0802b38daae4891ec12fa9d918e1a7fcb07153c9dfb154536874da89be537": _KITTI_00,
    "2474372456f577c9fe08a4783e224f54a6733b884caeddd9dd3dc5a82d3e1acb": _KITTI_00,
    "3b9772e63ea1528529494b196b95b93925be8c830925d7f2b3b86f3f15ddf502": KnownRecording(_KITTI),
    "fd75ac16228d78c2880713cbdb30f31cec797f6405fe56b91469fe4fca2113f0": KnownRecording(_KITTI),
    "482766cae61aad44b7cd0bcbc56a829fcd620022e9793c1fd0322d43cf21400f": KnownRecording(_KITTI),
    "3d5edf6ea98f965b07d2097b2d8c5291b0e41bd9122013d3b038e1bf67dc8d7e": _KITTI_06,
    "9f9f22b2fa548f9812fb41a1ce9562c69363bee041d051bb6bfbc1c5c7ca5a19": _KITTI_06,
    "72bc2540c3a9fc7c4dd95aa948a0b55bccdeca83e98d7063331e6009f910ab79": KnownRecording(_KITTI),
    "e8baea8bf77f25413f29722c2d48060f1b56e8395512853146023b4d64a389b7": KnownRecording(_KITTI),
    "0d12d9fca49a2a5227e5796397926c3020336afc44e7a2d8b39ef3e382400d1c": KnownRecording(_KITTI),
    # EuRoC MH_03, MH_04, V1_02
    "464e4e0b30798b052a111a1b18f231965f71b78bf315ee8ca52ae67f24669958": _MH,
    "dc82ffc66aa6e0227feb7619cbac895247137cfa3b82a7ac62966397bc806d29": _MH,
    "0920b770cacf2cae627c80814ac33d7758ebb7a7ada849a06b05e709d604f41d": _V1,
    # TUM-VI room1, 512 x 512, 16 bit
    "44fd5b71c165adf7ee474a3163f184e4208a8a78778342476f130d9cf20ca391": _TUM_VI,
    # TartanAir V2, the drive whose first pairs are the test clip of MAC-VO
    "b62f08847edca1d0ccba8abf1c63fb5f87b9a7e0884f37e9319502da6a4d3c0a": _TARTANAIR,
    # Starry Night, steps 0 to 1199
    "e7e9606fe34ecf117df3110c7609a39f3ec579fb69c36279617ebe7b5cdc7772": _STARRY,
}
