"""A drive in Rerun's viewer: cameras, landmarks with their ellipsoids, trajectories, consistency; live or to a file.

The entities, for a filter called NAME::

    world/landmarks, world/truth/...        the true map and the true path, where known
    world/NAME/camera/{left,right}          the cameras; left/measured: measurements in the left image
    world/NAME/{path,landmarks,ellipsoids,position}   estimates; ellipsoids at 3 sigma
    world/NAME/{bodies,velocities}          moving bodies: ellipsoids of their positions, arrows of a second's motion
    consistency/{NAME,low,high}             pose NEES / 6, and the 95 % band of a single run
    error/{NAME,NAME claims}                position error, and the 3 sigma that the filter claims, m
    map/NAME                                landmarks in the map

Time is the timeline "time", in seconds.
"""

from __future__ import annotations

import importlib
import os
import shutil
import socket
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np
from scipy.spatial.transform import Rotation

from filters.contract.extras import install_command
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.files.opening import checked_file
from stereo_slam_env.loop import Moment
from stereo_slam_env.recording.recording import LandmarkTruth
from stereo_slam_env.rendering.overlay import disparity_colors
from stereo_slam_env.rendering.pinhole import Image
from stereo_slam_env.report.charts.axes import INK, MUTED, filter_colours

SIGMAS = 3.0
"""Size of the ellipses and ellipsoids."""
LARGEST = 25.0
"""Half axis, m: what is less certain is drawn as a point alone, for its ellipse would hide everything else."""


class Ellipsoids(NamedTuple):
    """Ellipsoids of N covariances at `SIGMAS` standard deviations: half axes (N, n), m, and their directions (N, n, n).

    The directions are columns, a right-handed rotation. `drawn` (N,) says whether to draw it: the covariance is finite
    and positive semi-definite, no half axis above `LARGEST`.
    """

    half_sizes: FloatArray
    axes: FloatArray
    drawn: BoolArray

    @property
    def quaternions(self) -> FloatArray:
        """The directions in three dimensions, xyzw; (N, 4)."""
        if len(self.axes) == 0:
            return np.zeros((0, 4))
        return np.asarray(Rotation.from_matrix(self.axes).as_quat(), dtype=np.float64)


def ellipsoids(covariances: FloatArray) -> Ellipsoids:
    """Principal axes of covariances; (N, n, n) m^2, n of 2 or 3."""
    count, size = covariances.shape[:2]
    finite = np.asarray(np.isfinite(covariances).all(axis=(1, 2)), dtype=np.bool_)
    values, axes = np.zeros((count, size)), np.tile(np.eye(size), (count, 1, 1))
    values[finite], axes[finite] = np.linalg.eigh(covariances[finite])
    axes[..., 0] *= np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None]
    half_sizes = SIGMAS * np.sqrt(np.maximum(values, 0.0))
    definite = values[:, 0] >= -1e-9 * np.abs(values[:, -1])  # but for rounding
    return Ellipsoids(half_sizes, axes, finite & definite & (half_sizes[:, -1] <= LARGEST))


TIMELINE = "time"
FARTHEST = 500.0
"""Distance from the camera, m: landmarks farther off are left out, so that the scene keeps its scale."""
_BEHIND, _AHEAD = (-6.0, -12.0, -14.0), (0.0, 0.0, 12.0)
"""First viewpoint of the scene, and the point it looks at; m in W, y down."""
_POSE_DOF = 6
_EXAMPLE = "rerun+http://127.0.0.1:9876/proxy"
_SCHEMES = ("rerun", "rerun+http", "rerun+https")
_ANSWER = 5.0
"""Time in which a viewer must answer, s; Rerun itself would wait without end."""
_FLUSH = 60.0
"""Time to send or write the rest at the end, s."""


class RerunView:
    """Shows moments of filters on one drive in Rerun; use it as a context manager.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    labels : sequence of str
        Names of the filters in legends.
    save : str or Path, optional
        An .rrd file to write; `rerun FILE` opens it. Moments shown before an error stay in it.
    connect : str, optional
        Address of a viewer that runs elsewhere, such as rerun+http://127.0.0.1:9876/proxy. Without `save` and
        `connect`, a viewer is opened here.
    landmarks : LandmarkTruth, optional
        The true map.
    title : str
        Name of the recording in the viewer.

    Raises
    ------
    ImportError
        Rerun is not installed: the message says how to get it.
    ValueError
        No labels, `save` and `connect` together, a file that cannot be written, an address that is none, or a viewer to
        open without a display.
    ConnectionError
        No viewer answers at the address, or none could be opened.
    """

    def __init__(
        self,
        camera: StereoCamera,
        labels: Sequence[str],
        *,
        save: str | Path | None = None,
        connect: str | None = None,
        landmarks: LandmarkTruth | None = None,
        title: str = "stereo-slam",
    ) -> None:
        if not labels:
            raise ValueError("labels must name the filters to show, got none")
        self._rr = require_rerun()
        self._camera = camera
        self._colours = filter_colours(labels)
        self._last: dict[tuple[str, ...], FloatArray] = {}
        self._stream = self._rr.RecordingStream("stereo-slam")
        open_sink(self._stream, _layout(self._rr, list(labels)), save, connect)
        self._stream.send_recording_name(title)
        self._describe(landmarks)

    def show(self, label: str, moment: Moment, left: Image | None = None) -> None:
        """Add a moment of the filter with that label, perhaps with its left image, (H, W, 3) uint8 RGB.

        Raises
        ------
        ValueError
            The label is not among `labels`.
        """
        if label not in self._colours:
            raise ValueError(f"label must be one of {', '.join(self._colours)}, got {label!r}")
        self._stream.set_time(TIMELINE, duration=moment.time)
        self._show_camera(label, moment, left)
        self._show_map(label, moment)
        self._show_figures(label, moment)
        self._extend(("world", label, "path"), moment.pose.position, self._colours[label], 0.06)
        if moment.truth is not None:
            self._extend(("world", "truth", "path"), moment.truth.position, MUTED, 0.12)

    def close(self) -> None:
        """Send or write what is left; may be called twice.

        Raises
        ------
        ConnectionError
            The viewer went away, or the file cannot take it: what was shown is not whole.
        """
        close_sink(self._stream)

    def __enter__(self) -> RerunView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _log(self, path: tuple[str, ...], *what: Any, static: bool = False) -> None:
        self._stream.log(self._rr.new_entity_path(list(path)), *what, static=static)

    def _describe(self, landmarks: LandmarkTruth | None) -> None:
        """Log what does not change: frames, cameras, true map, style of the curves."""
        rr, camera = self._rr, self._camera
        self._log(("world",), rr.ViewCoordinates.RDF, static=True)
        if landmarks is not None:
            points = rr.Points3D(landmarks.positions, colors=[_rgb(MUTED)], radii=[0.08])
            self._log(("world", "landmarks"), points, static=True)
        for name, colour in self._colours.items():
            for side, offset in (("left", 0.0), ("right", camera.baseline)):
                path = ("world", name, "camera", side)
                self._log(path, rr.Transform3D(translation=[offset, 0.0, 0.0]), static=True)
                pinhole = rr.Pinhole(
                    image_from_camera=[[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]],
                    resolution=[camera.width, camera.height],
                    camera_xyz=rr.ViewCoordinates.RDF,
                    image_plane_distance=1.5,
                )
                self._log(path, pinhole, static=True)
            self._style(("consistency", name), name, colour, 1.5)
            self._style(("error", name), name, colour, 1.5)
            self._style(("error", f"{name} claims"), f"{name}, 3 sigma claimed", colour, 0.7)
            self._style(("map", name), name, colour, 1.5)
        for bound in ("low", "high"):
            self._style(("consistency", bound), f"95 % band, {bound}", MUTED, 0.7)

    def _style(self, path: tuple[str, ...], name: str, colour: str, width: float) -> None:
        self._log(path, self._rr.SeriesLines(colors=[_rgb(colour)], names=[name], widths=[width]), static=True)

    def _show_camera(self, label: str, moment: Moment, left: Image | None) -> None:
        rr, pose = self._rr, moment.pose
        self._log(
            ("world", label, "camera"),
            rr.Transform3D(translation=pose.position, quaternion=rr.Quaternion(xyzw=pose.orientation)),
        )
        uvd = moment.observation.uvd
        # Rerun puts the centre of a pixel at half numbers.
        points = rr.Points2D(uvd[:, :2] + 0.5, colors=disparity_colors(uvd[:, 2]), radii=[3.0])
        self._log(("world", label, "camera", "left", "measured"), points)
        if left is not None:
            self._log(("world", label, "camera", "left"), rr.Image(left).compress(jpeg_quality=85))
        self._ellipsoids(("world", label, "position"), pose.position[None], pose.covariance[None, :3, :3], INK)

    def _show_map(self, label: str, moment: Moment) -> None:
        colour, belief = self._colours[label], moment.landmarks
        with np.errstate(invalid="ignore"):
            near = np.linalg.norm(belief.positions - moment.pose.position, axis=1) < FARTHEST  # not where NaN, infinite
        positions = belief.positions[near]
        points = self._rr.Points3D(positions, colors=[_rgb(colour)], radii=[0.12])
        self._log(("world", label, "landmarks"), points)
        self._ellipsoids(("world", label, "ellipsoids"), positions, belief.covariances[near], colour)
        if (bodies := moment.bodies) is not None:
            self._ellipsoids(("world", label, "bodies"), bodies.positions, bodies.covariances[:, :3, :3], INK)
            arrows = self._rr.Arrows3D(origins=bodies.positions, vectors=bodies.linear, colors=[_rgb(colour)])
            self._log(("world", label, "velocities"), arrows)

    def _ellipsoids(self, path: tuple[str, ...], centers: FloatArray, covariances: FloatArray, colour: str) -> None:
        shape = ellipsoids(covariances)
        what = self._rr.Ellipsoids3D(
            centers=centers[shape.drawn],
            half_sizes=shape.half_sizes[shape.drawn],
            quaternions=shape.quaternions[shape.drawn],
            colors=[_rgb(colour)],
            fill_mode="MajorWireframe",
        )
        self._log(path, what)

    def _show_figures(self, label: str, moment: Moment) -> None:
        rr = self._rr
        if np.isfinite(moment.nees):
            self._log(("consistency", label), rr.Scalars([moment.nees / _POSE_DOF]))
            for bound, value in zip(("low", "high"), mean_band(_POSE_DOF, 1), strict=True):
                self._log(("consistency", bound), rr.Scalars([value / _POSE_DOF]))
        if moment.truth is not None:
            self._log(("error", label), rr.Scalars([moment.position_error]))
            claimed = SIGMAS * float(np.sqrt(np.trace(moment.pose.covariance[:3, :3])))
            self._log(("error", f"{label} claims"), rr.Scalars([claimed]))
        self._log(("map", label), rr.Scalars([len(moment.landmarks.ids)]))

    def _extend(self, path: tuple[str, ...], position: FloatArray, colour: str, radius: float) -> None:
        """Log the newest piece of a path; the layout shows all pieces up to the time that is looked at."""
        before = self._last.get(path, position)
        self._last[path] = position.copy()
        self._log(path, self._rr.LineStrips3D([[before, position]], colors=[_rgb(colour)], radii=[radius]))


def _rgb(colour: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def _layout(rr: ModuleType, names: list[str]) -> Any:
    """Space at the left; the left view and the curves at the right."""
    rrb = rr.blueprint
    left = rr.new_entity_path(["world", names[0], "camera", "left"])
    until_now = rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    paths = {rr.new_entity_path(["world", name, "path"]): until_now for name in (*names, "truth")}
    behind = rrb.EyeControls3D(position=_BEHIND, look_target=_AHEAD, eye_up=[0.0, -1.0, 0.0])
    space = rrb.Spatial3DView(origin="world", name="space", overrides=paths, eye_controls=behind)
    curves = [
        rrb.TimeSeriesView(origin="consistency", name="pose NEES / 6: 1 is ideal"),
        rrb.TimeSeriesView(origin="error", name="position error, m"),
        rrb.TimeSeriesView(origin="map", name="landmarks in the map"),
    ]
    looks = rrb.Spatial2DView(origin=left, name=f"left view, {names[0]}")
    right = rrb.Vertical(looks, *curves, row_shares=[2, 2, 2, 1])
    return rrb.Blueprint(rrb.Horizontal(space, right, column_shares=[3, 2]), collapse_panels=True)


def require_rerun() -> ModuleType:
    """The package `rerun`, or an `ImportError` that says how to get it."""
    try:
        importlib.import_module("rerun.blueprint")
        return importlib.import_module("rerun")
    except ImportError as error:
        raise ImportError(f"the Rerun viewer is missing: {install_command('viewer')}") from error


def open_sink(stream: Any, layout: Any, save: str | Path | None = None, connect: str | None = None) -> None:
    """Send a recording to a file, to the viewer at an address or, without both, to a viewer opened here."""
    if save is not None and connect is not None:
        raise ValueError("save and connect exclude each other: give one of them")
    if save is not None:
        path = checked_file("file", save, ".rrd")
        stream.save(path, default_blueprint=layout)
    elif connect is not None:
        _require_answer(connect)
        with _one_line():
            stream.connect_grpc(connect, default_blueprint=layout)
    else:
        if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise ValueError("no display for Rerun's viewer here: save a file, or connect to a viewer elsewhere")
        # The viewer that came with this Python: its folder need not be on the PATH. None leaves the search to Rerun.
        viewer = shutil.which("rerun", path=sysconfig.get_path("scripts"))
        with _one_line():
            require_rerun().spawn(executable_path=viewer, recording=stream, default_blueprint=layout)


def close_sink(stream: Any) -> None:
    """Send or write what is left; may be called twice."""
    try:
        with _one_line():
            stream.flush(timeout_sec=_FLUSH)
    finally:
        stream.disconnect()


@contextmanager
def _one_line() -> Iterator[None]:
    """The first line of an error of Rerun, as a `ConnectionError`."""
    try:
        yield
    except RuntimeError as error:
        raise ConnectionError(f"Rerun's viewer: {str(error).strip().splitlines()[0]}") from error


def _require_answer(address: str) -> None:
    wrong = f"connect must be the address of a viewer, such as {_EXAMPLE}, got {address!r}"
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(wrong) from error
    if parts.scheme not in _SCHEMES or host is None or port is None or parts.path != "/proxy":
        raise ValueError(wrong)
    try:
        socket.create_connection((host, port), timeout=_ANSWER).close()
    except OSError as error:
        raise ConnectionError(
            f"no viewer answers at {address} ({error.strerror or error}): start one there, "
            "with `rerun`, or with `rerun --serve-web` for a browser"
        ) from error
