"""Feature tracks and odometry of data sets, and the recording made of them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from inspect import Parameter, signature
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from filters import BodyVelocity, InertialSamples, Pose, Start, StereoCamera, StereoNoise, StereoObservation
from filters.contract.validation import positive, whole_number
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.datasets.layouts import LayoutRow, known_by, reference_for
from stereo_slam_env.files.readers import Shape
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Recording

ASSUMED_SIGMA_PX = 2.0
"""Standard deviation to assume for the pixels of real tracks. Their core is sharper (0.2 to 0.6 px), but they drift:
14 % of those of KITTI 07 end more than 10 px off, and a filter that believes them diverges."""
ASSUMED_SIGMA_LINEAR, ASSUMED_SIGMA_ANGULAR = 0.5, 0.05
"""Standard deviations to assume for velocities of which nothing is said, m/s and rad/s per axis."""
ASSUMED: Mapping[str, float] = {
    "sigma_px": ASSUMED_SIGMA_PX,
    "sigma_u": ASSUMED_SIGMA_PX,
    "sigma_v": ASSUMED_SIGMA_PX,
    "sigma_d": ASSUMED_SIGMA_PX * 2**0.5,
    "sigma_linear": ASSUMED_SIGMA_LINEAR,
    "sigma_angular": ASSUMED_SIGMA_ANGULAR,
}

SPEEDS = {"sigma_linear": "sigma_linear_m_s", "sigma_angular": "sigma_angular_rad_s"}
"""Deviation of a velocity -> its name in the source of a recording."""

_log = logging.getLogger(__name__)

_STOPPED, _MOVING = 0.35, 1.5
"""A frame repeats the one before where its median step is below this share of those around it, which exceed this, px.

Of 91 such frames of KITTI 07's tracks 87 are found so with .25 px of noise, 79 with .5 px, and no other."""


@dataclass(frozen=True, eq=False)
class PointTracks:
    """Every observation of a run, flat, in any order."""

    frame: IntArray  # (n,): index of the frame of each observation
    ids: IntArray  # (n,): landmark identity
    uvd: FloatArray  # (n, 3): left pixel and disparity, px
    v_right: FloatArray | None = None  # (n,): row in the right image where it was measured on its own, px

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, keep: BoolArray | IntArray) -> PointTracks:
        """The observations at `keep` (a mask or positions)."""
        v_right = None if self.v_right is None else self.v_right[keep]
        return PointTracks(self.frame[keep], self.ids[keep], self.uvd[keep], v_right)

    def with_positive_disparity(self) -> PointTracks:
        """Without the observations of d <= 0: in real tracks those are mismatches, not far points."""
        return self.select(self.uvd[:, 2] > 0)

    def thinned(self, max_per_frame: int | None) -> PointTracks:
        """At most `max_per_frame` landmarks at a time, long tracks first; None keeps all.

        A landmark that is taken is kept until its track ends; a free place goes to the visible landmark with most
        frames still ahead of it, ties to the smaller id. The choice is deterministic and cuts no track short, but it
        looks ahead: it is a way to thin out a data set, not a front end.
        """
        if max_per_frame is None:
            return self
        whole_number("max_per_frame", max_per_frame, 1)
        values, landmark = np.unique(self.ids, return_inverse=True)
        never = np.iinfo(np.int64).max
        last = np.full(len(values), -1, dtype=np.int64)
        np.maximum.at(last, landmark, self.frame)
        joined = np.full(len(values), never, dtype=np.int64)
        for frame in np.unique(self.frame):
            places = max_per_frame - np.count_nonzero((joined < frame) & (last >= frame))
            sighted = landmark[self.frame == frame]
            waiting = sighted[joined[sighted] == never]
            best = waiting[np.lexsort((waiting, -last[waiting]))]
            joined[best[: max(places, 0)]] = frame
        return self.select(self.frame >= joined[landmark])


@dataclass(frozen=True, eq=False)
class TrackFiles:
    """Contents of the files of a recording of tracks: K frames, SI units and px."""

    positions: FloatArray  # (N, 3): all of the truth as they are stored, which tell its maker
    timestamps: FloatArray  # (K,)
    truth: Sequence[Pose | None]  # K poses
    rig: Sequence[float]  # fx, fy, cx, cy, baseline
    tracks: PointTracks
    used: PointTracks
    settings: Mapping[str, Any]  # at the end of the recording's `source`
    origin: Mapping[str, Any] = field(default_factory=dict)  # there behind the path
    velocities: tuple[FloatArray, ...] = ()  # (K, 3) linear and angular ones of the unit; R_ci, p_i of the camera on it
    samples: Sequence[InertialSamples | None] | None = None  # K
    first: int = 0  # frame that the recording begins with
    start: Start = field(default_factory=Start)
    landmarks: LandmarkTruth | None = None
    note: str = ""  # on the truth


def recording_of(
    files: TrackFiles, path: Path, name: str, truth: str, facts: Mapping[str, Any], stated: Mapping[str, Any]
) -> Recording:
    """Recording of the contents of files in `path`.

    If it is the public one, known by its positions, it has the `name` and the `facts`; a stranger's has the name of its
    folder, a reference that `truth` describes, and options that are assumed where they are not `stated`.
    """
    public = facts if known_by(files.positions) is not None else None
    sigmas, size = stated_or_assumed(path, files.tracks, public, **stated)
    speeds = {key: sigmas.pop(key) for key in SPEEDS if files.velocities}
    odometry = camera_velocities(*files.velocities, **speeds) if files.velocities else None
    if "sigma_px" in sigmas:
        noise = StereoNoise.independent_pixels(sigmas["sigma_px"])
        pixels: dict[str, Any] = {"sigma_px": float(sigmas["sigma_px"])}
    else:
        noise, pixels = StereoNoise.diagonal(**sigmas), {"sigma_uvd_px": [float(sigma) for sigma in sigmas.values()]}
    fx, fy, cx, cy, baseline = map(float, files.rig)
    reference = reference_for(files.positions, truth)
    recording = Recording(
        path.resolve().name if public is None else name,
        StereoCamera(fx, fy, cx, cy, baseline, *size),
        frames_of(files.used, files.timestamps, files.truth, odometry, files.samples),
        noise,
        files.start,
        files.landmarks,
        source={
            **{"reader": name, "path": str(path), **files.origin, **pixels},
            **{SPEEDS[key]: float(sigma) for key, sigma in speeds.items()},
            **files.settings,
        },
        truth_from=replace(reference, description=f"{reference.description} {files.note}".strip()),
    )
    return recording[files.first :]


@dataclass(frozen=True, eq=False)
class TracksRow(LayoutRow):
    """A layout of tracks that is a row of a table.

    Its reader gives `TrackFiles`. `facts` are options that its files do not hold, as they are of its public recording,
    and `arrays` the shapes of those in its archive, see `read_archive`.
    """

    facts: Mapping[str, Any]
    arrays: Mapping[str, Shape] = field(default_factory=dict)

    @property
    def read(self) -> Callable[..., Recording]:
        """Reader of recordings, with the options of `facts`, None by default, and those of the row's reader."""

        @wraps(self.reader)
        def read(path: Path, **options: Any) -> Recording:
            stated = {name: options.pop(name, None) for name in self.facts}
            return recording_of(self.reader(path, **options), path, self.NAME, self.truth, self.facts, stated)

        path, *options = signature(self.reader).parameters.values()
        of_facts = (Parameter(name, Parameter.KEYWORD_ONLY, default=None) for name in self.facts)
        vars(read)["__signature__"] = signature(self.reader).replace(parameters=[path, *of_facts, *options])
        return read


def stated_or_assumed(
    path: Path, tracks: PointTracks, facts: Mapping[str, Any] | None, **given: Any
) -> tuple[dict[str, Any], tuple[int, int]]:
    """Options that a layout does not hold, and the size of the images (width, height), px.

    What is not given (None) is taken from the `facts` of a known recording. Of a stranger's (None) it is assumed, and
    one line in the log says so: the noise is that of `ASSUMED`, the images are the smallest that hold all measurements.

    Raises
    ------
    ValueError
        `image_size` is not a pair of whole numbers >= 1.
    """
    size = given["image_size"]
    if size is not None and not (isinstance(size, Sequence) and len(size) == 2):
        raise ValueError(f"image_size must be (width, height) in px, got {size!r}")
    if size is not None:
        given["image_size"] = tuple(whole_number("image_size", length, 1) for length in size)
    unknown = [name for name, value in given.items() if value is None]
    if facts is None and unknown:
        rows = tracks.uvd[:, 1] if tracks.v_right is None else np.maximum(tracks.uvd[:, 1], tracks.v_right)
        smallest = [int(np.ceil(x.max(initial=0.0))) + 1 for x in (tracks.uvd[:, 0], rows)]
        facts = {**ASSUMED, "image_size": tuple(smallest)}
        assumed_words = ", ".join(f"{name}={facts[name]}" for name in unknown)
        _log.warning(
            "%s does not hold all that a filter must know: assumed %s; give what you know of it", path, assumed_words
        )
    facts_used = {**given, **{name: facts[name] for name in unknown}} if facts is not None else given
    return facts_used, facts_used.pop("image_size")


def tracks_of_pixels(pixels: FloatArray) -> PointTracks:
    """Observations out of u_left, v_left, u_right, v_right (4, K, N) of landmark j in frame k; -1: not seen."""
    frame, landmark = np.nonzero((pixels != -1.0).all(axis=0))
    u_left, v_left, u_right, v_right = pixels[:, frame, landmark]
    return PointTracks(frame, landmark, np.column_stack([u_left, v_left, u_left - u_right]), v_right)


def without_repeats(pixels: FloatArray) -> tuple[PointTracks, int]:
    """Observations as of `tracks_of_pixels` without frames that repeat the one before, and how many.

    A tracker that stops in a frame, to look for new points, and goes on from the old pixels in the next image follows
    another point of the scene from there on: it gets an id of its own, that of the column plus a multiple of N. A frame
    repeats the one before to the last bit, or by its motion: its points move much less than in the frames around it.
    """
    measured = (pixels != -1.0).all(axis=0)
    both = measured[1:] & measured[:-1]
    same = both & (pixels[:, 1:] == pixels[:, :-1]).all(axis=0)
    moved, some = np.where(both, np.linalg.norm(np.diff(pixels[:2], axis=1), axis=0), np.nan), both.any(axis=1)
    steps = np.zeros(len(both))
    steps[some] = np.nanmedian(moved[some], axis=1)
    around = np.minimum(steps[:-2], steps[2:])
    stopped = (same == both).all(axis=1)
    stopped[1:-1] |= (steps[1:-1] < _STOPPED * around) & (around > _MOVING)
    repeated = np.zeros(measured.shape, dtype=bool)
    repeated[1:] = both & stopped[:, None]
    tracks = tracks_of_pixels(np.where(repeated, -1.0, pixels))
    points_before = np.cumsum(repeated, axis=0)[tracks.frame, tracks.ids]
    return replace(tracks, ids=tracks.ids + measured.shape[1] * points_before), int(repeated.sum())


def frames_of(
    tracks: PointTracks,
    timestamps: FloatArray,
    truth: Sequence[Pose | None],
    odometry: Sequence[BodyVelocity | None] | None = None,
    samples: Sequence[InertialSamples | None] | None = None,
) -> tuple[Frame, ...]:
    """Frames in time order, each with its observations in ascending order of ids.

    Frame indices of the tracks refer to `timestamps` (K,), s; `truth`, `odometry` and `samples` have an entry for each
    frame, or None.
    """
    require_increasing(timestamps)
    if len(tracks) and not (tracks.frame.min() >= 0 and tracks.frame.max() < len(timestamps)):
        raise ValueError(
            f"observations refer to frames {tracks.frame.min()} to {tracks.frame.max()}, "
            f"but only 0 to {len(timestamps) - 1} exist"
        )
    order = np.lexsort((tracks.ids, tracks.frame))
    ordered = tracks.select(order)
    bounds = np.searchsorted(ordered.frame, np.arange(len(timestamps) + 1))
    frames = []
    for k, (start, end) in enumerate(pairwise(bounds)):
        v_right = None if ordered.v_right is None else ordered.v_right[start:end]
        observation = StereoObservation(ordered.ids[start:end], ordered.uvd[start:end], v_right)
        step = None if odometry is None else odometry[k]
        inertial = None if samples is None else samples[k]
        frames.append(Frame(float(timestamps[k]), observation, step, truth[k], inertial=inertial))
    return tuple(frames)


def require_increasing(timestamps: FloatArray) -> None:
    """Raise a `ValueError` that names the first of the times (K,), s, that does not follow the one before."""
    stuck = np.flatnonzero(~(np.diff(timestamps) > 0))
    if stuck.size:
        raise ValueError(
            f"timestamps must increase: frame {stuck[0] + 1} at {timestamps[stuck[0] + 1]:.6f} s does not follow "
            f"frame {stuck[0]} at {timestamps[stuck[0]]:.6f} s: sort the rows by time"
        )


def camera_velocities(
    linear_imu: FloatArray,
    angular_imu: FloatArray,
    R_ci: FloatArray,
    p_i: FloatArray,
    *,
    sigma_linear: float,
    sigma_angular: float,
    seed: int | None = None,
) -> list[BodyVelocity | None]:
    """Velocities of the left camera from those of the IMU (K, 3), m/s and rad/s; None for frame 0.

    v_c = R (v_i + w_i x p), w_c = R w_i, with the rotation R_ci (3, 3) and the camera position p_i (3,) in the IMU
    frame. Row k describes the step from frame k - 1 to k, as `Frame.odometry` does. The lever arm p couples the errors:
    their covariance is J diag(sigma_v^2 I, sigma_w^2 I) J^T with J = [[R, -R [p]x], [0, R]], for white noise of
    `sigma_linear` and `sigma_angular` per axis in the IMU frame. With a `seed` that noise is added first, for
    recordings whose truth was made from the same INS: its velocities as they are would be the truth by another name.
    """
    sigmas = positive("sigma_linear", sigma_linear), positive("sigma_angular", sigma_angular)
    if seed is not None:
        noise = np.random.default_rng(seed).standard_normal((2, len(linear_imu), 3))
        linear_imu, angular_imu = linear_imu + sigmas[0] * noise[0], angular_imu + sigmas[1] * noise[1]
    linear = (linear_imu + np.cross(angular_imu, p_i)) @ R_ci.T
    angular = angular_imu @ R_ci.T
    J = np.block([[R_ci, -R_ci @ rotations.skew(p_i)], [np.zeros((3, 3)), R_ci]])
    covariance = (J * np.repeat([sigmas[0] ** 2, sigmas[1] ** 2], 3)) @ J.T
    covariance = 0.5 * (covariance + covariance.T)
    return [None, *(BodyVelocity(v, w, covariance) for v, w in zip(linear[1:], angular[1:], strict=True))]


def step_velocities(
    timestamps: FloatArray, linear_v: FloatArray, angular_v: FloatArray, delay: float
) -> tuple[FloatArray, FloatArray]:
    """Mean velocities (K, 3) over each step, out of the readings (K, 3) in the vehicle frame; row 0, of no step, is 0.

    Found out by residuals against motion capture (steps 100 to 1199): a linear reading describes the step that begins
    with it (over 20 steps 8 to 17 mm, taken with the attitude of motion capture; the reading at the end of the step
    24 to 38 mm). The angular readings have the opposite sign of the rotation (variance of the residual 0.003 to 0.009
    after turning it, 0.06 to 0.09 (rad/s)^2 before, which is where the published `w_var` comes from), and are
    `delay` late (the same in both halves).
    """
    late = np.stack([np.interp(timestamps + delay, timestamps, column) for column in angular_v.T], axis=1)
    linear, angular = np.zeros_like(linear_v), np.zeros_like(angular_v)
    linear[1:] = linear_v[:-1]
    angular[1:] = -0.5 * (late[:-1] + late[1:])
    return linear, angular
