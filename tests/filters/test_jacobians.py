"""Every analytic Jacobian of the package against finite differences, by one test over a table of cases.

A case is a function of a perturbation (in the coordinates of the error state) and the Jacobian claimed at zero. Every
case is run in every situation: ordinary ones, and those near the singularities of the parametrisations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from filters.engine.error_definition import ERRORS
from filters.engine.retraction import RETRACTIONS
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, ConstantVelocity, Start, StereoEKF, StereoObservation, VelocityDriven, rotations
from filters.engine.options import LANDMARKS, MEASUREMENTS
from filters.landmarks.hybrid import Hybrid
from filters.motions.model import CameraState
from filters.state.joint_state import JointState

from .drives import ODD_CAMERA as CAMERA
from .drives import StereoNoise
from .numeric import numeric_jacobian, relative_difference

COUNT = 4
TOLERANCE = 1e-7


@dataclass(frozen=True)
class Situation:
    """A pose with its motion, and measurements of landmarks: what the Jacobians are evaluated at."""

    camera: CameraState
    dt: float
    uvd: np.ndarray
    anchor_offset: np.ndarray
    delta: np.ndarray
    step: float = 1e-5

    @property
    def points_c(self) -> np.ndarray:
        return CAMERA.backproject(self.uvd)


def _unit(rng: np.random.Generator) -> np.ndarray:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def ordinary(rng: np.random.Generator) -> Situation:
    camera = CameraState(
        rng.uniform(-20, 20, 3),
        Rotation.random(rng=rng).as_quat(),
        rng.uniform(-6, 6, 3),
        rng.uniform(-0.8, 0.8, 3),
    )
    uvd = rng.uniform([100.0, 50.0, 2.0], [1200.0, 380.0, 40.0], (COUNT, 3))
    return Situation(camera, 0.1, uvd, rng.uniform(-2, 2, (COUNT, 3)), 0.5 * rng.uniform(0.1, 1) * _unit(rng))


def steep(rng: np.random.Generator) -> Situation:
    """Rays within 1e-3 of the vertical of W, phi near +-90 degrees: the azimuth is nearly undefined."""
    upright = Rotation.from_rotvec([rng.choice([-1, 1]) * np.pi / 2, 0.0, 0.0])
    orientation = Rotation.from_rotvec([0.0, rng.uniform(-3, 3), 0.0]) * upright
    offset = rng.uniform(1e-4, 7e-4, (COUNT, 2)) * rng.choice([-1, 1], (COUNT, 2))
    base = ordinary(rng)
    uvd = base.uvd.copy()
    uvd[:, :2] = [CAMERA.cx, CAMERA.cy] + offset * [CAMERA.fx, CAMERA.fy]
    return replace(base, camera=replace(base.camera, orientation=orientation.as_quat()), uvd=uvd, step=1e-6)


def at_infinity(rng: np.random.Generator) -> Situation:
    """No disparity, or next to none."""
    base = ordinary(rng)
    uvd = base.uvd.copy()
    uvd[:, 2] = [0.0, 1e-9, -1e-9, 1e-4]
    return replace(base, uvd=uvd)


def beyond_infinity(rng: np.random.Generator) -> Situation:
    """Disparities below zero."""
    base = ordinary(rng)
    uvd = base.uvd.copy()
    uvd[:, 2] *= -0.2
    return replace(base, uvd=uvd)


def steep_at_infinity(rng: np.random.Generator) -> Situation:
    """Both at once: vertical rays of landmarks at, before and beyond infinity."""
    base = steep(rng)
    uvd = base.uvd.copy()
    uvd[:, 2] = [0.0, 1e-9, -1e-4, -5.0]
    return replace(base, uvd=uvd)


def half_turn(rng: np.random.Generator) -> Situation:
    """Orientation, turn of the step and correction all near pi."""
    base = ordinary(rng)
    angles = np.pi - rng.uniform(0.0, 1e-3, 2)
    camera = replace(
        base.camera,
        orientation=Rotation.from_rotvec(angles[0] * _unit(rng)).as_quat(),
        angular_velocity=angles[1] * _unit(rng) / base.dt,
    )
    # The correction itself stays 0.01 short of pi, where the logarithm has its cut.
    return replace(base, camera=camera, delta=(np.pi - 0.01) * _unit(rng))


def tiny_turn(rng: np.random.Generator) -> Situation:
    """Turns and corrections of 1e-9 to 1e-4 rad, across the switch from the series to the closed form."""
    base = ordinary(rng)
    sizes = 10 ** rng.uniform(-9, -4, 2)
    camera = replace(base.camera, angular_velocity=sizes[0] * _unit(rng) / base.dt)
    return replace(base, camera=camera, delta=sizes[1] * _unit(rng))


def no_turn(rng: np.random.Generator) -> Situation:
    base = ordinary(rng)
    camera = replace(base.camera, angular_velocity=np.zeros(3), linear_velocity=np.zeros(3))
    return replace(base, camera=camera, delta=np.zeros(3))


SITUATIONS = (ordinary, steep, at_infinity, beyond_infinity, steep_at_infinity, half_turn, tiny_turn, no_turn)
FINITE_POINTS = (ordinary, steep, half_turn, tiny_turn, no_turn)
EUCLIDEAN = (ordinary, half_turn, tiny_turn, no_turn)


@dataclass(frozen=True)
class Case:
    """A function on a manifold with the Jacobian claimed for it; `prepare` gives both."""

    name: str
    prepare: Callable[[Situation], tuple[Callable[[np.ndarray], np.ndarray], np.ndarray]]
    situations: tuple[Callable[[np.random.Generator], Situation], ...] = SITUATIONS
    seeds: int = 3


CASES: list[Case] = []


def case(name: str, situations: tuple = SITUATIONS, seeds: int = 3) -> Callable:
    def register(prepare: Callable) -> Callable:
        CASES.append(Case(name, prepare, situations, seeds))
        return prepare

    return register


def turned(camera: CameraState, delta: np.ndarray) -> np.ndarray:
    """R_wc after a rotation error on the right, independently of the package."""
    return Rotation.from_quat(camera.orientation).as_matrix() @ Rotation.from_rotvec(delta).as_matrix()


def moved(camera: CameraState, error: np.ndarray) -> CameraState:
    """The camera state with 12 error numbers applied."""
    orientation = Rotation.from_quat(camera.orientation) * Rotation.from_rotvec(error[3:6])
    return CameraState(
        camera.position + error[:3],
        orientation.as_quat(),
        camera.linear_velocity + error[6:9],
        camera.angular_velocity + error[9:],
    )


def difference(reference: CameraState, other: CameraState) -> np.ndarray:
    """The 12 error numbers between two camera states."""
    rotation = Rotation.from_quat(reference.orientation).inv() * Rotation.from_quat(other.orientation)
    return np.concatenate(
        [
            other.position - reference.position,
            rotation.as_rotvec(),
            other.linear_velocity - reference.linear_velocity,
            other.angular_velocity - reference.angular_velocity,
        ]
    )


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
    return (
        lambda e: CAMERA.project_scaled(rays + e[:3], scales + e[3]),
        CAMERA.project_scaled_jacobian(rays, scales),
    )


# --- rotations and error definitions --------------------------------------------------------------------------


@case("rotations.right_jacobian")
def _(s: Situation):
    here = Rotation.from_rotvec(s.delta).inv()
    return lambda e: (here * Rotation.from_rotvec(s.delta + e)).as_rotvec(), rotations.right_jacobian(s.delta)


@case("rotations.right_jacobian of the turn of a step")
def _(s: Situation):
    turn = s.dt * s.camera.angular_velocity
    here = Rotation.from_rotvec(turn).inv()
    return lambda e: (here * Rotation.from_rotvec(turn + e)).as_rotvec(), rotations.right_jacobian(turn)


for _name, _error in RETRACTIONS.items():

    @case(f"{_name}: transport")
    def _(s: Situation, error=_error):
        q = s.camera.orientation
        here = error.retract(q, s.delta)
        return lambda e: error.local(here, error.retract(q, s.delta + e)), error.transport(s.delta)

    @case(f"{_name}: the error is the rotation vector to first order")
    def _(s: Situation, error=_error):
        q = s.camera.orientation
        R = Rotation.from_quat(q)
        return lambda e: (R.inv() * Rotation.from_quat(error.retract(q, e))).as_rotvec(), np.eye(3)

    @case(f"{_name}: local is the inverse of retract")
    def _(s: Situation, error=_error):
        q = s.camera.orientation
        return lambda e: error.local(q, error.retract(q, s.delta + e)), np.eye(3)


# --- motion ---------------------------------------------------------------------------------------------------


@case("ConstantVelocity F")
def _(s: Situation):
    model = ConstantVelocity()
    predicted = model.predict(s.camera, s.dt, None)
    return (
        lambda e: difference(predicted.state, model.predict(moved(s.camera, e), s.dt, None).state),
        predicted.F,
    )


@case("ConstantVelocity G")
def _(s: Situation):
    model = ConstantVelocity()
    predicted = model.predict(s.camera, s.dt, None)

    def pushed(n: np.ndarray) -> np.ndarray:
        """Eq. 6: the impulses (V, Omega) act before the step."""
        error = np.concatenate([np.zeros(6), n])
        return difference(predicted.state, model.predict(moved(s.camera, error), s.dt, None).state)

    return pushed, predicted.G


@case("ConstantVelocity odometry H")
def _(s: Situation):
    model, still = ConstantVelocity(), BodyVelocity(np.zeros(3), np.zeros(3), np.eye(6))

    def expected(e: np.ndarray) -> np.ndarray:
        return -model.odometry_measurement(moved(s.camera, e), s.dt, still).innovation

    return expected, model.odometry_measurement(s.camera, s.dt, still).H


def _odometry(s: Situation, error: np.ndarray) -> BodyVelocity:
    linear = s.camera.linear_velocity + error[:3]
    return BodyVelocity(linear, s.camera.angular_velocity + error[3:], np.eye(6))


@case("VelocityDriven F")
def _(s: Situation):
    model, odometry = VelocityDriven(), _odometry(s, np.zeros(6))
    predicted = model.predict(s.camera, s.dt, odometry)
    return (
        lambda e: difference(predicted.state, model.predict(moved(s.camera, e), s.dt, odometry).state),
        predicted.F,
    )


@case("VelocityDriven G")
def _(s: Situation):
    model = VelocityDriven()
    predicted = model.predict(s.camera, s.dt, _odometry(s, np.zeros(6)))
    return (
        lambda n: difference(predicted.state, model.predict(s.camera, s.dt, _odometry(s, n)).state),
        predicted.G,
    )


# --- landmarks ------------------------------------------------------------------------------------------------

for _name, _model in {**LANDMARKS, "hybrid of both": Hybrid(near_disparity=20.0)}.items():
    _situations = SITUATIONS if _model.anchored else EUCLIDEAN

    def _started(model, s: Situation):
        """Parameters of landmarks at the situation, and anchors a little away from where the camera is."""
        new = model.initialise(CAMERA, s.camera.position, s.camera.R_wc, s.uvd)
        anchors = np.where(new.anchored[:, None], s.camera.position + s.anchor_offset, np.nan)
        return new, anchors if model.anchored else None

    @case(f"{_name}: initialise by position", _situations)
    def _(s: Situation, model=_model):
        return (
            lambda e: model.initialise(CAMERA, s.camera.position + e, s.camera.R_wc, s.uvd).parameters,
            _started(model, s)[0].by_position,
        )

    @case(f"{_name}: initialise by rotation", _situations)
    def _(s: Situation, model=_model):
        return (
            lambda e: model.initialise(CAMERA, s.camera.position, turned(s.camera, e), s.uvd).parameters,
            _started(model, s)[0].by_rotation,
        )

    @case(f"{_name}: initialise by measurement", _situations)
    def _(s: Situation, model=_model):
        return (
            lambda e: model.initialise(CAMERA, s.camera.position, s.camera.R_wc, s.uvd + e).parameters,
            _started(model, s)[0].by_measurement,
        )

    @case(f"{_name}: relative_to", _situations)
    def _(s: Situation, model=_model):
        new, anchors = _started(model, s)
        claimed = model.relative_to(s.camera.position, anchors, new.parameters)

        def function(e: np.ndarray) -> np.ndarray:
            shifted = None if anchors is None else anchors + e[3:6]
            return model.homogeneous(s.camera.position + e[:3], shifted, new.parameters + e[-3:])

        return function, np.concatenate([claimed.by_position, claimed.by_map], axis=2)

    @case(f"{_name}: points", FINITE_POINTS if _model.anchored else EUCLIDEAN)
    def _(s: Situation, model=_model):
        new, anchors = _started(model, s)
        claimed = model.points(anchors, new.parameters)
        # A step in rho is a long way in metres: perturb relative to rho.
        unit = np.array([1.0, 1.0, 1e-2]) if model.anchored else np.ones(3)

        def function(e: np.ndarray) -> np.ndarray:
            shifted = None if anchors is None else anchors + e[:3]
            return model.points(shifted, new.parameters + e[-3:] * unit).positions

        return function, np.concatenate([claimed.by_map[:, :, :-3], claimed.by_map[:, :, -3:] * unit], axis=2)

    @case(f"{_name}: inverse_distances", _situations)
    def _(s: Situation, model=_model):
        new, anchors = _started(model, s)
        claimed = model.inverse_distances(s.camera.position, anchors, new.parameters)

        def function(e: np.ndarray) -> np.ndarray:
            return model.inverse_distances(s.camera.position + e[:3], anchors, new.parameters + e[3:]).values

        return function, np.concatenate([claimed.by_position, claimed.by_parameters], axis=1)


# --- the whole H of the filter, with respect to the whole error state --------------------------------------------


def _seen_state(stereo_filter: StereoEKF, s: Situation) -> JointState:
    """Two generations of landmarks in the map, the camera moved on from where it saw them."""
    stereo_filter.reset(Start(s.camera.position - s.anchor_offset[0], s.camera.orientation, covariance=np.eye(12)))
    half = COUNT // 2
    stereo_filter.update(StereoObservation(np.arange(half), s.uvd[:half]))
    state = stereo_filter.state
    state.camera = s.camera
    stereo_filter._policy.start(stereo_filter.state, StereoObservation(np.arange(half, COUNT), s.uvd[half:]))
    state.camera = replace(s.camera, position=s.camera.position + 0.5 * s.anchor_offset[1])
    return state


for _landmark in LANDMARKS:
    for _measurement in MEASUREMENTS:
        for _error in ERRORS:

            @case(
                f"H: {_landmark}, {_measurement}, {_error}",
                EUCLIDEAN if _landmark == "euclidean" else SITUATIONS,
                seeds=1,
            )
            def _(s: Situation, landmark=_landmark, measurement=_measurement, error=_error):
                stereo_filter = StereoEKF(
                    CAMERA,
                    StereoNoise.independent_pixels(1.0),
                    landmark=landmark,
                    measurement=measurement,
                    error=error,
                    drop_unseen=False,
                )
                state = _seen_state(stereo_filter, s)
                # First-estimates Jacobians are those of the state where the state is the first estimate.
                state = replace(state, predicted=state.camera, first_blocks=state.blocks)
                index = np.arange(COUNT)[::-1].copy()
                observation = StereoObservation(np.arange(COUNT), s.uvd, v_right=s.uvd[:, 1] + 0.5)
                R = np.broadcast_to(stereo_filter.noise.R, (COUNT, 3, 3))
                stages = MEASUREMENTS[measurement].stages(observation, R)

                def predicted(e: np.ndarray) -> np.ndarray:
                    other = ERRORS[error].moved(state, e)
                    parts = [-stereo_filter._linearise(other, index, stage).innovation for stage in stages]
                    return np.concatenate(parts, axis=1)

                dense = []
                for stage in stages:
                    linearised = stereo_filter._linearise(state, index, stage)
                    H = np.zeros((*linearised.innovation.shape, len(state.P)))
                    H[:, :, : linearised.by_leading.shape[2]] = linearised.by_leading
                    for row, rows in enumerate(linearised.map_rows):
                        H[row][:, rows] += linearised.by_map[row]
                    dense.append(H)
                return predicted, np.concatenate(dense, axis=1)


@pytest.mark.parametrize("named", CASES, ids=lambda named: named.name)
def test_analytic_jacobian_equals_finite_differences(named: Case) -> None:
    for situation in named.situations:
        for seed in range(named.seeds):
            s = situation(np.random.default_rng(seed))
            function, claimed = named.prepare(s)
            measured = numeric_jacobian(function, claimed.shape[-1], s.step)
            assert measured.shape == claimed.shape
            difference = relative_difference(claimed, measured)
            assert difference < TOLERANCE, f"{situation.__name__}, seed {seed}: {difference:.2g}"


def test_a_wrong_jacobian_is_found() -> None:
    """The check itself can fail: an error of 1e-6 in one entry shows."""
    s = ordinary(np.random.default_rng(0))
    wrong = CAMERA.project_jacobian(s.points_c)
    wrong[0, 0, 2] *= 1 + 1e-6
    measured = numeric_jacobian(lambda e: CAMERA.project(s.points_c + e), 3)
    assert relative_difference(wrong, measured) > TOLERANCE
