"""Recordings, which filters are run on, the images behind them, and the errors of an odometry.

An `ImageSequence` yields stereo pairs, the front end makes the frames of a `Recording` of them.

A file of covariances says of each pose how uncertain it is, not what it shares with the others, so of a motion between
two poses it says nothing. What an odometry claims has three parts, in the coordinates of its world, in which an error
needs no transport: increments, of which the later pose has all that the earlier one has; a part that is drawn once a
drive; and a part that each pose has alone. With the last two the covariance of every motion follows;
`docs/derivations/drift.md` derives it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from filters import BodyVelocity, InertialSamples, Pose, Start, StereoCamera, StereoNoise, StereoObservation
from filters.contract.validation import require_known
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.poses import relative_jacobian
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.recording.body_truth import BodyTruth
from stereo_slam_env.recording.filter_setup import FilterSetup

Six = tuple[float, ...]
"""A number for each axis of the body: x, y, z of the position, x, y, z of the rotation."""


@dataclass(frozen=True)
class DriftParts:
    """Two parts of the drift of an odometry, by six numbers each, as a header keeps them."""

    white: Six
    """Variances of what each pose has alone, in its body: m^2, rad^2."""
    lasting: Six
    """Variances of the drift per metre that lasts all the drive, in the body: 1, (rad/m)^2."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Errors of K poses: the part of each alone and that which lasts, in the definition of their covariances."""

    own: FloatArray
    """(K, 6, 6): covariance of what a pose has alone."""
    lasting: FloatArray
    """(K, 6, m): what lasts is this times one standard normal vector (m,), drawn once a drive."""
    parts: DriftParts | None
    """The numbers that they follow from, along the poses as they are; None where those have been moved since."""

    def rows(self, index: BoolArray | IntArray | slice) -> Drift:
        """Drift of some poses."""
        return Drift(self.own[index], self.lasting[index], self.parts)

    def through(self, J: FloatArray) -> Drift:
        """Drift of the errors J e, with J (6, 6) or (K, 6, 6)."""
        return Drift(J @ self.own @ J.swapaxes(-1, -2), J @ self.lasting, None)


def adjoints(positions: FloatArray, orientations: FloatArray) -> FloatArray:
    """Adjoints (K, 6, 6) of poses T_wb: from errors Log(T^^-1 T) in the body to errors Log(T T^^-1) in W.

    Source: Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eq. 175.
    """
    R = rotations.matrix(orientations)
    A = np.zeros((len(R), POSE_SIZE, POSE_SIZE))
    A[:, POSITION, POSITION] = A[:, ROTATION, ROTATION] = R
    A[:, POSITION, ROTATION] = rotations.skew(positions) @ R
    return A


def distances(positions: FloatArray) -> FloatArray:
    """Length of each step (K,), m; 0 of the first."""
    return np.concatenate([[0.0], np.linalg.norm(np.diff(positions, axis=0), axis=1)])


def drift_of(positions: FloatArray, orientations: FloatArray, parts: DriftParts) -> Drift:
    """The drift along poses (K,), for the error Log(T^^-1 T) in the body of motions from the first pose.

    The error of the first pose itself lasts: all motions from there have it.
    """
    A = adjoints(positions - positions[0], orientations)
    into_body = np.linalg.inv(A)
    driven = np.cumsum(distances(positions)[:, None, None] * A, axis=0)
    own_covariances = np.tile(np.diag(parts.white), (len(A), 1, 1))
    own_covariances[0] = 0.0
    of_start = np.broadcast_to(A[0] * np.sqrt(parts.white), A.shape).copy()
    of_start[0] = 0.0
    lasting = np.concatenate([driven * np.sqrt(parts.lasting), of_start], axis=2)
    return Drift(own_covariances, into_body @ lasting, parts)


@dataclass(frozen=True, eq=False)
class Velocity:
    """A true velocity of the left camera: linear (3,) in W, m/s; angular (3,) camera frame, rad/s."""

    linear: FloatArray
    angular: FloatArray


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant of a recording."""

    timestamp: float
    """Time of the images, s."""
    observation: StereoObservation
    """What the stereo sensor saw; may be empty."""
    odometry: BodyVelocity | None = None
    """Mean body velocity of the step from the previous frame to this one."""
    truth: Pose | None = None
    """True pose of the left camera in W; None where it is unknown or not to be scored."""
    truth_velocity: Velocity | None = None
    """True velocity over the step from the previous frame to this one (as in Eq. 6)."""
    head: FloatArray | None = None
    """(2,): pan and tilt of the head that carries the eyes, rad; None where they are fixed to the car."""
    inertial: InertialSamples | None = None
    """What an inertial unit measured over the step from the previous frame to this one."""
    bodies: BodyTruth | None = None
    """True moving bodies; None where no measurement is of any."""


@dataclass(frozen=True, eq=False)
class LandmarkTruth:
    """True landmark positions: ids (N,) int64 ascending, positions (N, 3) m in W."""

    ids: IntArray
    positions: FloatArray


_ERRORS = ("position_jitter", "rotation_jitter", "misalignment", "settled_at")
ReferenceKind = Literal["simulation", "surveyed", "ins", "odometry", "unknown", "none"]
_KINDS: Mapping[ReferenceKind, str] = {
    "simulation": "independent truth (simulation)",
    "surveyed": "independent truth (surveyed)",
    "ins": "independent truth (GPS/INS)",
    "odometry": "odometry from the same images",
    "unknown": "stated by the recording, origin unknown",
    "none": "none",
}
"""Kinds in words."""


@dataclass(frozen=True)
class Reference:
    """Kind and origin of the poses that estimates are compared with.

    Raises
    ------
    ValueError
        There is no such kind, or an uncertainty is negative or not finite.
    """

    kind: ReferenceKind
    """An independent truth owes nothing to the images: "simulation", "surveyed" (motion capture, laser tracker, total
    station), "ins" (GPS/INS). "odometry" from the same images (and SLAM, and structure from motion) shares their errors
    with the filters: a distance to it is no error, so it has no NEES. Poses of "unknown" origin are scored as truth,
    under the condition that no camera has a part in them, which the report says. "none": no pose is known."""
    description: str
    """Where the poses come from and how good they are, one sentence."""
    position_jitter: float = 0.0
    """Standard deviation per axis of the position error of each pose, independent from frame to frame, m."""
    rotation_jitter: float = 0.0
    """Standard deviation per axis of the rotation error of each pose, independent from frame to frame, rad."""
    misalignment: float = 0.0
    """Standard deviation per axis of the constant rotation by which the poses are of another body than the left camera,
    rad."""
    settled_at: float | None = None
    """Time of the recording, s, before which the poses are not to be scored; None: all are."""

    def __post_init__(self) -> None:
        kinds: tuple[str, ...] = get_args(ReferenceKind)
        if self.kind not in kinds:
            raise ValueError(f"kind of a reference must be one of {', '.join(map(repr, kinds))}, got {self.kind!r}")
        for name in ("position_jitter", "rotation_jitter", "misalignment"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} of a reference must be >= 0 and finite, got {getattr(self, name)!r}")
        if self.settled_at is not None and not np.isfinite(self.settled_at):
            raise ValueError(f"settled_at of a reference must be a time or None, got {self.settled_at!r}")

    def __str__(self) -> str:
        parts = {
            "jitter of {:g} mm": 1e3 * self.position_jitter,
            "jitter of {:g} mrad": 1e3 * self.rotation_jitter,
            "misalignment of {:g} mrad": 1e3 * self.misalignment,
        }
        stated = ", ".join(words.format(value) for words, value in parts.items() if value > 0)
        settled = "" if self.settled_at is None else f" It has settled at {self.settled_at:g} s: scored from there on."
        errors = f" Its stated errors: {stated}." if stated else ""
        return f"{_KINDS[self.kind]}. {self.description}{errors}{settled}"

    @property
    def is_independent(self) -> bool:
        """Whether it is known that no camera has a part in it."""
        return self.kind in ("simulation", "surveyed", "ins")

    @property
    def counts_as_truth(self) -> bool:
        """Whether a distance to it is taken for an error, which a filter's covariance is held against."""
        return self.is_independent or self.kind == "unknown"

    def stating(self, stated: Mapping[str, float | str]) -> Reference:
        """The same poses with another kind or other errors, by attribute; a `ValueError` names what is none."""
        require_known("reference has no statement", stated, ("kind", *_ERRORS))
        if (kind := stated.get("kind")) == "none":
            raise ValueError("kind 'none' of a reference cannot be stated: a recording has it that has no poses")
        for name in _ERRORS:
            if isinstance(stated.get(name), str):
                raise ValueError(f"{name} of a reference must be a number, got {stated[name]!r}")
        values: dict[str, Any] = dict(stated)
        note = "" if kind is None else " Its kind was stated for this run."
        return replace(self, **values, description=self.description + note)

    @property
    def is_exact(self) -> bool:
        """Whether no errors of the poses are stated."""
        return not (self.position_jitter or self.rotation_jitter or self.misalignment)

    def has_settled(self, timestamps: FloatArray | float) -> BoolArray:
        """Mask of the times, s, that are to be scored."""
        return np.asarray(timestamps) >= (-np.inf if self.settled_at is None else self.settled_at)

    def relative_covariance(self, first: Pose, last: Pose) -> FloatArray:
        """Covariance (6, 6) of the stated errors of the pose `last` as seen from `first`, as of `PoseBelief`.

        Both have their jitter. The misalignment X turns a motion T into X^-1 T X, which is to first order
        [[p]x ; I - R^T] x of the motion's p and R.
        """
        jitter = np.repeat(np.square([self.position_jitter, self.rotation_jitter]), 3)
        J = relative_jacobian(first, last)
        T = first.inverse() @ last
        M = np.vstack([rotations.skew(T.position), np.eye(3) - T.R_wc.T])
        covariance: FloatArray = (J * np.tile(jitter, 2)) @ J.T + self.misalignment**2 * M @ M.T
        return covariance

    def covariance(self, start: Pose, now: Pose) -> FloatArray:
        """Covariance (6, 6) of the stated errors of a pose in W, where estimates begin at the pose `start`."""
        relative = self.relative_covariance(start, now)
        turn = np.eye(6)
        turn[:3, :3] = start.R_wc
        covariance: FloatArray = turn @ relative @ turn.T
        return covariance


SIMULATION = Reference("simulation", "Exact poses of the simulation.")
GIVEN_TRUTH = Reference("unknown", "It calls its poses true and does not say where they are from.")
NO_REFERENCE = Reference("none", "No true pose is known.")


@dataclass(frozen=True, eq=False)
class Recording:
    """A measurement stream that any number of filters can be run on, identically."""

    name: str
    """Short name for tables and files."""
    camera: StereoCamera
    """The rig."""
    frames: tuple[Frame, ...] = field(repr=False)
    """In time order; the first one only initialises."""
    noise: StereoNoise
    """Noise to assume unless the scenario says otherwise."""
    start: Start = field(default_factory=Start)
    """What filters are told at the start."""
    landmarks: LandmarkTruth | None = field(default=None, repr=False)
    """True map, where known."""
    source: Mapping[str, Any] = field(default_factory=dict)
    """Everything needed to say where the stream came from (scenario, seed, file, settings); JSON-able."""
    truth_from: Reference = GIVEN_TRUTH
    """What the truth of the frames is, where they have one."""
    stated_setup: FilterSetup | None = None
    """How filters are set up for it, where its scenario or its reader says so."""

    @cached_property
    def filter_setup(self) -> FilterSetup:
        """Setup of the filters: as stated, else the usual one, with odometry only where there is any."""
        setup = self.stated_setup or FilterSetup()
        return replace(setup, use_odometry=setup.use_odometry and any(frame.odometry for frame in self.frames))

    @cached_property
    def reference(self) -> Reference:
        """Reference of the estimates: `truth_from`, or none where no frame has a truth."""
        return self.truth_from if any(frame.truth is not None for frame in self.frames) else NO_REFERENCE

    def __len__(self) -> int:
        return len(self.frames)

    def _repr_html_(self) -> str:
        from stereo_slam_env.recording import notebook_html as html

        camera, times = self.camera, np.array([frame.timestamp for frame in self.frames])
        counts = np.array([len(frame.observation) for frame in self.frames], dtype=np.float64)
        if not len(times):
            return html.heading(self.name) + html.paragraph("It has no frames.")
        rows = {
            "frames": f"{len(self)} over {times[-1] - times[0]:.4g} s",
            "rig": f"{camera.width}x{camera.height} px, f {camera.fx:.5g} px, baseline {camera.baseline:.4g} m",
            "landmarks seen": f"{counts.mean():.0f} a frame ({counts.min():.0f} to {counts.max():.0f})",
            "odometry": "yes" if any(frame.odometry is not None for frame in self.frames) else "no",
            "reference": str(self.reference),
        }
        poses = [frame.truth.position for frame in self.frames if frame.truth is not None]
        path = np.array(poses).reshape(-1, 3)
        name = "true path" if self.reference.is_independent else "path of the reference"
        above = html.lines_chart({f"{name}, from above": (path[:, 0], path[:, 2])}, "x, m", "z, m", equal=True)
        chart = html.lines_chart({"landmarks seen": (times, counts)}, "s", "landmarks")
        last = self.frames[-1].observation
        about = [f"{i}: u {u:.1f}, v {v:.1f}, d {d:.2f}" for i, (u, v, d) in zip(last.ids, last.uvd, strict=True)]
        picture = html.dots(last.uvd[:, :2], (camera.width, camera.height), about)
        return html.heading(self.name) + html.facts(rows) + above + chart + html.paragraph("Last frame:") + picture

    def __getitem__(self, frames: slice) -> Recording:
        """The recording of some frames, such as `recording[:40]`."""
        return replace(self, frames=self.frames[frames])

    def with_observations(self, observations: Iterable[StereoObservation]) -> Recording:
        """The same drive, seen differently: one observation for each frame. Bodies keep their measurements by id."""
        pairs = zip(self.frames, observations, strict=True)
        frames = tuple(replace(frame, observation=observation) for frame, observation in pairs)
        if any(frame.bodies is not None for frame in self.frames):
            body_by_id: dict[int, int] = {}
            for frame in self.frames:
                if frame.bodies is not None:
                    labels = frame.bodies.of_measurements.tolist()
                    body_by_id.update(zip(frame.observation.ids.tolist(), labels, strict=True))
            frames = tuple(_relabelled(frame, body_by_id) for frame in frames)
        return replace(self, frames=frames)


def _relabelled(frame: Frame, body_by_id: Mapping[int, int]) -> Frame:
    """Frame whose measurements are of the bodies of their ids."""
    if frame.bodies is None:
        return frame
    labels = np.array([body_by_id.get(i, -1) for i in frame.observation.ids.tolist()], dtype=np.int64)
    return replace(frame, bodies=replace(frame.bodies, of_measurements=labels))


GreyImage = NDArray[np.uint8]
"""(H, W) uint8."""


def require_frames(recording: object) -> None:
    """Refuse what is no recording, and one without frames."""
    if not isinstance(recording, Recording):
        raise ValueError(f"recording must be a Recording, as load and record give it, got {recording!r}")
    if len(recording) == 0:
        raise ValueError(f"recording {recording.name!r} has no frames")


@dataclass(frozen=True, eq=False)
class StereoPair:
    """Both images of one instant, rectified."""

    timestamp: float  # s
    left: GreyImage  # rectified, grey
    right: GreyImage
    truth: Pose | None = None  # true pose of the left camera in W
    odometry: BodyVelocity | None = None  # mean body velocity of the step from the previous pair to this one
    inertial: InertialSamples | None = None  # what an inertial unit measured over that step
    velocity: Velocity | None = None  # true velocity at that instant
    biases: FloatArray | None = None  # (6,): true biases of gyros, rad/s, and accelerometers, m/s^2, at that instant


class ImageSequence(Protocol):
    """A drive as stereo images; the images are made or read one pair at a time."""

    @property
    def name(self) -> str:
        """Short name for tables and files."""

    @property
    def camera(self) -> StereoCamera:
        """The rectified rig that all pairs were taken with."""

    @property
    def start(self) -> Start:
        """Start state that filters are given."""

    @property
    def source(self) -> Mapping[str, Any]:
        """Origin of the images; JSON-able."""

    @property
    def truth_from(self) -> Reference:
        """Reference of the pairs' poses, where they have one."""

    @property
    def skipped(self) -> Mapping[str, int]:
        """Reasons why pairs were left out, and how many; known after they have been iterated over."""

    def __len__(self) -> int:
        """Number of pairs."""

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order; may be called again."""
