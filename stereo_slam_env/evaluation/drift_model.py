"""Drift model of an odometry: the covariance of any of its motions, from few numbers and the path that it took.

The error of a motion is the sum of three: what the two poses have each alone ("white"); independent increments, whose
variance is driven by distance, time and turn, and by the inverse number of tracks where that is given ("walk"); and a
drift per metre that lasts all the drive ("lasting"). Each has a variance for every axis of the body. Errors are carried
along the path by the adjoint, so an error of heading becomes one to the side, and every number enters a covariance
linearly. `docs/derivations/drift.md` derives it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE
from stereo_slam_env.files.folders import write_json
from stereo_slam_env.files.readers import read_json
from stereo_slam_env.recording.recording import DriftParts, adjoints, distances, drift_of
from stereo_slam_env.recording.trajectory import Trajectory

FORMAT = "stereo-slam drift model 2"
DRIVERS = ("distance", "time", "turn", "few_tracks")
"""What increments grow with, m, s, rad and 1 / tracks, in the order of the numbers."""
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_PARTS = ("white", *DRIVERS, "lasting")


@dataclass(frozen=True, eq=False)
class LengthCheck:
    """Coverage of the drives of a calibration, each left out of the fit, over windows of one length."""

    seconds: float
    """Length of the windows, s."""
    drives: int
    """That are so long."""
    windows: int
    """Of all of them; they overlap."""
    nees: float
    """Mean NEES, mean over the drives; 6 is ideal."""
    coverage: float
    """Share inside the 90 % ellipsoid, mean over the drives."""


@dataclass(frozen=True, eq=False)
class DriftModel:
    """Model of how the covariance of a motion grows; `calibrate` makes it, `claim` uses it."""

    variances: FloatArray
    """(6, 6): white, m^2 and rad^2; walk per m, per s, per rad and per inverse track; lasting, of the drift per m. By
    axis of the body: x, y, z, rotation about x, y, z. The factor is in them."""
    factor: float = 1.0
    """By which the fitted variances were multiplied, so that 90 % of the left-out windows are covered."""
    drives: tuple[str, ...] = ()
    """Names of the estimates that it was learned from."""
    coverage_error: float | None = None
    """Standard error of the mean coverage over these drives; None where there was one, and nothing was left out."""
    checks: tuple[LengthCheck, ...] = ()
    """The drives, each left out of the fit."""
    drive_range: tuple[float, float] | None = None
    """Where the mean NEES / 6 of a new drive is expected with 90 %, by how these differ; None with less than three."""

    def __post_init__(self) -> None:
        variances = np.asarray(self.variances, dtype=np.float64)
        if variances.shape != (len(_PARTS), POSE_SIZE) or not (np.isfinite(variances) & (variances >= 0.0)).all():
            raise ValueError(f"variances must be ({len(_PARTS)}, {POSE_SIZE}) finite numbers >= 0")
        if not (variances[0] > 0.0).all():
            raise ValueError("variances of what each pose has alone, white, must be > 0: no pose is exact")
        object.__setattr__(self, "variances", variances)

    def covariances(self, trajectory: Trajectory, first: IntArray, last: IntArray) -> FloatArray:
        """Covariances (W, 6, 6) of the errors Log(T^^-1 T) of the motions from `first` (W,) to `last` (W,)."""
        total = np.zeros((len(first), POSE_SIZE, POSE_SIZE))
        for variance, part in zip(self.variances.ravel(), basis(trajectory, first, last), strict=True):
            total += variance * part
        return total

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain data for JSON."""
        numbers = {
            part: dict(zip(_AXES, row, strict=True)) for part, row in zip(_PARTS, self.variances.tolist(), strict=True)
        }
        return {
            "format": FORMAT,
            "variances": numbers,
            "factor": self.factor,
            "drives": list(self.drives),
            "coverage_error": self.coverage_error,
            "checks": [vars(check) for check in self.checks],
            "drive_range": self.drive_range,
        }

    def write(self, path: str | Path) -> None:
        """Write it as JSON; the file appears complete or not at all."""
        write_json(Path(path), self.as_dict())

    @classmethod
    def read(cls, path: str | Path) -> DriftModel:
        """Read what `write` wrote.

        Raises
        ------
        ValueError
            The file is missing or holds something else: one line that names it.
        """
        path = Path(path)
        try:
            content = read_json(path)
        except FileNotFoundError as error:
            raise ValueError(f"{path} does not exist: `stereo-slam calibrate` makes a model") from error
        try:
            if content["format"] != FORMAT:
                raise ValueError(f"its format is not {FORMAT!r}")
            numbers = [[float(content["variances"][part][axis]) for axis in _AXES] for part in _PARTS]
            checks = tuple(_check_of(check) for check in content["checks"])
            doubt, spread = content["coverage_error"], content["drive_range"]
            return cls(
                np.array(numbers),
                float(content["factor"]),
                tuple(str(name) for name in content["drives"]),
                None if doubt is None else float(doubt),
                checks,
                None if spread is None else (float(spread[0]), float(spread[1])),
            )
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error
            raise ValueError(f"{path} is no drift model ({reason}): `stereo-slam calibrate` makes one") from error


def claim(trajectory: Trajectory, model: DriftModel) -> Trajectory:
    """The trajectory of an odometry with the covariances that a model says.

    Parameters
    ----------
    trajectory : Trajectory
        With times; what it claims already is left aside.
    model : DriftModel
        Learned from the same system, on drives of the same kind.

    Returns
    -------
    Trajectory
        With covariances (K, 6, 6) of each pose as seen from the first one, which is known exactly, and `drift`, from
        which the covariances of all motions follow.

    Raises
    ------
    ValueError
        The trajectory has no times, or no numbers of tracks where the model was learned with some.
    """
    _require_times(trajectory)
    if trajectory.tracks is None and model.variances[DRIVERS.index("few_tracks") + 1].any():
        raise ValueError(f"the model was learned with numbers of tracks, and {trajectory.name} has none: give both")
    rows = np.arange(len(trajectory))
    covariances = model.covariances(trajectory, np.zeros_like(rows), rows)
    covariances[0] = 0.0
    white, lasting = (tuple(model.variances[part].tolist()) for part in (0, -1))
    return replace(
        trajectory,
        covariances=covariances,
        tangent="right",
        gauge="se3",
        drift=drift_of(trajectory.positions, trajectory.orientations, DriftParts(white, lasting)),
    )


def basis(trajectory: Trajectory, first: IntArray, last: IntArray) -> Iterator[FloatArray]:
    """Contributions of the variances of a model to the covariances (W, 6, 6) of motions, in the order of the numbers.

    The errors are Log(T^^-1 T), right, of the motions from `first` (W,) to `last` (W,) of the trajectory.
    """
    positions = trajectory.positions - trajectory.positions.mean(axis=0)
    A = adjoints(positions, trajectory.orientations)
    into_last = np.linalg.inv(A[last])
    of_first = into_last @ A[first]
    units = np.eye(POSE_SIZE)
    for axis in range(POSE_SIZE):
        yield _squared(of_first[:, :, axis]) + np.outer(units[axis], units[axis])
    driven = drivers(trajectory)
    for driver in driven:
        for axis in range(POSE_SIZE):
            grown = np.cumsum(driver[:, None, None] * _squared(A[:, :, axis]), axis=0)
            yield into_last @ (grown[last] - grown[first]) @ into_last.swapaxes(1, 2)
    summed = np.cumsum(driven[0][:, None, None] * A, axis=0)
    lasting = into_last @ (summed[last] - summed[first])
    for axis in range(POSE_SIZE):
        yield _squared(lasting[:, :, axis])


def drivers(trajectory: Trajectory) -> FloatArray:
    """Contributions of the steps of a trajectory to the drivers (4, K): m, s, rad, 1 / tracks; 0 at the first pose."""
    times = _require_times(trajectory)
    R = rotations.matrix(trajectory.orientations)
    turns = np.linalg.norm(rotations.log(R[:-1].swapaxes(1, 2) @ R[1:]), axis=1)
    seconds, radians = (np.concatenate([[0.0], steps]) for steps in (np.diff(times), turns))
    few = np.zeros(len(times)) if trajectory.tracks is None else 1.0 / trajectory.tracks
    few[0] = 0.0
    return np.stack([distances(trajectory.positions), seconds, radians, few])


def _require_times(trajectory: Trajectory) -> FloatArray:
    if trajectory.timestamps is None:
        raise ValueError(f"{trajectory.name} has no times, by which a drift grows: give it as TUM, with a time a row")
    return trajectory.timestamps


def _squared(columns: FloatArray) -> FloatArray:
    """v v^T of each (K, 6)."""
    return columns[:, :, None] * columns[:, None, :]


def _check_of(content: Mapping[str, Any]) -> LengthCheck:
    return LengthCheck(
        float(content["seconds"]),
        int(content["drives"]),
        int(content["windows"]),
        float(content["nees"]),
        float(content["coverage"]),
    )
