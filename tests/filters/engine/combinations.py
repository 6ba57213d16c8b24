"""Filters of many combinations of parts and options on short drives, and what is recorded of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from filters import (
    BodyVelocity,
    CalibratedPair,
    DepthCamera,
    LeftThenRight,
    MeasurementModel,
    RectifiedPair,
    RightInvariant,
    Stacked,
    StereoEKF,
    StereoObservation,
    UpdateReport,
)

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, Frame, drive, start
from ..slots import ERRORS, LANDMARKS, MEASUREMENTS
from ..third_party import BiasedOdometry, ShearedPair

ODOMETRY = BodyVelocity((0.0, 0.0, SPEED), (0.0, 0.2, 0.0), np.diag(np.repeat([0.3, 0.1], 3) ** 2))
OPTIONS: dict[str, dict[str, Any]] = {
    "no gate": {"gate": None},
    "tight gate": {"gate": 0.5},
    "joint test": {"consensus": True},
    "heavy tails": {"tail_dof": 4.0},
    "iterated": {"iterations": 3},
    "kept map": {"drop_unseen": False},
    "near ones only": {"min_disparity": 20.0},
    "everything": {"consensus": True, "tail_dof": 4.0, "iterations": 2, "drop_unseen": False},
}
DRIFTS = (0.4, {"pixels": (1.2, 1.0, 0.5), "gate_pixels": (0.4, 0.4, 0.2)}, {"share": 0.2, "pixels": (0.5, 0.5, 0.1)})
CALIBRATED = (
    CalibratedPair(0.25, 3e-3, 2e-3, 5e-3),
    CalibratedPair(0.25, 3e-3, 2e-3, 5e-3, considered=True),
    CalibratedPair(offset_sigma=0.25),
    CalibratedPair(0.25, 3e-3, 2e-3, 5e-3, yaw_sigma=3e-3, roll_sigma=3e-3),
)


@dataclass(frozen=True)
class Case:
    """Options of a filter, and its drive."""

    name: str
    options: dict[str, Any]
    seed: int = 1
    v_right: bool = False
    odometry: BodyVelocity | None = None
    clones: bool = False
    extra: dict[str, Any] = field(default_factory=dict)


def combinations() -> Iterator[Case]:
    """All of them."""
    for landmark, sensor, error in product(LANDMARKS, MEASUREMENTS, ERRORS):
        yield Case(f"{landmark}/{sensor}/{error}", {"landmark": landmark, "measurement": sensor, "error": error})
    for landmark, (name, options), error in product(LANDMARKS, OPTIONS.items(), ERRORS):
        yield Case(f"{landmark}/{name}/{error}", {"landmark": landmark, "error": error, **options}, 2)
    for landmark in LANDMARKS:
        yield from _of_landmark(landmark)
    yield Case("ri reset", {"landmark": "shared-anchor", "error": RightInvariant(reset=True)})
    for model, v_right in product((LeftThenRight(2.0), Stacked(2.0)), (False, True)):
        yield Case(f"copied {type(model).__name__} {v_right}", {"measurement": model}, 5, v_right)
    for landmark, sensor in product(LANDMARKS, ("joint", "sequential", "stacked", "left")):
        yield Case(f"right row/{landmark}/{sensor}", {"landmark": landmark, "measurement": sensor}, 1, True)


def _of_landmark(landmark: str) -> Iterator[Case]:
    of = {"landmark": landmark}
    linearised = ("quaternion", "so3", "right-invariant", "left-invariant")
    for error, sensor in product(linearised, ("joint", "sequential", "stacked")):
        options = {**of, "error": error, "update": "unscented", "measurement": sensor}
        yield Case(f"unscented/{landmark}/{error}/{sensor}", options, 3)
    for error, (k, drift), sensor in product(ERRORS, enumerate(DRIFTS), ("joint", "sequential", "calibrated")):
        options = {**of, "error": error, "drift": drift, "consensus": k == 1, "tail_dof": 6.0, "measurement": sensor}
        yield Case(f"drift{k}/{landmark}/{error}/{sensor}", options)
    for error in ("first-estimates", "right-invariant"):
        options = {**of, "error": error, "gauge_walk": 0.01}
        yield Case(f"gauge/{landmark}/{error}", options, odometry=ODOMETRY)
        yield Case(f"gauge,clone/{landmark}/{error}", options, odometry=ODOMETRY, clones=True)
    for error in ERRORS:
        options = {**of, "error": error}
        both = {"measurement": ShearedPair(), "motion": BiasedOdometry(), "iterations": 2}
        yield Case(f"clones/{landmark}/{error}", options, clones=True)
        yield Case(f"clones,it/{landmark}/{error}", {**options, "iterations": 2}, clones=True)
        yield Case(f"odo/{landmark}/{error}", options, odometry=ODOMETRY)
        yield Case(f"driven/{landmark}/{error}", {**options, "motion": "velocity-driven"}, odometry=ODOMETRY)
        yield Case(f"biased/{landmark}/{error}", {**options, "motion": BiasedOdometry()}, odometry=ODOMETRY)
        yield Case(f"sheared/{landmark}/{error}", {**options, "measurement": ShearedPair()})
        yield Case(f"sheared,biased/{landmark}/{error}", {**options, **both}, odometry=ODOMETRY)
        for k, pair in enumerate(CALIBRATED):
            yield Case(f"calib{k}/{landmark}/{error}", {**options, "measurement": pair}, 4)


def measured_by(sensor: MeasurementModel, frames: list[Frame]) -> list[StereoObservation]:
    """What the sensor would have measured where the pair of the drive measured (u, v, d)."""
    seen = [frame.observation for frame in frames]
    if isinstance(sensor, RectifiedPair | CalibratedPair):
        return seen
    values = {variable.name: variable.value for variable in sensor.variables}
    return [_seen_by(sensor, values, o) for o in seen]


def _seen_by(sensor: MeasurementModel, values: dict[str, np.ndarray], o: StereoObservation) -> StereoObservation:
    points_c = np.column_stack([CAMERA.ray(o.uvd), o.uvd[:, 2] / CAMERA.disparity_constant])
    numbers = sensor.predict(CAMERA, points_c, values)
    sound = np.isfinite(numbers).all(axis=1) & (o.uvd[:, 2] > 0)
    R, rng = None, np.random.default_rng(len(o))
    if isinstance(sensor, DepthCamera):
        R = np.zeros((len(o), 3, 3))
        R[:, 0, 0] = R[:, 1, 1] = 1.0
        R[:, 2, 2] = 2.0 * (CAMERA.disparity_constant / o.uvd[:, 2] ** 2) ** 2
        R = R[sound]
    right = numbers[sound, 3] + rng.standard_normal(sound.sum()) if sensor.size == 4 else None
    return StereoObservation(o.ids[sound], numbers[sound, :3], right, R)


def run_case(case: Case) -> tuple[StereoEKF, list[UpdateReport]]:
    """Drive the filter of a case."""
    frames = drive(case.seed, 12, depths=(6.0, 30.0), v_right=case.v_right)
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **{"gate": 0.99, **case.options}))
    reports = []
    for k, seen in enumerate(measured_by(slam.options.measurement, frames)):
        if k:
            slam.predict(DT, case.odometry)
        if case.clones and k in (3, 5, 8):
            slam.clone_pose(f"c{k}")
        if case.clones and k == 9:
            slam.forget_clone("c5")
        reports.append(slam.update(seen))
    return slam, reports


def figures(slam: StereoEKF, reports: list[UpdateReport], clones: bool) -> np.ndarray:
    """What is recorded: values, covariances and counts of reports; each about as large as it may be wrong."""
    pose, velocity, landmarks = slam.pose, slam.velocity, slam.landmarks
    some = slice(0, 3)
    parts = [
        *(pose.position, pose.orientation, _scaled(pose.covariance)),
        *(velocity.linear, velocity.angular, _scaled(velocity.covariance)),
        *(landmarks.positions[some].ravel() / 30.0, _scaled(landmarks.covariances[some])),
        *(landmarks.inverse_distance[some], np.log(landmarks.inverse_distance_variance[some])),
        *(slam.belief(variable.name).value for variable in slam.options.layout.variables),
        [report.nis / 100.0 for report in reports],
    ]
    if clones:
        parts += [_scaled(slam.relative_pose(name).covariance) for name in ("c3", "c8")]
    counted = ("updated", "initialised", "dropped", "gated", "rejected", "behind_camera", "failed")
    parts.append([float(sum(getattr(report, name).sum() for report in reports)) for name in counted])
    return np.concatenate([np.ravel(part) for part in parts])


def _scaled(covariances: np.ndarray) -> np.ndarray:
    """Logarithms of the standard deviations, and correlations."""
    P = np.atleast_3d(covariances.T).T
    sigmas = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    rows, columns = np.triu_indices(P.shape[1], 1)
    correlations = P[:, rows, columns] / (sigmas[:, rows] * sigmas[:, columns])
    return np.concatenate([np.log(sigmas).ravel(), correlations.ravel()])
