"""Every analytic Jacobian of the package against finite differences, by one test over a table of cases.

A case is a function of a perturbation (in the coordinates of the error state) and the Jacobian claimed at zero. Every
case is run in every situation: ordinary ones, and those near the singularities of the parametrisations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, Hybrid, MotionModel, StereoNoise, StereoObservation, VelocityDriven, rotations
from filters.engine.map_policy import start_landmarks
from filters.errors.invariant import RightInvariant
from filters.errors.model import ErrorDefinition
from filters.landmarks.model import LandmarkModel
from filters.measurements.model import MeasurementModel
from filters.motions.model import ANGULAR, LINEAR, POSITION, ROTATION, CameraState
from filters.retractions import AdditiveQuaternion, RotationVector
from filters.state.joint_state import JointState, NewLandmarks
from filters.state.layout import Layout
from filters.state.transport import Transport
from filters.variables import Variable

from .drives import ODD_CAMERA as CAMERA
from .engine.linear_problems import dense
from .numeric import numeric_jacobian, relative_difference
from .slots import ERRORS, LANDMARKS, MEASUREMENTS, MOTIONS, UPDATES
from .state.states import without_map
from .third_party import BiasedOdometry, ShearedPair

COUNT = 4
TOLERANCE = 1e-7
OTHER_STEPS = (1e-5, 3e-4)
ROUNDING = 1e-12
"""Of a numerical Jacobian that a part has by default, as `filters.differences` says."""


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
        """In the camera frame, m."""
        return CAMERA.backproject(self.uvd)

    @property
    def rays_c(self) -> np.ndarray:
        """The same as homogeneous points (M, 4), regular at infinity."""
        return np.column_stack([CAMERA.ray(self.uvd), self.uvd[:, 2] / CAMERA.disparity_constant])

    @property
    def rays_w(self) -> np.ndarray:
        """With directions in W."""
        return np.hstack([self.rays_c[:, :3] @ self.camera.R_wc.T, self.rays_c[:, 3:]])


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


def moved(camera: CameraState, error: np.ndarray, variables: tuple[Variable, ...] = ()) -> CameraState:
    """The camera state with the error numbers of pose, velocity and these variables applied."""
    values, row = dict(camera.variables), 12
    for variable in variables:
        values[variable.name] = variable.retraction.retract(values[variable.name], error[row : row + variable.size])
        row += variable.size
    orientation = Rotation.from_quat(camera.orientation) * Rotation.from_rotvec(error[ROTATION])
    return CameraState(
        camera.position + error[POSITION],
        orientation.as_quat(),
        camera.linear_velocity + error[LINEAR],
        camera.angular_velocity + error[ANGULAR],
        values,
    )


def difference(reference: CameraState, other: CameraState, variables: tuple[Variable, ...] = ()) -> np.ndarray:
    """The error numbers between two camera states."""
    rotation = Rotation.from_quat(reference.orientation).inv() * Rotation.from_quat(other.orientation)
    return np.concatenate(
        [
            other.position - reference.position,
            rotation.as_rotvec(),
            other.linear_velocity - reference.linear_velocity,
            other.angular_velocity - reference.angular_velocity,
            *(x.retraction.local(reference.variables[x.name], other.variables[x.name]) for x in variables),
        ]
    )


def values_of(variables: tuple[Variable, ...]) -> dict[str, np.ndarray]:
    """Values of variables at the start."""
    return {variable.name: variable.value for variable in variables}


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


@case("rotations.left_jacobian_derivative", FINITE_POINTS)
def _(s: Situation):
    vectors = s.points_c
    return (
        lambda e: vectors @ rotations.right_jacobian(-s.delta - e).T,
        rotations.left_jacobian_derivative(s.delta, vectors),
    )


for _name, _error in {"quaternion": AdditiveQuaternion(), "so3": RotationVector()}.items():

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


def _odometry(s: Situation, error: np.ndarray) -> BodyVelocity:
    linear = s.camera.linear_velocity + error[:3]
    return BodyVelocity(linear, s.camera.angular_velocity + error[3:], np.eye(6))


def pushed(model: MotionModel, camera: CameraState, s: Situation, noise: np.ndarray) -> CameraState:
    """State after a step with this noise: that of odometry, or impulses (V, Omega) before the step (Eq. 6).

    A model that has `move` says so itself; others are asked without noise.
    """
    if type(model).move is not MotionModel.move:
        return model.move(camera, s.dt, _odometry(s, np.zeros(6)), noise)
    if isinstance(model, VelocityDriven):
        return model.predict(camera, s.dt, _odometry(s, noise)).state
    return model.predict(moved(camera, np.concatenate([np.zeros(6), noise])), s.dt, None).state


for _name, _motion in {**MOTIONS, "with variables": BiasedOdometry()}.items():

    @case(f"motion {_name}: F")
    def _(s: Situation, model=_motion):
        odometry, own = _odometry(s, np.zeros(6)), model.variables
        camera = replace(s.camera, variables=values_of(own))
        predicted = model.predict(camera, s.dt, odometry)

        def function(e: np.ndarray) -> np.ndarray:
            return difference(predicted.state, model.predict(moved(camera, e, own), s.dt, odometry).state, own)

        return function, predicted.F

    @case(f"motion {_name}: G")
    def _(s: Situation, model=_motion):
        own = model.variables
        camera = replace(s.camera, variables=values_of(own))
        predicted = model.predict(camera, s.dt, _odometry(s, np.zeros(6)))
        return lambda n: difference(predicted.state, pushed(model, camera, s, n), own), predicted.G

    if type(_motion).odometry_measurement is not MotionModel.odometry_measurement:

        @case(f"motion {_name}: H of odometry")
        def _(s: Situation, model=_motion):
            still, own = BodyVelocity(np.zeros(3), np.zeros(3), np.eye(6)), model.variables
            camera = replace(s.camera, variables=values_of(own))

            def expected(e: np.ndarray) -> np.ndarray:
                return -model.odometry_measurement(moved(camera, e, own), s.dt, still).innovation

            return expected, model.odometry_measurement(camera, s.dt, still).H


# --- landmarks ------------------------------------------------------------------------------------------------

MODELS: dict[str, LandmarkModel] = {**LANDMARKS, "hybrid of both": Hybrid(near_distance=14.0)}


def situations_of(model: LandmarkModel, among: tuple = SITUATIONS) -> tuple:
    """Those in which such landmarks can start."""
    rng = np.random.default_rng
    return tuple(
        situation
        for situation in among
        if all(model.can_start(s.rays_w[:, :3], s.rays_w[:, 3]).all() for s in map(situation, map(rng, range(3))))
    )


for _name, _model in MODELS.items():
    _situations, _finite = situations_of(_model), situations_of(_model, FINITE_POINTS)

    def _seen(model: LandmarkModel, s: Situation):
        """Values of landmarks of the situation, and anchors a little away from where the camera is."""
        new = model.started(s.camera.position, s.rays_w[:, :3], s.rays_w[:, 3])
        anchors = np.where(new.anchored[:, None], s.camera.position + s.anchor_offset, np.nan)
        return new.parameters, anchors if model.anchored else None

    @case(f"landmark {_name}: started", _situations)
    def _(s: Situation, model=_model):
        position, h_w, scale = s.camera.position, s.rays_w[:, :3], s.rays_w[:, 3]
        new = model.started(position, h_w, scale)
        claimed = np.concatenate([new.by_position, new.by_direction, new.by_scale[:, :, None]], axis=2)

        def function(e: np.ndarray) -> np.ndarray:
            other = model.started(position + e[:3], h_w + e[3:6], scale + e[6])
            return model.local(new.parameters, other.parameters)

        return function, claimed

    @case(f"landmark {_name}: relative_to", _situations)
    def _(s: Situation, model=_model):
        parameters, anchors = _seen(model, s)
        claimed = model.relative_to(s.camera.position, anchors, parameters)

        def function(e: np.ndarray) -> np.ndarray:
            shifted = None if anchors is None else anchors + e[3:6]
            return model.homogeneous(s.camera.position + e[:3], shifted, model.retract(parameters, _each(e[-3:])))

        return function, np.concatenate([claimed.by_position, claimed.by_map], axis=2)

    @case(f"landmark {_name}: points", _finite)
    def _(s: Situation, model=_model):
        parameters, anchors = _seen(model, s)
        claimed = model.points(anchors, parameters).by_map
        # A small step in rho is a long way in metres: perturb each number relative to that.
        unit = 1.0 / np.maximum(1.0, np.abs(claimed).max(axis=1))

        def function(e: np.ndarray) -> np.ndarray:
            shifted = None if anchors is None else anchors + e[:3] * unit[:, :3]
            return model.points(shifted, model.retract(parameters, e[-3:] * unit[:, -3:])).positions

        return function, claimed * unit[:, None]

    @case(f"landmark {_name}: inverse_distances", _situations)
    def _(s: Situation, model=_model):
        parameters, anchors = _seen(model, s)
        claimed = model.inverse_distances(s.camera.position, anchors, parameters)

        def function(e: np.ndarray) -> np.ndarray:
            other = model.retract(parameters, _each(e[3:]))
            return model.inverse_distances(s.camera.position + e[:3], anchors, other).values

        return function, np.concatenate([claimed.by_position, claimed.by_parameters], axis=1)

    @case(f"landmark {_name}: world_rotation", _situations)
    def _(s: Situation, model=_model):
        parameters, anchors = _seen(model, s)

        def function(e: np.ndarray) -> np.ndarray:
            return model.local(parameters, model.rotated(anchors, parameters, Rotation.from_rotvec(e).as_matrix()))

        return function, model.world_rotation(anchors, parameters)

    @case(f"landmark {_name}: transport", _situations)
    def _(s: Situation, model=_model):
        parameters, _ = _seen(model, s)
        delta = 0.3 * s.anchor_offset
        there, claimed = model.retract(parameters, delta), model.transport(parameters, delta)

        def function(e: np.ndarray) -> np.ndarray:
            return model.local(there, model.retract(parameters, delta + e))

        return function, np.broadcast_to(np.eye(3), (COUNT, 3, 3)) if claimed is None else claimed

    @case(f"landmark {_name}: retract is delta to first order", _situations)
    def _(s: Situation, model=_model):
        parameters, _ = _seen(model, s)
        return (
            lambda e: model.local(parameters, model.retract(parameters, _each(e))),
            np.broadcast_to(np.eye(3), (COUNT, 3, 3)),
        )

    @case(f"landmark {_name}: turned_jacobians", _situations)
    def _(s: Situation, model=_model):
        parameters, anchors = _seen(model, s)
        theta, correction = s.delta, 0.1 * s.anchor_offset

        def at(e: np.ndarray) -> np.ndarray:
            angle = theta + e[3:]
            turn, spread = Rotation.from_rotvec(angle).as_matrix(), rotations.right_jacobian(-angle)
            return model.turned(anchors, parameters, turn, spread, correction + e[:3])

        here = at(np.zeros(6))
        claimed = np.concatenate(model.turned_jacobians(anchors, parameters, theta, correction), axis=2)
        return lambda e: model.local(here, at(e)), claimed


def _each(delta: np.ndarray) -> np.ndarray:
    return np.broadcast_to(delta, (COUNT, 3))


# --- measurements ---------------------------------------------------------------------------------------------

SENSORS: dict[str, MeasurementModel] = {**MEASUREMENTS, "with variables": ShearedPair()}


def measures(sensor: MeasurementModel, s: Situation) -> bool:
    """Whether the sensor has numbers of the situation that a landmark can start from."""
    values = values_of(sensor.variables)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = sensor.predict(CAMERA, s.rays_c, values)
        finite = np.isfinite(z).all() and np.isfinite(sensor.backproject(CAMERA, z[:, :3], values)).all()
    return bool(finite and sensor.in_front(s.rays_c).all())


def visible(sensor: MeasurementModel, among: tuple = SITUATIONS) -> tuple:
    """Situations that the sensor measures."""
    return tuple(x for x in among if all(measures(sensor, x(np.random.default_rng(seed))) for seed in range(3)))


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


# --- the joint state: new landmarks, H and the transport, by the whole error state ---------------------------------


def sight(sensor: MeasurementModel, s: Situation) -> StereoObservation:
    """The landmarks of the situation as the sensor measures them."""
    z = sensor.predict(CAMERA, s.rays_c, values_of(sensor.variables))
    return StereoObservation(np.arange(COUNT), z[:, :3], v_right=z[:, 3] if sensor.size == 4 else z[:, 1] + 0.5)


def seen_state(model: LandmarkModel, sensor: MeasurementModel, s: Situation, layout: Layout) -> JointState:
    """Two generations of landmarks and a clone of the pose; the camera has moved on from where it saw them."""
    here = replace(s.camera, variables=values_of(layout.variables))
    there = replace(here, position=here.position - s.anchor_offset[0])
    state = without_map(there, np.eye(layout.size), model, layout)
    observation, R = sight(sensor, s), np.broadcast_to(np.eye(3), (COUNT, 3, 3))
    half = COUNT // 2
    state.augment(start_landmarks(sensor, CAMERA, state, observation.select(np.arange(half)), R[:half]))
    state.clone_pose("clone")
    state.camera = here
    state.augment(start_landmarks(sensor, CAMERA, state, observation.select(np.arange(half, COUNT)), R[half:]))
    state.camera = replace(here, position=here.position + 0.5 * s.anchor_offset[1])
    # First-estimates Jacobians are those of the state where the state is the first estimate.
    return replace(state, predicted=state.camera, first_blocks=state.blocks)


def started(model: LandmarkModel, sensor: MeasurementModel, s: Situation, by_leading, by_uvd=0.0) -> NewLandmarks:
    """New landmarks with R = diag(1, 2, 3), from a pose, variables and measurements in error."""
    layout, seen = Layout.of(sensor.variables, ()), sight(sensor, s)
    camera = replace(s.camera, variables=values_of(sensor.variables))
    error = np.concatenate([by_leading[:6], np.zeros(6), by_leading[6:]])
    state = without_map(moved(camera, error, sensor.variables), np.eye(layout.size), model, layout)
    R = np.broadcast_to(np.diag([1.0, 2.0, 3.0]), (COUNT, 3, 3))
    return start_landmarks(sensor, CAMERA, state, StereoObservation(seen.ids, seen.uvd + by_uvd), R)


for _landmark, _model in MODELS.items():
    for _measurement, _sensor in SENSORS.items():
        _situations = visible(_sensor, situations_of(_model))

        @case(f"new landmarks: {_landmark}, {_measurement}", _situations, seeds=1)
        def _(s: Situation, model=_model, sensor=_sensor):
            new = started(model, sensor, s, np.zeros(Layout.of(sensor.variables, ()).measured))

            def function(e: np.ndarray) -> np.ndarray:
                return model.local(new.started.parameters, started(model, sensor, s, e).started.parameters)

            return function, new.by_leading

        for _update, _linearisation in UPDATES.items():
            for _error, _definition in ERRORS.items():
                if not _linearisation.by_jacobians:
                    continue

                @case(f"H: {_landmark}, {_measurement}, {_error}, {_update}", _situations, seeds=1)
                def _(s: Situation, model=_model, sensor=_sensor, error=_definition, update=_linearisation):
                    state = seen_state(model, sensor, s, Layout.of(sensor.variables, ()))
                    index = np.arange(COUNT)[::-1].copy()
                    R = np.broadcast_to(StereoNoise.independent_pixels(1.0).R, (COUNT, 3, 3))
                    stages = sensor.stages(sight(sensor, s), R)

                    def predicted(e: np.ndarray) -> np.ndarray:
                        other = error.moved(state, e)
                        parts = [update.linearise(sensor, CAMERA, other, index, stage) for stage in stages]
                        return -np.concatenate([part.innovation for part in parts], axis=1)

                    point = error.linearisation_point(state)
                    parts = [update.linearise(sensor, CAMERA, state, index, stage, point) for stage in stages]
                    whole = [dense(part, len(state.P))[1].reshape(*part.innovation.shape, -1) for part in parts]
                    return predicted, np.concatenate(whole, axis=1)


LAYOUTS = {"": Layout(), " with variables": Layout.of(ShearedPair().variables, BiasedOdometry().variables)}


def local(state: JointState, other: JointState, error: ErrorDefinition) -> np.ndarray:
    """The error numbers (n,) between two joint states, each part by its own retraction."""
    here, there, layout = state.camera, other.camera, state.layout
    numbers = np.zeros(len(state.P))
    numbers[POSITION] = there.position - here.position
    numbers[ROTATION] = error.orientation.local(here.orientation, there.orientation)
    numbers[layout.linear_velocity] = there.linear_velocity - here.linear_velocity
    numbers[layout.angular_velocity] = there.angular_velocity - here.angular_velocity
    for x in layout.variables:
        numbers[layout.places[x.name]] = x.retraction.local(here.variables[x.name], there.variables[x.name])
    blocks = other.blocks[:, :3] - state.blocks[:, :3]
    blocks[state.parameter_block] = state.model.local(state.parameters(), other.parameters())
    for name, clone in state.clones.items():
        now = other.clones[name]
        turn = error.orientation.local(clone.orientation, now.orientation)
        blocks[clone.blocks] = now.position - clone.position, turn
    numbers[layout.size :] = blocks.ravel()
    return numbers


def whole_matrix(transport: Transport, size: int) -> np.ndarray:
    """The Jacobian that a `Transport` stands for; (n, n)."""
    J, leading = np.eye(size), len(transport.leading)
    J[:leading, :leading] = transport.leading
    if transport.by_rotation is not None:
        J[leading:, ROTATION] = transport.by_rotation
    if transport.rows is not None:
        for rows, own in zip(transport.rows, transport.own, strict=True):
            J[np.ix_(rows, rows)] = own
    return J


# Without the reset, P is left as it was in invariant coordinates, which is no Jacobian of the retraction.
for _error, _definition in {**ERRORS, "right-invariant": RightInvariant(reset=True)}.items():
    for _landmark, _model in MODELS.items():
        for _layout, _places in LAYOUTS.items():

            @case(f"transport: {_error}, {_landmark}{_layout}", situations_of(_model), seeds=1)
            def _(s: Situation, error=_definition, model=_model, layout=_places):
                state = (
                    seen_state(model, ShearedPair(), s, layout)
                    if layout.variables
                    else seen_state(model, MEASUREMENTS["joint"], s, layout)
                )
                delta = 0.1 * np.random.default_rng(0).standard_normal(len(state.P))
                delta[ROTATION] = s.delta
                there = error.moved(state, delta)
                claimed = whole_matrix(error.transport(state, there, delta), len(delta))
                if not error.linearises_at_the_state:  # errors stay those of the linearisation point
                    return lambda e: e, claimed
                return lambda e: local(there, error.moved(state, delta + e), error), claimed


@pytest.mark.parametrize("named", CASES, ids=lambda named: named.name)
def test_analytic_jacobian_equals_finite_differences(named: Case) -> None:
    for situation in named.situations:
        for seed in range(named.seeds):
            s = situation(np.random.default_rng(seed))
            function, claimed = named.prepare(s)
            # Too small a step is rounding, too large a one truncation; a wrong Jacobian disagrees with all of them.
            differences = []
            for step in (s.step, *OTHER_STEPS):
                measured = numeric_jacobian(function, claimed.shape[-1], step)
                assert measured.shape == claimed.shape
                beyond_rounding = np.where(np.abs(claimed - measured) < ROUNDING, measured, claimed)
                differences.append(relative_difference(beyond_rounding, measured))
                if differences[-1] < TOLERANCE:
                    break
            assert min(differences) < TOLERANCE, f"{situation.__name__}, seed {seed}: {min(differences):.2g}"


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_the_noise_of_a_new_landmark_is_that_of_its_measurement(model: LandmarkModel, sensor: MeasurementModel) -> None:
    """J R J^T, with the J of finite differences."""
    for situation in visible(sensor, situations_of(model)):
        s, nothing = situation(np.random.default_rng(0)), np.zeros(Layout.of(sensor.variables, ()).measured)
        new = started(model, sensor, s, nothing)

        def function(e: np.ndarray, s=s, nothing=nothing, new=new) -> np.ndarray:
            return model.local(new.started.parameters, started(model, sensor, s, nothing, e).started.parameters)

        J = numeric_jacobian(function, 3, s.step)
        expected = J @ np.diag([1.0, 2.0, 3.0]) @ J.transpose(0, 2, 1)
        sigmas = np.sqrt(np.einsum("mii->mi", expected))
        scale = sigmas[:, :, None] * sigmas[:, None]
        np.testing.assert_allclose(new.noise / scale, expected / scale, rtol=0, atol=1e-6)


def test_a_wrong_jacobian_is_found() -> None:
    """The check itself can fail: an error of 1e-6 in one entry shows."""
    s = ordinary(np.random.default_rng(0))
    wrong = CAMERA.project_jacobian(s.points_c)
    wrong[0, 0, 2] *= 1 + 1e-6
    measured = numeric_jacobian(lambda e: CAMERA.project(s.points_c + e), 3)
    assert relative_difference(wrong, measured) > TOLERANCE
