"""Stills and films of a drive: the map around the car, the path, the left view, consistency, in one picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from filters import rotations
from filters.validation import FloatArray
from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.files.paths import checked_file
from stereo_slam_env.loop import Moment
from stereo_slam_env.rendering.drawing import disparity_colors
from stereo_slam_env.rendering.images import Image
from stereo_slam_env.report.charts.series import heading, map_axes
from stereo_slam_env.report.charts.style import BAND, GRID, INK, MUTED, filter_colours
from stereo_slam_env.viewer.drive import Drive
from stereo_slam_env.viewer.ellipsoids import SIGMAS, ellipsoids
from stereo_slam_env.viewer.video import Recorder

SIZE_INCHES, FILM_DPI = (12.8, 7.2), 100
MOST_PICTURES = 400
"""Longer drives leave out pictures of their film evenly."""
_AROUND = (-32.0, 32.0), (-12.0, 52.0)
"""Limits of the close view, m: to the sides, and ahead."""
_POSE_DOF = 6
Progress = Callable[[int, int], None]
PNG_DPI = 160

_RC: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": GRID,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": MUTED,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlepad": 7,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.formatter.useoffset": False,
    "figure.facecolor": "none",
    "font.size": 8.5,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "path.simplify_threshold": 0.3,
    "svg.fonttype": "none",
    "svg.hashsalt": "stereo-slam",
    "text.color": INK,
    "text.parse_math": False,  # names may hold any characters, "$" too
    "xtick.color": GRID,
    "xtick.labelcolor": MUTED,
    "xtick.labelsize": 8,
    "ytick.color": GRID,
    "ytick.labelcolor": MUTED,
    "ytick.labelsize": 8,
}


def style_context() -> Any:
    """Context (or decorator) under which a figure is drawn and saved: fonts and ids are decided on saving."""
    return mpl.rc_context(_RC)


def save_png(figure: Figure, path: Path) -> None:
    """Write the figure on white."""
    with style_context():
        figure.savefig(path, format="png", dpi=PNG_DPI, facecolor="white", pil_kwargs={"compress_level": 1})


def save_still(drive: Drive, path: str | Path, frame: int | None = None, progress: Progress | None = None) -> None:
    """Write the picture of one moment as PNG.

    Parameters
    ----------
    drive : Drive
        Runs up to that moment.
    path : str or Path
        Ends in .png.
    frame : int, optional
        Counted from 0; None: the last one.
    progress : callable, optional
        Called with (frames done, frames).

    Raises
    ------
    ValueError
        Another ending, no such folder, or no such frame.
    """
    path = checked_file("picture", path, ".png")
    last = drive.frames - 1 if frame is None else frame
    if not 0 <= last < drive.frames:
        raise ValueError(f"frame must be 0 to {drive.frames - 1}, got {frame}")
    history = []
    for number, moment in enumerate(drive.moments()):
        history.append(moment)
        if progress is not None:
            progress(number + 1, last + 1)
        if number == last:
            break
    with style_context():
        save_png(DrivePicture(drive, history).at(len(history) - 1), path)


def save_film(
    drive: Drive, path: str | Path, progress: Progress | None = None, *, most_pictures: int = MOST_PICTURES
) -> None:
    """Write the drive as an mp4 film, at its own speed where no picture is left out.

    Parameters
    ----------
    drive : Drive
        Runs to its end.
    path : str or Path
        Ends in .mp4.
    progress : callable, optional
        Called with (steps done, steps): each frame is filtered, then pictures are drawn.
    most_pictures : int
        See `MOST_PICTURES`.

    Raises
    ------
    ValueError
        See `viewer.video.Recorder`.
    """
    stride = -(-drive.frames // most_pictures)
    drawn = range(0, drive.frames, stride)
    steps = drive.frames + len(drawn)
    tell = progress or (lambda done, of: None)
    with Recorder(path, 10.0) as recorder, style_context():
        history = []
        for moment in drive.moments():
            history.append(moment)
            tell(len(history), steps)
        picture = DrivePicture(drive, history)
        canvas = FigureCanvasAgg(picture.figure)
        for number, frame in enumerate(drawn):
            picture.at(frame)
            recorder.write(_pixels(canvas))
            tell(drive.frames + number + 1, steps)


class DrivePicture:
    """The drawing; `at` shows a moment. Draw and save it under `style_context`."""

    def __init__(self, drive: Drive, history: Sequence[Moment]) -> None:
        if not history:
            raise ValueError("history must hold at least one moment: the drive has none")
        self._drive, self._history = drive, history
        self._colour = filter_colours([drive.label])[drive.label]
        self._estimate = np.array([moment.pose.position for moment in history])
        self._time = np.array([moment.time for moment in history]) - history[0].time
        nowhere = np.full(3, np.nan)
        self._truth = np.array([nowhere if m.truth is None else m.truth.position for m in history])
        self.figure = Figure(figsize=SIZE_INCHES, dpi=FILM_DPI, facecolor="white")
        self._close = self.figure.add_axes((0.05, 0.075, 0.49, 0.82))
        self._track = self.figure.add_axes((0.595, 0.61, 0.385, 0.285))
        self._view = self.figure.add_axes((0.595, 0.335, 0.385, 0.2))
        self._strip = self.figure.add_axes((0.595, 0.075, 0.385, 0.17))
        self._heading = self.figure.text(0.05, 0.952, "", fontsize=11, fontweight="bold")
        self._across, self._up = 0, 2
        self._draw_path()
        self._draw_strip()

    def at(self, frame: int) -> Figure:
        """The figure at a frame of the history."""
        moment = self._history[frame]
        error = "" if moment.truth is None else f"   position error {moment.position_error:.2f} m"
        self._heading.set_text(f"{self._drive.title}   t = {self._time[frame]:.1f} s{error}")
        self._draw_close(moment, frame)
        self._draw_view(moment)
        done = slice(0, frame + 1)
        self._path.set_data(self._estimate[done, self._across], self._estimate[done, self._up])
        self._car.set_data(self._estimate[[frame], self._across], self._estimate[[frame], self._up])
        self._curve.set_data(self._time[done], self._values[done])
        self._now.set_xdata([self._time[frame]] * 2)
        return self.figure

    def _draw_path(self) -> None:
        known = np.isfinite(self._truth).all(axis=1)
        reference = self._truth[known] if known.any() else self._estimate
        self._across, self._up = map_axes(reference)
        if known.any():
            truth = self._truth[known]
            self._track.plot(truth[:, self._across], truth[:, self._up], color=INK, alpha=0.18, linewidth=5)
        (self._path,) = self._track.plot([], [], color=self._colour, linewidth=1.6)
        (self._car,) = self._track.plot([], [], "o", color=self._colour, markersize=5)
        _frame_track(self._track, reference, self._across, self._up)
        self._track.set_title("Path, truth in grey (m)" if known.any() else "Path (m)")

    def _draw_strip(self) -> None:
        """NEES where there is an independent truth, else NIS, which needs none."""
        strip = self._strip
        nees = np.array([moment.nees for moment in self._history]) / _POSE_DOF
        if np.isfinite(nees).any():
            self._values, title = nees, "Pose NEES / 6: 1 is ideal, 95 % of a consistent filter's in the band"
            low, high = (bound / _POSE_DOF for bound in mean_band(_POSE_DOF, 1))
            strip.axhspan(low, high, color=BAND, zorder=0)
        else:
            self._values = np.array(
                [m.nis / m.nis_dof if m.nis_dof else np.nan for m in (moment.report for moment in self._history)]
            )
            title = "NIS / degrees of freedom: 1 is ideal (no NEES without an independent truth)"
        self._values[0] = np.nan  # at the start nothing has been estimated
        strip.axhline(1.0, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        strip.set_title(title)
        strip.set_yscale("log")
        seen = self._values[np.isfinite(self._values) & (self._values > 0)]
        strip.set_ylim(max(0.02, 0.7 * min(seen.min(initial=1.0), 0.2)), max(4.0, 1.4 * seen.max(initial=1.0)))
        strip.set(xlabel="time (s)", xlim=(0, max(float(self._time[-1]), 1e-3)))
        _plain_log_axis(strip)
        (self._curve,) = strip.plot([], [], color=self._colour, linewidth=1.3)
        self._now = strip.axvline(0, color=INK, linewidth=0.8, alpha=0.5)

    def _draw_close(self, moment: Moment, frame: int) -> None:
        """Around the car from above, its heading up: landmarks with ellipses, true ones, path, field of view."""
        ax = self._close
        ax.clear()
        ax.set(xlim=_AROUND[0], ylim=_AROUND[1], xlabel="to the right (m)", ylabel="ahead (m)")
        ax.set_aspect("equal", adjustable="box", anchor="NW")
        to_view = _FromAbove(moment)
        if self._drive.landmarks is not None:
            true = _near(to_view(self._drive.landmarks.positions))
            ax.plot(*true.T, "x", color=MUTED, markersize=3.5, markeredgewidth=0.8, label="true landmark", alpha=0.7)
        ax.plot(*to_view(self._truth[: frame + 1]).T, color=INK, alpha=0.18, linewidth=6)
        ax.plot(*to_view(self._estimate[: frame + 1]).T, color=self._colour, linewidth=1.6)
        self._draw_landmarks(moment, to_view)
        half = np.array([self._drive.camera.cx, self._drive.camera.cx - self._drive.camera.width + 1])
        sides = -60.0 * half / self._drive.camera.fx
        ax.add_patch(Polygon([(0, 0), (sides[0], 60.0), (sides[1], 60.0)], color=self._colour, alpha=0.06, zorder=0))
        _ellipses(ax, np.zeros((1, 2)), to_view.flat(moment.pose.covariance[None, :3, :3]), INK, 0.8)
        ax.plot(0, 0, "^", color=self._colour, markersize=9, markeredgecolor="white")
        ax.set_title(f"Around the car, from above: landmarks at {SIGMAS:g} sigma")
        if ax.get_legend_handles_labels()[1]:
            ax.legend(
                loc="lower right", facecolor="white", framealpha=0.85, edgecolor="none", labelcolor=MUTED, fontsize=8
            )

    def _draw_landmarks(self, moment: Moment, to_view: _FromAbove) -> None:
        belief = moment.landmarks
        finite = np.isfinite(belief.positions).all(axis=1)
        places = to_view(belief.positions[finite])
        seen = np.isin(belief.ids[finite], moment.observation.ids)
        covariances = to_view.flat(belief.covariances[finite])
        for chosen, strength, words in ((seen, 1.0, "in view"), (~seen, 0.4, "kept in the map")):
            _ellipses(self._close, places[chosen], covariances[chosen], self._colour, 0.7 * strength)
            points = _near(places[chosen])
            if len(points):
                x, y = points.T
                label = f"landmark {words}"
                self._close.plot(x, y, "o", color=self._colour, alpha=strength, markersize=3, label=label)

    def _draw_view(self, moment: Moment) -> None:
        ax, camera, uvd = self._view, self._drive.camera, moment.observation.uvd
        ax.clear()
        ax.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), xticks=[], yticks=[])
        ax.set_aspect("equal", adjustable="box", anchor="NW")
        ax.set_facecolor("#1c2026")
        ax.scatter(uvd[:, 0], uvd[:, 1], s=14, c=disparity_colors(uvd[:, 2]) / 255.0, linewidths=0)
        ax.set_title(f"Measured in the left view: {len(uvd)} landmarks, red near, blue far")


class _FromAbove:
    """Transformation from W to the close view: right and ahead of the camera, seen along the vertical."""

    def __init__(self, moment: Moment) -> None:
        yaw = float(np.nan_to_num(heading(moment.pose.orientation[None])[0]))
        self._turn = rotations.matrix([0.0, np.sin(0.5 * yaw), 0.0, np.cos(0.5 * yaw)])[:, [0, 2]]
        self._origin = moment.pose.position

    def __call__(self, points_w: FloatArray) -> FloatArray:
        placed: FloatArray = (points_w - self._origin) @ self._turn
        return placed

    def flat(self, covariances: FloatArray) -> FloatArray:
        """Covariances (N, 3, 3) in W to (N, 2, 2)."""
        turned: FloatArray = self._turn.T @ covariances @ self._turn
        return turned


def _pixels(canvas: FigureCanvasAgg) -> Image:
    canvas.draw()  # type: ignore[no-untyped-call]
    rgba = np.asarray(canvas.buffer_rgba(), dtype=np.uint8)  # type: ignore[no-untyped-call]
    return np.ascontiguousarray(rgba[..., :3])


def _near(places: FloatArray) -> FloatArray:
    """The places inside the close view."""
    inside = [(low <= column) & (column <= high) for column, (low, high) in zip(places.T, _AROUND, strict=True)]
    return np.asarray(places[inside[0] & inside[1]], dtype=np.float64)


def _ellipses(ax: Axes, places: FloatArray, covariances: FloatArray, colour: str, alpha: float) -> None:
    shape = ellipsoids(covariances)
    if not shape.drawn.any():
        return
    sizes, axes = 2.0 * shape.half_sizes[shape.drawn], shape.axes[shape.drawn]
    angles = np.rad2deg(np.arctan2(axes[:, 1, 0], axes[:, 0, 0]))
    drawn = EllipseCollection(
        sizes[:, 0],
        sizes[:, 1],
        angles,
        units="xy",
        offsets=places[shape.drawn],
        offset_transform=ax.transData,
        facecolors="none",
        edgecolors=colour,
        linewidths=0.9,
        alpha=alpha,
    )
    ax.add_collection(drawn)


def _plain_log_axis(ax: Axes) -> None:
    """Write 0.1, 0.2, 0.5, 1 on the log axis y instead of powers of ten."""
    low, high = ax.get_ylim()
    if high < 4 * low:
        ax.yaxis.set_major_locator(MaxNLocator(5))
    else:
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 500 * low else (1.0,)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_locator(NullLocator())


def _frame_track(ax: Axes, track: FloatArray, across: int, up: int) -> None:
    """Limits around the track, equal scales; x points down when z runs across (the view is from above)."""
    ax.set_aspect("equal", adjustable="box", anchor="NW")
    if len(track):
        margin = 0.06 * float(np.ptp(track[:, [across, up]], axis=0).max()) + 0.5
        low, high = track.min(axis=0) - margin, track.max(axis=0) + margin
        ax.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]))
    if across == 2:
        ax.invert_yaxis()
