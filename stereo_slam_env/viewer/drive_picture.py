"""Stills and films of a drive: the map around the car, the path, the left view, consistency, in one picture.

Needs the extra pictures (Matplotlib).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.extras import require_module
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.files.opening import checked_file
from stereo_slam_env.loop import Moment
from stereo_slam_env.rendering.overlay import disparity_colors
from stereo_slam_env.report.charts.axes import BAND, GRID, INK, MUTED, filter_colours
from stereo_slam_env.report.charts.series import heading, map_axes
from stereo_slam_env.viewer.rerun_view import SIGMAS, ellipsoids
from stereo_slam_env.viewer.watched_drive import Drive, Recorder

require_module("matplotlib", "pictures")

import matplotlib as mpl  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.collections import EllipseCollection  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.patches import Polygon  # noqa: E402
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter  # noqa: E402

SIZE_INCHES, FILM_DPI = (12.8, 7.2), 100
MOST_PICTURES = 400
"""Longer drives leave out pictures of their film evenly."""
_AROUND = (-0.615, 0.615), (-0.23, 1.0)
"""Limits of the close view by its reach ahead: to the sides, and ahead."""
_SEEN = 0.8
"""Share of the measured points that the reach takes in: a few far ones would make all else small."""
_PLACES = (
    (0.05, 0.075, 0.49, 0.82),
    (0.595, 0.61, 0.385, 0.285),
    (0.595, 0.335, 0.385, 0.2),
    (0.595, 0.075, 0.385, 0.17),
)
"""Panels: around the car, path, left view, consistency."""
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
    for moment in islice(drive.moments(), last + 1):
        history.append(moment)
        if progress is not None:
            progress(len(history), last + 1)
    with style_context():
        DrivePicture(drive, history).at(last).savefig(path, dpi=PNG_DPI, pil_kwargs={"compress_level": 1})


def save_film(
    drive: Drive, path: str | Path, progress: Progress | None = None, *, most_pictures: int = MOST_PICTURES
) -> None:
    """Write the drive as an mp4 film, at ten frames of the drive a second, also where pictures are left out.

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
        See `viewer.watched_drive.Recorder`.
    """
    drawn = range(0, drive.frames, -(-drive.frames // most_pictures))
    steps = drive.frames + len(drawn)
    tell = progress or (lambda done, of: None)
    with Recorder(path, 10.0 / drawn.step) as recorder, style_context():
        history = []
        for moment in drive.moments():
            history.append(moment)
            tell(len(history), steps)
        picture = DrivePicture(drive, history)
        canvas = FigureCanvasAgg(picture.figure)
        for number, frame in enumerate(drawn):
            picture.at(frame)
            canvas.draw()  # type: ignore[no-untyped-call]
            recorder.write(np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3]))  # type: ignore[no-untyped-call]
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
        self._reach = _reach(drive, history)
        self.figure = Figure(figsize=SIZE_INCHES, dpi=FILM_DPI, facecolor="white")
        self._panels = [self.figure.add_axes(place) for place in _PLACES]

    def at(self, frame: int) -> Figure:
        """The figure at a frame of the history."""
        moment = self._history[frame]
        error = "" if moment.truth is None else f"   position error {moment.position_error:.3g} m"
        title = f"{self._drive.title}   t = {self._time[frame]:.1f} s{error}"
        self.figure.suptitle(title, x=0.05, y=0.975, ha="left", fontsize=11, fontweight="bold")
        for panel in self._panels:
            panel.clear()
        around, path, view, strip = self._panels
        self._draw_around(around, moment, frame)
        self._draw_path(path, frame)
        self._draw_view(view, moment)
        self._draw_strip(strip, frame)
        return self.figure

    def _draw_path(self, ax: Axes, frame: int) -> None:
        known_truth = np.isfinite(self._truth).all(axis=1)
        path = self._truth[known_truth] if known_truth.any() else self._estimate
        across, up = map_axes(path)
        if known_truth.any():
            ax.plot(path[:, across], path[:, up], color=INK, alpha=0.18, linewidth=5)
        ax.plot(self._estimate[: frame + 1, across], self._estimate[: frame + 1, up], color=self._colour, linewidth=1.6)
        ax.plot(self._estimate[frame, across], self._estimate[frame, up], "o", color=self._colour, markersize=5)
        margin = 0.06 * (float(np.ptp(path[:, [across, up]], axis=0).max()) or self._reach)
        low, high = path.min(axis=0) - margin, path.max(axis=0) + margin
        ax.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]))
        ax.set_aspect("equal", adjustable="box", anchor="NW")
        if across == 2:  # the view is from above, so x points down
            ax.invert_yaxis()
        ax.set_title("Path, truth in grey (m)" if known_truth.any() else "Path (m)")

    def _draw_strip(self, ax: Axes, frame: int) -> None:
        """NEES where there is a truth, else NIS, which needs none."""
        values = np.array([moment.nees for moment in self._history]) / _POSE_DOF
        if np.isfinite(values).any():
            title = "Pose NEES / 6: 1 is ideal, 95 % of a consistent filter's in the band"
            ax.axhspan(*(bound / _POSE_DOF for bound in mean_band(_POSE_DOF, 1)), color=BAND, zorder=0)
        else:
            reports = [moment.report for moment in self._history]
            values = np.array([r.nis / r.nis_dof if r.nis_dof else np.nan for r in reports])
            title = "NIS / degrees of freedom: 1 is ideal (no NEES without a truth)"
        values[0] = np.nan  # at the start nothing has been estimated
        positive_values = values[np.isfinite(values) & (values > 0)]
        ax.axhline(1.0, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
        ax.plot(self._time[: frame + 1], values[: frame + 1], color=self._colour, linewidth=1.3)
        ax.axvline(self._time[frame], color=INK, linewidth=0.8, alpha=0.5)
        ax.set_yscale("log")
        low, high = (
            max(0.02, 0.7 * min(positive_values.min(initial=1.0), 0.2)),
            max(4.0, 1.4 * positive_values.max(initial=1.0)),
        )
        ax.set(title=title, xlabel="time (s)", xlim=(0, max(float(self._time[-1]), 1e-3)), ylim=(low, high))
        ax.yaxis.set(
            major_locator=LogLocator(subs=(1.0, 2.0, 5.0) if high < 500 * low else (1.0,)),
            major_formatter=StrMethodFormatter("{x:g}"),
            minor_locator=NullLocator(),
        )

    def _draw_around(self, ax: Axes, moment: Moment, frame: int) -> None:
        """Around the car from above, its heading up: landmarks with ellipses, true ones, path, field of view."""
        yaw = float(np.nan_to_num(heading(moment.pose.orientation[None])[0]))
        turn = rotations.exp([0.0, yaw, 0.0])[:, [0, 2]]

        def to_view(points_w: FloatArray) -> FloatArray:
            placed: FloatArray = (points_w - moment.pose.position) @ turn
            return placed

        if self._drive.landmarks is not None:
            true = to_view(self._drive.landmarks.positions)
            ax.plot(*true.T, "x", color=MUTED, markersize=3.5, markeredgewidth=0.8, label="true landmark", alpha=0.7)
        ax.plot(*to_view(self._truth[: frame + 1]).T, color=INK, alpha=0.18, linewidth=6)
        ax.plot(*to_view(self._estimate[: frame + 1]).T, color=self._colour, linewidth=1.6)
        belief = moment.landmarks
        finite = np.isfinite(belief.positions).all(axis=1)
        places, covariances = to_view(belief.positions[finite]), turn.T @ belief.covariances[finite] @ turn
        in_view = np.isin(belief.ids[finite], moment.observation.ids)
        for group, strength, words in ((in_view, 1.0, "in view"), (~in_view, 0.4, "kept in the map")):
            _ellipses(ax, places[group], covariances[group], self._colour, 0.7 * strength)
            if group.any():
                x, y = places[group].T
                ax.plot(x, y, "o", color=self._colour, alpha=strength, markersize=3, label=f"landmark {words}")
        camera = self._drive.camera
        far = 1.2 * self._reach
        sides = -far * np.array([camera.cx, camera.cx - camera.width + 1]) / camera.fx
        ax.add_patch(Polygon([(0, 0), (sides[0], far), (sides[1], far)], color=self._colour, alpha=0.06, zorder=0))
        _ellipses(ax, np.zeros((1, 2)), turn.T @ moment.pose.covariance[None, :3, :3] @ turn, INK, 0.8)
        ax.plot(0, 0, "^", color=self._colour, markersize=9, markeredgecolor="white")
        limits = self._reach * np.array(_AROUND)
        ax.set(xlim=limits[0], ylim=limits[1], xlabel="to the right (m)", ylabel="ahead (m)")
        ax.set_aspect("equal", adjustable="box", anchor="NW")
        ax.set_title(f"Around the car, from above: landmarks at {SIGMAS:g} sigma")
        if ax.get_legend_handles_labels()[1]:
            style = {"facecolor": "white", "framealpha": 0.85, "edgecolor": "none", "labelcolor": MUTED, "fontsize": 8}
            ax.legend(loc="lower right", **style)

    def _draw_view(self, ax: Axes, moment: Moment) -> None:
        camera, uvd = self._drive.camera, moment.observation.uvd
        ax.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), xticks=[], yticks=[])
        ax.set_aspect("equal", adjustable="box", anchor="NW")
        ax.set_facecolor("#1c2026")
        ax.scatter(uvd[:, 0], uvd[:, 1], s=14, c=disparity_colors(uvd[:, 2]) / 255.0, linewidths=0)
        ax.set_title(f"Measured in the left view: {len(uvd)} landmarks, red near, blue far")


def _reach(drive: Drive, history: Sequence[Moment]) -> float:
    """Reach of the close view ahead, m: as far as most measured points are, the same in all pictures of a drive."""
    disparities = np.concatenate([moment.observation.uvd[:, 2] for moment in history])
    near = np.quantile(disparities, 1.0 - _SEEN) if len(disparities) else 0.0
    camera = drive.camera
    return camera.fx * camera.baseline / float(max(near, 1.0))


def _ellipses(ax: Axes, places: FloatArray, covariances: FloatArray, colour: str, alpha: float) -> None:
    half_sizes, axes, drawn = ellipsoids(covariances)
    if drawn.any():
        sizes, angles = 2.0 * half_sizes[drawn], np.rad2deg(np.arctan2(axes[drawn, 1, 0], axes[drawn, 0, 0]))
        where = {"offsets": places[drawn], "offset_transform": ax.transData}
        style: dict[str, Any] = {"facecolors": "none", "edgecolors": colour, "linewidths": 0.9, "alpha": alpha, **where}
        ax.add_collection(EllipseCollection(sizes[:, 0], sizes[:, 1], angles, units="xy", **style))
