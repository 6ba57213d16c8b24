"""Text files of tracks or matches that another program measured in numbered stereo pairs, and their playback.

A row a measurement: `frame, id, u, v, d`, with commas or spaces between; frames are counted from 0, u and v are pixels
of the left image whose centres are whole numbers, d is the disparity, px. The covariance that the program claims may
follow: three standard deviations `su, sv, sd`, or the upper triangle `uu, uv, ud, vv, vd, dd`, px^2. A line of these
names above the rows allows any order and other columns beside them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from filters import Forecast, StereoCamera, StereoObservation
from filters.contract.validation import first_line
from filters.geometry.arrays import FloatArray
from stereo_slam_env.files.readers import parse_table, read_text
from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.recording import GreyImage

_MEASURED = ("frame", "id", "u", "v", "d")
_SIGMAS = ("su", "sv", "sd")
_TRIANGLE = ("uu", "uv", "ud", "vv", "vd", "dd")
_UPPER = np.triu_indices(3)
_LAYOUTS: Mapping[int, Sequence[str]] = {
    len(names): names for names in (_MEASURED, _MEASURED + _SIGMAS, _MEASURED + _TRIANGLE)
}
_KNOWN = "frame, id, u, v, d, then nothing, su, sv, sd, or uu, uv, ud, vv, vd, dd"
_LARGEST_WHOLE = 2.0**53


@dataclass(eq=False)
class MeasuredTracks:
    """Measurements of another program by the number of the pair; a `FrontEnd` that plays them back."""

    path: Path
    """The file."""
    observations: Mapping[int, StereoObservation]
    """Measurements by the number of the pair, from 0."""
    claims: bool
    """Whether the program claims a covariance for each; else R is that of 1 px."""
    _next: int = field(default=0, init=False)

    def __len__(self) -> int:
        return sum(map(len, self.observations.values()))

    @property
    def pairs(self) -> int:
        """Pairs up to the last one with a measurement."""
        return max(self.observations) + 1

    def require_inside(self, camera: StereoCamera) -> None:
        """Raise a `ValueError` that names the first measurement outside the left image (u, v from -0.5 px)."""
        for frame, measured in self.observations.items():
            for axis, (name, size) in enumerate((("u", camera.width), ("v", camera.height))):
                pixels = measured.uvd[:, axis]
                if (bad := np.flatnonzero((pixels < -0.5) | (pixels > size - 0.5))).size:
                    raise ValueError(
                        f"{self.path}: {name} of id {measured.ids[bad[0]]} in frame {frame} is {pixels[bad[0]]:g}, "
                        f"outside the image of {camera.width}x{camera.height} px: give the rig of the pairs"
                    )

    def track(
        self, left: GreyImage, right: GreyImage, dt: float | None = None, forecast: Forecast | None = None
    ) -> TrackedPair:
        """Measurements of the next pair; the images are not looked at."""
        measured = self.observations.get(self._next)
        self._next += 1
        if measured is None:
            return TrackedPair(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))
        R = np.tile(np.eye(3), (len(measured), 1, 1)) if measured.R is None else measured.R
        return TrackedPair(measured.ids, measured.uvd, R)

    def reset(self) -> None:
        """Begin again at pair 0."""
        self._next = 0


def read_measured_tracks(path: Path) -> MeasuredTracks:
    """Read a file of tracks or matches.

    Raises
    ------
    ValueError
        No table of such columns, no rows, a frame or an id that is no whole number, an id twice in a frame, a
        covariance that is none: one line that names the file.
    """
    try:
        text = read_text(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path} does not exist: a file of tracks has rows of {_KNOWN}") from error
    names, columns, delimiter = _columns(path, text)
    rows = "\n".join(line for line in text.splitlines() if not _is_header(line))
    table = parse_table(path, rows, len(columns), delimiter=delimiter, only=columns)
    for column in (0, 1):
        numbers = table[:, column]
        if (bad := np.flatnonzero((numbers % 1.0 != 0.0) | (numbers < 0.0) | (numbers >= _LARGEST_WHOLE))).size:
            raise ValueError(
                f"{path}: {names[column]} must be a whole number >= 0, row {bad[0]} has {numbers[bad[0]]:g}: "
                f"write {_KNOWN}"
            )
    order = np.lexsort((table[:, 1], table[:, 0]))
    table = table[order]
    frames, starts = np.unique(table[:, 0].astype(np.int64), return_index=True)
    observations = {}
    for frame, rows_of_frame in zip(frames.tolist(), np.split(table, starts[1:]), strict=True):
        ids = rows_of_frame[:, 1].astype(np.int64)
        if (twice := np.flatnonzero(np.diff(ids) == 0)).size:
            raise ValueError(f"{path} has id {ids[twice[0]]} twice in frame {frame}: give each match an id of its own")
        try:
            observations[frame] = StereoObservation(ids, rows_of_frame[:, 2:5], R=_covariances(rows_of_frame[:, 5:]))
        except ValueError as error:
            raise ValueError(f"{path}, frame {frame}: {first_line(error)}: correct it") from error
    return MeasuredTracks(path, observations, len(names) > len(_MEASURED))


def _covariances(claims: FloatArray) -> FloatArray | None:
    """Covariances (M, 3, 3) of standard deviations (M, 3) or upper triangles (M, 6); None of nothing (M, 0)."""
    if claims.shape[1] == 0:
        return None
    R = np.zeros((len(claims), 3, 3))
    if claims.shape[1] == len(_SIGMAS):
        R[:, range(3), range(3)] = claims**2
        return R
    R[:, _UPPER[0], _UPPER[1]] = R[:, _UPPER[1], _UPPER[0]] = claims
    return R


def _columns(path: Path, text: str) -> tuple[Sequence[str], list[int], str | None]:
    """Names of the columns to read, their places, and what separates them (None: white space)."""
    header = next((line for line in text.splitlines() if _is_header(line)), None)
    first = next((line for line in text.splitlines() if _is_row(line)), "")
    delimiter = "," if "," in first else None
    count = len(first.rstrip().rstrip(",").split(delimiter))
    titles = [] if header is None else _cells(header)
    if not (titles and first):
        if count not in _LAYOUTS:
            raise ValueError(f"{path} has {f'{count} columns' if first else 'no rows'}: write {_KNOWN}")
        return _LAYOUTS[count], list(range(count)), delimiter
    if len(titles) != count:
        raise ValueError(f"{path} has {count} columns below {len(titles)} names: write {_KNOWN}")
    claimed: Sequence[str] = next((some for some in (_SIGMAS, _TRIANGLE) if set(some) <= set(titles)), ())
    if missing := [name for name in _MEASURED if name not in titles]:
        raise ValueError(f"{path} has no column {', '.join(missing)} among {', '.join(titles)[:60]}: write {_KNOWN}")
    names = [*_MEASURED, *claimed]
    return names, [titles.index(name) for name in names], delimiter


def _cells(line: str) -> list[str]:
    return line.strip().lstrip("#% ").lower().replace(",", " ").split()


def _is_row(line: str) -> bool:
    return bool(line.strip()) and line.lstrip()[0] not in "#%" and not _is_header(line)


def _is_header(line: str) -> bool:
    """Whether a line names the columns, behind a # or not."""
    return {"u", "v", "d"} <= set(_cells(line))
