"""Pictures and films of the active search: searched regions, matches and failed searches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.frontend.tracks import Outcome, Search, TrackedPair
from stereo_slam_env.recording.recording import GreyImage, StereoPair
from stereo_slam_env.rendering.overlay import (
    FONT,
    INK,
    PAPER,
    SUBPIXEL,
    Color,
    both_views,
    caption_bar,
    disparity_colors,
    fixed_point,
    label,
    line_scale,
)
from stereo_slam_env.rendering.pinhole import Image
from stereo_slam_env.viewer.watched_drive import Recorder

SIGMAS = 3.0
"""Size of the ellipses."""
_SMALLEST_WIDTH = 640
"""Smaller images are enlarged for the picture."""
_LARGEST_AXIS = 2000.0  # px; OpenCV's fixed-point ellipses do not take more
_FARTHEST = 1e5  # px; its fixed-point numbers are 32 bit
_FOUND: Color = (120, 235, 205)
_TO_RIGHT = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""(u, v, d) to the pixel of the right image."""


class _Mark(NamedTuple):
    words: str
    color: Color
    shape: str


_MATCHED = _Mark("matched", (120, 230, 90), "dot")
_NEW = _Mark("new", (255, 255, 255), "square")
_MARKS = {
    Outcome.NO_MATCH: _Mark("no match", (255, 214, 80), "saltire"),
    Outcome.NO_DISPARITY: _Mark("no disparity", (255, 150, 60), "plus"),
    Outcome.INCONSISTENT: _Mark("inconsistent", (255, 90, 90), "saltire"),
    Outcome.MOVING: _Mark("moving", (255, 105, 230), "ring"),
    Outcome.OUT_OF_VIEW: _Mark("out of view", (170, 176, 184), "plus"),
}
_STROKES = {
    "square": np.array([[(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)]]),
    "saltire": np.array([[(-1.0, -1.0), (1.0, 1.0)], [(-1.0, 1.0), (1.0, -1.0)]]),
    "plus": 1.2 * np.array([[(-1.0, 0.0), (1.0, 0.0)], [(0.0, -1.0), (0.0, 1.0)]]),
}


@contextmanager
def search_film(title: str, record: str | Path) -> Iterator[Callable[[StereoPair, TrackedPair], None]]:
    """A function that adds a pair and its tracks to a film, for the `watch` of the front end.

    Parameters
    ----------
    title : str
        First words of the caption.
    record : str or Path
        An mp4 file to write; it appears when it is complete.

    Raises
    ------
    ValueError
        The file cannot be written.
    """
    with Recorder(record) as recorder:
        started: list[float] = []

        def watch(pair: StereoPair, tracked: TrackedPair) -> None:
            started.append(pair.timestamp)
            caption = (title, f"pair {len(started) - 1}", f"t = {pair.timestamp - started[0]:.1f} s")
            recorder.write(search_picture(pair.left, pair.right, tracked, caption))

        yield watch


def search_picture(
    left: GreyImage, right: GreyImage, tracked: TrackedPair, caption: Sequence[str] = (), *, zoom: int | None = None
) -> Image:
    """Both views with the search ellipses (3 sigma) and the outcome of each search.

    Dots are matches, warm colours near and cold ones far. Crosses are searches that failed, coloured by the reason.
    Landmarks on moving bodies have a ring; new ones a square, and in the left view a line to their place in the
    right view, as long as the disparity.

    Parameters
    ----------
    left, right : (H, W) uint8
        The images.
    tracked : TrackedPair
        Result of the front end.
    caption : sequence of str
        Short texts for the bar at the top.
    zoom : int, optional
        Enlarge the views so many times; None makes them at least 640 px wide.

    Returns
    -------
    (H', W', 3) uint8
        RGB. Wide images one above the other, others side by side; a legend with counts below.
    """
    factor = zoom or max(1, round(_SMALLEST_WIDTH / left.shape[1]))
    canvases = tuple(_canvas(image, factor) for image in (left, right))
    for view, canvas in enumerate(canvases):
        _draw_searches(canvas, tracked.search, view, factor)
        _draw_measurements(canvas, tracked, view, factor)
        label(canvas, ("left", "right")[view])
    views = both_views(*canvases)
    width = views.shape[1]
    bars = [caption_bar(width, caption), views, _legend(width, tracked, _mark_size(canvases[0].shape[1]))]
    return np.concatenate(bars)


def _canvas(image: GreyImage, factor: int) -> Image:
    """The image in RGB, enlarged and a little darker, so that marks stand out."""
    enlarged = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR) if factor > 1 else image
    dim = cv2.convertScaleAbs(enlarged, alpha=0.82)
    return np.asarray(cv2.cvtColor(dim, cv2.COLOR_GRAY2RGB), dtype=np.uint8)


def _mark_size(width: int) -> float:
    return max(0.8, line_scale(width))


def _on_canvas(pixels: FloatArray, factor: int) -> FloatArray:
    """Integer coordinates are pixel centres, before and after enlarging."""
    return (pixels + 0.5) * factor - 0.5


def _pixels(uvd: FloatArray, view: int) -> FloatArray:
    return uvd[:, :2] if view == 0 else uvd @ _TO_RIGHT.T


def _draw_searches(canvas: Image, search: Search, view: int, factor: int) -> None:
    project = np.eye(3)[:2] if view == 0 else _TO_RIGHT
    axes, angles = _ellipses(project @ search.S @ project.T)
    expected = _on_canvas(_pixels(search.predicted, view), factor)
    # Something that was found in the left image alone has no place in the right one.
    found_pixels = _on_canvas(_pixels(search.found, view), factor)
    places = np.where(np.isfinite(found_pixels), found_pixels, expected)
    for i in np.flatnonzero(np.isfinite(expected).all(axis=1) & np.isfinite(axes).all(axis=1)):
        mark = _MARKS.get(Outcome(int(search.outcome[i])))
        color = _FOUND if mark is None else mark.color
        if (np.abs(expected[i]) <= 4 * _LARGEST_AXIS).all():
            size = _fixed(np.clip(axes[i] * factor, 1.0, _LARGEST_AXIS))
            for thickness, ink in ((3, INK), (1, color)):
                angle = float(angles[i])
                cv2.ellipse(canvas, _fixed(expected[i]), size, angle, 0, 360, ink, thickness, cv2.LINE_AA, SUBPIXEL)
        if mark is not None:
            _draw_mark(canvas, mark.shape, places[i], color)


def _draw_measurements(canvas: Image, tracked: TrackedPair, view: int, factor: int) -> None:
    uvd = tracked.observation.uvd
    pixels = _pixels(uvd, view)
    if view == 1 and tracked.observation.v_right is not None:
        pixels = np.column_stack([pixels[:, 0], tracked.observation.v_right])
    centers = _on_canvas(pixels, factor)
    colors = disparity_colors(uvd[:, 2]).tolist()
    new = np.isin(tracked.observation.ids, tracked.initialised)
    for i in np.argsort(uvd[:, 2]):  # near ones on top
        if new[i] and view == 0:
            _draw_lines(canvas, np.array([[centers[i], centers[i] - [uvd[i, 2] * factor, 0.0]]]), colors[i], (3, 1))
        _draw_mark(canvas, (_NEW if new[i] else _MATCHED).shape, centers[i], colors[i])


def _ellipses(covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Half axes (N, 2), px, and angles of the first one (N,), deg, of the `SIGMAS` ellipses of (N, 2, 2)."""
    finite = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    values, vectors = np.linalg.eigh(np.where(finite[:, None, None], covariances, 0.0))
    axes = SIGMAS * np.sqrt(np.maximum(values, 0.0))
    angles = np.rad2deg(np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0]))
    return np.where(finite[:, None], axes, np.nan), angles


def _draw_mark(canvas: Image, shape: str, center: FloatArray, color: Color, size: float | None = None) -> None:
    """A mark with a dark edge; it is as large as suits the width of the picture."""
    size = _mark_size(canvas.shape[1]) if size is None else size
    if shape in _STROKES:
        _draw_lines(canvas, center + (3.8 * size + 0.6) * _STROKES[shape], color, (4, 2))
        return
    for wider, ink in ((1, INK), (0, color)):
        dot = shape == "dot"
        radius = 3.6 * size + 0.4 + wider * (size + 0.4) if dot else 6.2 * size + 1.0
        reach, thickness = round(radius * (1 << SUBPIXEL)), -1 if dot else 2 + 3 * wider
        cv2.circle(canvas, _fixed(center), reach, ink, thickness, cv2.LINE_AA, SUBPIXEL)


def _draw_lines(canvas: Image, lines: FloatArray, color: Color, widths: tuple[int, int]) -> None:
    pixels = fixed_point(np.clip(lines, -_FARTHEST, _FARTHEST))
    for thickness, ink in zip(widths, (INK, color), strict=True):
        cv2.polylines(canvas, list(pixels), False, ink, thickness, cv2.LINE_AA, SUBPIXEL)


def _legend(width: int, tracked: TrackedPair, size: float) -> Image:
    """Symbols, words and counts, always in the same places, in as many rows as they need."""
    outcome = tracked.search.outcome
    new = int(np.isin(tracked.observation.ids, tracked.initialised).sum())
    entries = [(_MATCHED, len(tracked.observation.ids) - new), (_NEW, new)]
    entries += [(mark, int((outcome == kind).sum())) for kind, mark in _MARKS.items()]
    text, row, gap = 0.5 * size, int(28 * size), int(20 * size)
    places, x, rows = [], gap, 1
    for mark, count in entries:
        (w, _), _ = cv2.getTextSize(f"{mark.words} 888", FONT, text, 1)
        needed = gap + w + gap
        if x + needed > width and x > gap:
            x, rows = gap, rows + 1
        places.append((mark, f"{mark.words} {count}", x, rows))
        x += needed
    bar = np.full((rows * row + int(6 * size), width, 3), INK, dtype=np.uint8)
    for mark, words, x, line in places:
        middle = (line - 0.5) * row + 3 * size
        _draw_mark(bar, mark.shape, np.array([x, middle]), mark.color, size)
        at = (x + int(0.7 * gap), int(middle + 5 * size))
        cv2.putText(bar, words, at, FONT, text, PAPER, 1, cv2.LINE_AA)
    return bar


def _fixed(pixel: FloatArray) -> tuple[int, int]:
    u, v = fixed_point(np.clip(pixel, -_FARTHEST, _FARTHEST)).tolist()
    return u, v
