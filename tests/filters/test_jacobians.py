"""Every analytic Jacobian of camera, rotations, motions, landmarks and measurements against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, MotionModel
from filters.geometry import rotations
from filters.geometry.derivatives import columns_of
from filters.geometry.poses import AdditiveQuaternion, RotationVector
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.motion_model import CameraState

from .jacobians import (
    CAMERA,
    COUNT,
    FINITE_POINTS,
    MODELS,
    SENSORS,
    Case,
    Cases,
    Situation,
    assert_jacobian,
    difference,
    moved,
    situations_of,
    values_of,
    visible,
)
from .slots import MOTIONS
from .stranger.parts import AnchoredOnS3, OnS3
from .third_party import BiasedOdometry

CASES = Cases()
case = CASES.case


def turned(camera: CameraState, delta: np.ndarray) -> np.ndarray:
    """R_wc after a rotation error on the right, independently of the package."""
    return Rotation.from_quat(camera.orientation).as_matrix() @ Rotation.from_rotvec(delta).as_matrix()


# --- camera ---------------------------------------------------------------------------------------------------


@case("camera.project", FINITE_POINTS)
def _(s: Situation):
    return lambda e: CAMERA.project(s.points_c + e), CAMERA.project_jacobian(s.points_c)


@case("camera.project behind the camera", FINITE_POINTS)
def _(s: Situation):
    behind = -s.points_c
    return lambda e: CAMERA.project(behind + e), CAMERA.project_jacobian(behind)


@case("camera.project_scaled")
def _(s: Situation):
    rays, scales = CAMERA.ray(s.uvd), s.uvd[:, 2] / CAMERA.disparity_constant
    return (lambda e: CAMERA.project_scaled(rays + e[:3], scales + e[3]), CAMERA.project_scaled_jacobian(rays, scales))


# --- rotations and error definitions --------------------------------------------------------------------------


@case("rotations.right_jacobian")
def _(s: Situation):
    here = Rotation.from_rotvec(s.delta).inv()
    return lambda e: (here * Rotation.from_rotvec(s.delta + e)).as_rotvec(), rotations.right_jacobian(s.delta)


for _name, _error in {"quaternion": AdditiveQuaternion(), "so3": RotationVector()}.items():

    @case(f"{_name}: the error is the rotation vector to first order")
    def _(s: Situation, error=_error):
        q = s.camera.orientation
        R = Rotation.from_quat(q)
        return lambda e: (R.inv() * Rotation.from_quat(error.retract(q, e))).as_rotvec(), np.eye(3)

# --- motion ---------------------------------------------------------------------------------------------------


def _odometry(s: Situation, error: np.ndarray) -> BodyVelocity:
    linear = s.camera.linear_velocity + error[:3]
    return BodyVelocity(linear, s.camera.angular_velocity + error[3:], np.eye(6))


def pushed(model: MotionModel, camera: CameraState, s: Situation, noise: np.ndarray) -> CameraState:
    """State after a step with this noise: that of odometry, or impulses (V, Omega) before the step (Eq. 6)."""
    if model.driven:
        return model.predict(camera, s.dt, _odometry(s, noise)).state
    return model.predict(moved(camera, np.concatenate([np.zeros(6), noise])), s.dt, None).state


for _name, _motion in {**MOTIONS, "with variables": BiasedOdometry()}.items():

    @case(f"motion {_name}: F")
    def _(s: Situation, model=_motion):
        odometry, own = _odometry(s, np.zeros(6)), model.variables
        camera = replace(s.camera, variables=values_of(own))
        predicted = model.predict(camera, s.dt, odometry)

        def function(e: np.ndarray) -> np.ndarray:
            other = moved(camera, e, own)
            return difference(predicted.state, model.predict(other, s.dt, odometry).state, own)

        return function, predicted.F

    @case(f"motion {_name}: G")
    def _(s: Situation, model=_motion):
        own = model.variables
        camera = replace(s.camera, variables=values_of(own))
        predicted = model.predict(camera, s.dt, _odometry(s, np.zeros(6)))
        return lambda n: difference(predicted.state, pushed(model, camera, s, n), own), predicted.G

    if _motion.expects_odometry:

        @case(f"motion {_name}: H of odometry")
        def _(s: Situation, model=_motion):
            still, own = BodyVelocity(np.zeros(3), np.zeros(3), np.eye(6)), model.variables
            camera = replace(s.camera, variables=values_of(own))

            def expected(e: np.ndarray) -> np.ndarray:
                return -model.odometry_measurement(moved(camera, e, own), s.dt, still).innovation

            return expected, model.odometry_measurement(camera, s.dt, still).H


# --- landmarks ------------------------------------------------------------------------------------------------

NUMERICAL = {"with numerical Jacobians": OnS3(), "with numerical Jacobians, anchored": AnchoredOnS3()}

for _name, _model in {**MODELS, **NUMERICAL}.items():
    _situations, _finite = situations_of(_model), situations_of(_model, FINITE_POINTS)

    def _seen(model: LandmarkModel, s: Situation):
        """Values of landmarks of the situation, and anchors a little away from where the camera is."""
        new = model.started(s.camera.position, s.rays_w[:, :3], s.rays_w[:, 3])
        return new.parameters, s.camera.position + s.anchor_offset if model.anchored else None

    @case(f"landmark {_name}: started", _situations)
    def _(s: Situation, model=_model):
        position, h_w, scale = s.camera.position, s.rays_w[:, :3], s.rays_w[:, 3]
        new = model.started(position, h_w, scale)
        claimed = np.concatenate([new.by_position, new.by_seen], axis=2)

        def function(e: np.ndarray) -> np.ndarray:
            other = model.started(position + e[:3], h_w + e[3:6], scale + e[6])
            return columns_of(model.local_by, new.parameters, other.parameters)

        return function, claimed

    @case(f"landmark {_name}: relative_to", _situations)
    def _(s: Situation, model=_model):
        parameters, anchors = _seen(model, s)
        claimed = model.relative_to(s.camera.position, anchors, parameters)

        def function(e: np.ndarray) -> np.ndarray:
            shifted = None if anchors is None else anchors + e[3:6]
            own = columns_of(model.retract_by, parameters, _each(e[-3:]))
            return model.relative_to(s.camera.position + e[:3], shifted, own).homogeneous

        return function, np.concatenate([claimed.by_position, claimed.by_map], axis=2)

    @case(f"landmark {_name}: points", _finite)
    def _(s: Situation, model=_model):
        parameters, anchors = _seen(model, s)
        claimed = model.points(anchors, parameters).by_map
        # A small step in rho is a long way in metres: perturb each number relative to that.
        unit = 1.0 / np.maximum(1.0, np.abs(claimed).max(axis=1))

        def function(e: np.ndarray) -> np.ndarray:
            shifted = None if anchors is None else anchors + e[:3] * unit[:, :3]
            return model.points(shifted, columns_of(model.retract_by, parameters, e[-3:] * unit[:, -3:])).positions

        return function, claimed * unit[:, None]

    @case(f"landmark {_name}: inverse_distances", _situations)
    def _(s: Situation, model=_model):
        parameters, anchors = _seen(model, s)
        claimed = model.inverse_distances(s.camera.position, anchors, parameters)

        def function(e: np.ndarray) -> np.ndarray:
            other = columns_of(model.retract_by, parameters, _each(e[3:]))
            return model.inverse_distances(s.camera.position + e[:3], anchors, other).values

        return function, np.concatenate([claimed.by_position, claimed.by_parameters], axis=1)


def _each(delta: np.ndarray) -> np.ndarray:
    return np.broadcast_to(delta, (COUNT, 3))


# --- measurements ---------------------------------------------------------------------------------------------

for _name, _sensor in SENSORS.items():

    @case(f"measurement {_name}: jacobians", visible(_sensor))
    def _(s: Situation, sensor=_sensor):
        values = values_of(sensor.variables)
        claimed = sensor.jacobians(CAMERA, s.rays_c, values)

        def function(e: np.ndarray) -> np.ndarray:
            return sensor.predict(CAMERA, s.rays_c + e[:4], _corrected(sensor, values, e[4:]))

        return function, _by_all(sensor, claimed)

    @case(f"measurement {_name}: backprojection_jacobians", visible(_sensor))
    def _(s: Situation, sensor=_sensor):
        values = values_of(sensor.variables)
        z = sensor.predict(CAMERA, s.rays_c, values)[:, :3]
        claimed = sensor.backprojection_jacobians(CAMERA, z, values)

        def function(e: np.ndarray) -> np.ndarray:
            return sensor.backproject(CAMERA, z + e[:3], _corrected(sensor, values, e[3:]))

        return function, _by_all(sensor, claimed)


def _corrected(sensor: MeasurementModel, values: dict[str, np.ndarray], delta: np.ndarray) -> dict[str, np.ndarray]:
    state = CameraState(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3), values)
    return moved(state, np.concatenate([np.zeros(12), delta]), sensor.variables).variables


def _by_all(sensor: MeasurementModel, jacobians) -> np.ndarray:
    return np.concatenate([jacobians.by_point, *(jacobians.by_variable[x.name] for x in sensor.variables)], axis=2)


@pytest.mark.parametrize("named", CASES, ids=lambda named: named.name)
def test_analytic_jacobian_equals_finite_differences(named: Case) -> None:
    assert_jacobian(named)
