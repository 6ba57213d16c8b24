"""`check_part`: the checks that every landmark, measurement, motion and error must pass.

Jacobians are held against differences of the functions that they belong to, corrections are undone, and the world is
moved as a whole. Landmarks and points are near, far, at infinity and beyond it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE, ConformanceReport, checked, require
from filters.contract.inputs import BodyVelocity, InertialSamples, InertialUnit, Start, StereoObservation
from filters.contract.outputs import VELOCITY, Variable
from filters.engine.options import check_functions
from filters.engine.stereo_ekf import StereoEKF
from filters.errors import ErrorDefinition
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.derivatives import columns_of, jacobian_of
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel, Values
from filters.motions.motion_model import (
    CameraState,
    MotionModel,
    StepInput,
)

TOLERANCE = 1e-6
"""Largest error of a Jacobian, as a share of the largest entry of its row; that of differences is about 1e-9."""

SCALES = np.tile([0.3, 0.1, 0.02, 0.0, -1e-9, -0.05], 2)
"""Inverse distances of landmarks and points: near, far, at infinity and beyond."""

TURN, SHIFT = rotations.exp(np.array([0.4, -0.7, 0.2])), np.array([3.0, -1.0, 2.0])
"""A motion of the world."""


def assert_close(what: str, got: FloatArray, wanted: FloatArray, tolerance: float = TOLERANCE) -> None:
    """Raise an `AssertionError` where they differ by more than a share of the largest entry of the row."""
    got, wanted = np.asarray(got), np.asarray(wanted)
    require(got.shape == wanted.shape, f"{what} has shape {got.shape}, not {wanted.shape}")
    size = np.abs(wanted).max(axis=-1, keepdims=True, initial=0.0)
    off = np.max(np.abs(got - wanted) / np.maximum(size, 1e-3 * size.max(initial=0.0) + 1e-9), initial=0.0)
    require(off < tolerance, f"{what} is off by {off:.2g} of its size")


def assert_refusal(error: ValueError, word: str) -> None:
    """Raise an `AssertionError` where a refusal is not one line, or does not have the word."""
    require(word in str(error), f"a wrong {word} is refused without its name: {error}")
    require("\n" not in str(error), f"a wrong {word} is refused in more than one line: {error}")


def unit_directions(homogeneous: FloatArray) -> FloatArray:
    """Homogeneous points with a unit direction; (M, 4)."""
    unit: FloatArray = homogeneous / np.linalg.norm(homogeneous[:, :3], axis=1, keepdims=True)
    return unit


def moved_world(camera: CameraState, shift: FloatArray = SHIFT, variables: tuple[Variable, ...] = ()) -> CameraState:
    """The same camera and variables in a world that is turned and shifted."""
    return CameraState(
        TURN @ camera.position + shift,
        rotations.from_matrix(TURN @ camera.R_wc),
        TURN @ camera.linear_velocity,
        camera.angular_velocity,
        {**camera.variables, **{x.name: x.turned(camera.variables[x.name], TURN) for x in variables}},
    )


DT = 0.1


def a_camera(variables: Mapping[str, FloatArray]) -> CameraState:
    """Somewhere, turned and moving."""
    q = rotations.exp_quaternion(np.array([0.3, 0.5, -0.2]))
    return CameraState(np.array([1.0, -2.0, 3.0]), q, np.array([4.0, 0.5, -1.0]), np.array([0.1, -0.3, 0.2]), variables)


def _before(motion: MotionModel, dt: float = DT) -> tuple[CameraState, StepInput]:
    """A state, and odometry or inertial samples of a step that all models take."""
    rng = np.random.default_rng(0)
    near = {v.name: v.retraction.retract(v.value, 1e-2 * rng.standard_normal(v.size)) for v in motion.variables}
    odometry = BodyVelocity(np.array([0.2, -0.1, 5.0]), np.array([0.02, 0.3, -0.1]), np.diag(np.full(6, 1e-2)))
    if motion.takes is not InertialSamples:
        return a_camera(near), odometry
    tilted = rotations.exp_quaternion(np.array([0.1, -0.2, 1.3]))
    unit = InertialUnit(np.array([0.1, -0.3, 0.2]), tilted, 2e-3, 2e-2, 2e-4, 3e-3)
    rates, forces = rng.normal([0.02, 0.3, -0.1], 0.1, (6, 3)), rng.normal([-9.0, 1.0, 2.0], 0.5, (6, 3))
    return a_camera(near), InertialSamples(dt * np.linspace(0.1, 0.95, 6), rates, forces, unit)


def check_motion_prediction(motion: MotionModel) -> None:
    """A prediction has the documented shapes and a semi-definite noise, and no time moves the pose by nothing."""
    state, odometry = _before(motion)
    predicted = motion.predict(state, DT, odometry)
    require((np.linalg.eigvalsh(predicted.Q) >= -1e-12).all(), "Q is not positive semi-definite")
    at_once = motion.predict(state, 1e-9, _before(motion, 1e-9)[1]).state
    assert_close("position after no time", at_once.position, state.position)
    assert_close("orientation after no time", at_once.orientation, state.orientation)
    try:
        motion.predict(state, DT, None)
    except ValueError as error:
        assert_refusal(error, "inertial" if motion.takes is InertialSamples else "odometry")


def check_motion_jacobians(motion: MotionModel) -> None:
    """F, G and the H of odometry are those of differences."""
    state, odometry = _before(motion)
    predicted, size = motion.predict(state, DT, odometry), motion.size

    def after(e: FloatArray) -> CameraState:
        return motion.predict(motion.corrected(state, e), DT, odometry).state

    assert_close("F", predicted.F, derivatives.jacobian(lambda e: motion.difference(predicted.state, after(e)), size))
    if motion.driven and isinstance(odometry, BodyVelocity):

        def pushed(n: FloatArray) -> FloatArray:
            other = replace(odometry, linear=odometry.linear + n[:3], angular=odometry.angular + n[3:])
            return motion.difference(predicted.state, motion.predict(state, DT, other).state)

        assert_close("G", predicted.G, derivatives.jacobian(pushed, 6))
    measured = motion.odometry_measurement(state, DT, odometry)
    if measured is not None:

        def innovation(e: FloatArray) -> FloatArray:
            at = motion.odometry_measurement(motion.corrected(state, e), DT, odometry)
            if at is None:
                raise AssertionError("odometry is a measurement of some states only")
            return -at.innovation

        assert_close("H of odometry", measured.H, derivatives.jacobian(innovation, size))


def check_motion_invariance(motion: MotionModel) -> None:
    """The motion is the same in a turned and shifted world, with its variables that are vectors in W."""
    state, odometry = _before(motion)
    expected = moved_world(motion.predict(state, DT, odometry).state, variables=motion.variables)
    in_another = motion.predict(moved_world(state, variables=motion.variables), DT, odometry).state
    where = "in a moved world (a vector in W is to be a Variable with in_world=True)"
    for name in ("position", "linear_velocity", "angular_velocity", "R_wc"):
        assert_close(f"{name} {where}", getattr(in_another, name), getattr(expected, name), 1e-9)
    for name in (variable.name for variable in motion.variables):
        assert_close(f"{name} in a moved world", in_another.variables[name], expected.variables[name], 1e-9)


MOTION_CHECKS: tuple[Callable[..., None], ...] = (
    check_motion_prediction,
    check_motion_jacobians,
    check_motion_invariance,
)


_UVD = np.array([[600.0, 200.0, 30.0], [300.0, 100.0, 20.0], [900.0, 250.0, 10.0], [800.0, 180.0, 4.0]])


def _filter(error: ErrorDefinition, R: FloatArray | None = None) -> StereoEKF:
    """A filter with four landmarks, in a world turned by R, before it is corrected."""
    root, R = 0.1 * np.random.default_rng(0).standard_normal((12, 12)), np.eye(3) if R is None else R
    turn = np.eye(12)
    turn[:3, :3] = turn[6:9, 6:9] = R  # rotation and angular velocity are those of the camera
    at, P = a_camera({}), turn @ root @ root.T @ turn.T
    start = Start(R @ at.position, rotations.from_matrix(R @ at.R_wc), R @ at.linear_velocity, at.angular_velocity, P)
    slam = StereoEKF(REFERENCE_CAMERA, REFERENCE_NOISE, error=error, landmark="euclidean", gate=None)
    slam.reset(start)
    slam.update(StereoObservation(np.arange(4), _UVD))
    slam.predict(0.1)
    return slam


def check_error_of_nothing(error: ErrorDefinition) -> None:
    """A measurement that is what the filter expects leaves the estimate where it is."""
    slam = _filter(error)
    before = slam.pose
    slam.update(StereoObservation(slam.ids, slam.forecast().uvd))
    assert_close("position without an innovation", slam.pose.position, before.position, 1e-9)
    assert_close("orientation without an innovation", slam.pose.orientation, before.orientation, 1e-9)


def check_error_invariance(error: ErrorDefinition) -> None:
    """The same measurements lead to the turned estimate in a turned world."""
    slam, turned = _filter(error), _filter(error, TURN)
    for one in (slam, turned):
        one.update(StereoObservation(np.arange(4), _UVD + [[3.0, -2.0, 0.5]] * 4))
    assert_close("landmarks in a turned world", turned.landmarks.positions, slam.landmarks.positions @ TURN.T, 1e-7)
    assert_close("position in a turned world", turned.pose.position, TURN @ slam.pose.position, 1e-7)
    here, turned_R = rotations.matrix(slam.pose.orientation), rotations.matrix(turned.pose.orientation)
    assert_close("orientation in a turned world", turned_R, TURN @ here, 1e-7)


def check_error_of_the_pose(error: ErrorDefinition) -> None:
    """The pose has no error against itself, and `pose_error` has the covariance of small ones."""
    slam = _filter(error)
    camera, P = slam.camera_state, slam.pose.covariance
    none, covariance = error.pose_error(camera, P, camera.position, camera.orientation)
    assert_close("pose_error of the pose itself", none, np.zeros(6))

    def against(e: FloatArray) -> FloatArray:
        true = rotations.multiply(camera.orientation, rotations.exp_quaternion(e[3:]))
        return error.pose_error(camera, P, camera.position + e[:3], true)[0]

    J = derivatives.jacobian(against, 6)
    assert_close("covariance of pose_error", covariance, J @ P @ J.T)


ERROR_CHECKS: tuple[Callable[..., None], ...] = (
    check_error_of_nothing,
    check_error_invariance,
    check_error_of_the_pose,
)


def _seen(model: LandmarkModel) -> FloatArray:
    """Numbers (M, seen_size) by which landmarks are seen that can start, from their anchors or the origin of W."""
    rng, count = np.random.default_rng(0), len(SCALES)
    extra_numbers = np.column_stack([SCALES, 0.1 * rng.standard_normal((count, model.seen_size - 4))])
    homogeneous = np.hstack([rng.standard_normal((count, 3)), extra_numbers])
    if model.seen_size != 4:  # what starts may have to keep numbers of its own at zero
        homogeneous = columns_of(model.point_of, columns_of(model.start_from, _able(model, homogeneous)))
    return _able(model, homogeneous)


def _able(model: LandmarkModel, seen: FloatArray) -> FloatArray:
    able: FloatArray = seen[columns_of(lambda h: (model.can_start_from(h),), seen)[:, 0].astype(bool)]
    require(len(able), "no landmark can be started")
    return able


def _slopes(function: Callable[..., Any], *arrays: FloatArray) -> FloatArray:
    """Jacobian (M, k, n) of a plain function by its first argument, by differences."""
    first, *other_arrays = arrays
    return derivatives.jacobian(lambda e: columns_of(function, first + e, *other_arrays), first.shape[1])


def _assert_slopes(what: str, function: Callable[..., Any], *arrays: FloatArray) -> None:
    """Raise an `AssertionError` where derivatives by dual numbers are not those of differences."""
    by_duals = jacobian_of(function, *arrays)[1]
    require(np.isfinite(by_duals).all(), f"a derivative of {what} is not finite")
    assert_close(f"the derivative of {what}", by_duals, _slopes(function, *arrays))


def check_landmark_start(model: LandmarkModel) -> None:
    """A landmark is seen where it was started."""
    homogeneous = _seen(model)
    values = columns_of(model.start_from, homogeneous)
    require(values.shape == (len(homogeneous), model.value_size), f"start_from gives {values.shape[1]} numbers")
    again = columns_of(model.point_of, values)
    require(again.shape == homogeneous.shape, f"point_of gives {again.shape[1]} numbers")
    assert_close("point_of start_from", unit_directions(again), unit_directions(homogeneous), 1e-9)
    if model.anchored:
        require(np.isfinite(values).all(), "a value of a landmark that can start is not finite")


def check_landmark_start_jacobians(model: LandmarkModel) -> None:
    """Derivatives of a start are those of differences, and finite wherever a landmark can be started."""
    homogeneous = _seen(model)

    def started(h: Any, y: Any) -> Any:
        return model.local_by(y, model.start_from(h))

    far = homogeneous.copy()
    far[:, 3] = 1e-9
    far = _able(model, far)
    by_seen = jacobian_of(started, far, columns_of(model.start_from, far))[1]
    require(np.isfinite(by_seen).all(), "a Jacobian of a start is not finite")
    nearer = homogeneous - 2.0 * derivatives.STEP * (np.arange(homogeneous.shape[1]) == 3)
    homogeneous = homogeneous[columns_of(lambda h: (model.can_start_from(h),), nearer)[:, 0].astype(bool)]
    _assert_slopes("start_from", started, homogeneous, columns_of(model.start_from, homogeneous))


def check_landmark_jacobians(model: LandmarkModel) -> None:
    """Derivatives of a landmark in the map are those of differences, at infinity and beyond, too."""
    values = columns_of(model.start_from, _seen(model))
    still, theta = np.zeros((len(values), model.size)), np.array([[0.1, -0.2, 0.15]])
    _assert_slopes("point_of", lambda e, y: model.point_of(model.retract_by(y, e)), still, values)
    if model.in_world:
        return
    both = np.hstack([still + 0.02, np.broadcast_to(theta, (len(values), 3))])

    def carried(x: Any, y: Any) -> Any:
        return model.turned_by(y, x[model.size :], x[: model.size])

    moved = columns_of(carried, both, values)
    _assert_slopes("turned_by", lambda x, y, end: model.local_by(end, carried(x, y)), both, values, moved)
    turned = columns_of(lambda y: model.turned_by(y, tuple(theta[0]), (0.0,) * model.size), values)
    homogeneous, again = columns_of(model.point_of, values), columns_of(model.point_of, turned)
    homogeneous[:, :3] = homogeneous[:, :3] @ rotations.exp(theta[0]).T
    assert_close("turned_by without a correction", unit_directions(again), unit_directions(homogeneous), 1e-9)


def check_landmark_retraction(model: LandmarkModel) -> None:
    """A correction is undone by `local_by`, and nothing is changed by none."""
    values = columns_of(model.start_from, _seen(model))
    delta = np.random.default_rng(1).uniform(-0.1, 0.1, (len(values), model.size))
    corrected, least = columns_of(model.retract_by, values, delta), max(1.0, np.abs(values).max())
    assert_close("retract_by nothing", columns_of(model.retract_by, values, 0.0 * delta), values, 1e-12)
    assert_close("local_by of retract_by", columns_of(model.local_by, values, corrected), delta, 1e-9 * least)
    slopes = jacobian_of(lambda c, y, end: model.local_by(end, model.retract_by(y, c)), delta, values, corrected)[1]
    differences = _slopes(lambda c, y, end: model.local_by(end, model.retract_by(y, c)), delta, values, corrected)
    assert_close("the derivative of retract_by", slopes, differences, max(TOLERANCE, 1e-11 * np.abs(values).max()))

    def without_a_turn(c: Any, y: Any) -> Any:
        return model.local_by(y, model.turned_by(y, (0.0, 0.0, 0.0), c))

    if not model.in_world:
        still = np.broadcast_to(np.eye(model.size), slopes.shape)
        assert_close("turned_by without a turn", _slopes(without_a_turn, 0.0 * delta, values), still)


def check_landmark_invariance(model: LandmarkModel) -> None:
    """A landmark starts where the turned one is, in a turned world."""
    homogeneous = _seen(model)
    turned = np.hstack([homogeneous[:, :3] @ TURN.T, homogeneous[:, 3:]])
    able = columns_of(lambda h: (model.can_start_from(h),), turned)[:, 0].astype(bool)
    again = columns_of(model.point_of, columns_of(model.start_from, turned[able]))
    assert_close("a start in a turned world", unit_directions(again), unit_directions(turned[able]), 1e-9)


LANDMARK_CHECKS: tuple[Callable[..., None], ...] = (
    check_landmark_start,
    check_landmark_start_jacobians,
    check_landmark_jacobians,
    check_landmark_retraction,
    check_landmark_invariance,
)


def _points(sensor: MeasurementModel) -> tuple[FloatArray, Values]:
    """Points, or other landmarks, that the sensor can see, and values of its variables near their start."""
    rng, c = np.random.default_rng(0), REFERENCE_CAMERA
    points_c = np.column_stack([rng.uniform(-0.4, 0.4, (len(SCALES), 2)), np.ones(len(SCALES)), SCALES])
    near = {v.name: v.retraction.retract(v.value, 1e-3 * rng.standard_normal(v.size)) for v in sensor.variables}
    if sensor.sees_velocity:
        near[VELOCITY] = np.array([0.4, -0.2, 5.0, 0.02, 0.3, -0.1])
    if sensor.seen_size != 4:  # whatever is measured there
        points_c = sensor.backproject(c, c.project_scaled(points_c[:, :3], points_c[:, 3]), near)
    visible = sensor.in_front(points_c)
    require(
        visible.shape == visible[:, None].squeeze(1).shape == (len(points_c),), f"in_front has shape {visible.shape}"
    )
    require(visible.any(), "in_front is true of no point")
    return points_c[visible], near


def check_measurement_shapes(sensor: MeasurementModel) -> None:
    """Numbers have the documented shapes, of none and of a grid of points, and are finite where `in_front`."""
    points_c, values = _points(sensor)
    numbers = sensor.predict(REFERENCE_CAMERA, points_c, values)
    require(np.isfinite(numbers).all(), "a number of a point in front is not finite")
    require(numbers.shape == (len(points_c), sensor.size), f"predict returned {numbers.shape}")
    grid = sensor.predict(REFERENCE_CAMERA, np.stack([points_c, points_c]), values)
    assert_close("predict of a grid", grid, np.stack([numbers, numbers]), 1e-12)
    if sensor.seen_size == 4:
        longer = sensor.predict(REFERENCE_CAMERA, 2.5 * points_c, values)
        assert_close("predict of longer directions", longer, numbers, 1e-9)
    assert_close("predict of none", sensor.predict(REFERENCE_CAMERA, points_c[:0], values), numbers[:0])
    assert_close("backproject of none", sensor.backproject(REFERENCE_CAMERA, numbers[:0, :3], values), points_c[:0])


def check_measurement_inverse(sensor: MeasurementModel) -> None:
    """A point is backprojected to where it is."""
    points_c, values = _points(sensor)
    numbers = sensor.predict(REFERENCE_CAMERA, points_c, values)
    back = sensor.backproject(REFERENCE_CAMERA, numbers[:, :3], values)
    assert_close("backproject of predict", unit_directions(back), unit_directions(points_c), 1e-9)


def check_measurement_jacobians(sensor: MeasurementModel) -> None:
    """Derivatives of numbers and backprojection are those of differences, by the variables, too."""
    points_c, values = _points(sensor)
    nearer = points_c - 2.0 * derivatives.STEP * (np.arange(points_c.shape[1]) == 3)
    points_c = points_c[sensor.in_front(nearer)]
    uvd = sensor.predict(REFERENCE_CAMERA, points_c, values)[:, :3]
    for what, claimed, function, start in (
        ("project", sensor.jacobians, sensor.predict, points_c),
        ("unproject", sensor.backprojection_jacobians, sensor.backproject, uvd),
    ):
        J = claimed(REFERENCE_CAMERA, start, values)
        by_point = derivatives.jacobian(partial(_of_moved, function, start, values), start.shape[1])
        assert_close(f"the derivative of {what}", J.by_point, by_point)
        for name in sensor.value_names:
            by_variable = derivatives.jacobian(partial(_of_changed, function, start, values, name), len(values[name]))
            assert_close(f"the derivative of {what} by {name}", J.by_variable[name], by_variable)


def _of_moved(function: Any, start: FloatArray, values: Values, e: FloatArray) -> Any:
    return function(REFERENCE_CAMERA, start + e, values)


def _of_changed(function: Any, start: FloatArray, values: Values, name: str, e: FloatArray) -> Any:
    return function(REFERENCE_CAMERA, start, {**values, name: values[name] + e})


def check_measurement_stages(sensor: MeasurementModel) -> None:
    """Stages use the numbers of the sensor, each with a definite noise."""
    points_c, values = _points(sensor)
    numbers = sensor.predict(REFERENCE_CAMERA, points_c, values)
    for rows in (slice(None), slice(0)):
        some = numbers[rows]
        R = np.broadcast_to(REFERENCE_NOISE.R, (len(some), 3, 3))
        for v_right in (None, some[:, 3]) if sensor.size == 4 else (None,):
            for stage in sensor.stages(StereoObservation(np.arange(len(some)), some[:, :3], v_right), R):
                assert_close("z of a stage", stage.z, some @ stage.T.T, 1e-12)
                require(stage.R.shape == (len(some), *2 * stage.z.shape[1:]), f"R of a stage is {stage.R.shape}")
                require((np.linalg.eigvalsh(stage.R) > 0.0).all(), "R of a stage is not positive definite")


MEASUREMENT_CHECKS: tuple[Callable[..., None], ...] = (
    check_measurement_shapes,
    check_measurement_inverse,
    check_measurement_jacobians,
    check_measurement_stages,
)


PartCheck = Callable[[Any], None]


def check_part(part: object, *, raise_on_failure: bool = True) -> ConformanceReport:
    """Check that a part of a filter keeps the contract of its base class.

    Parameters
    ----------
    part : LandmarkModel, MeasurementModel, MotionModel or ErrorDefinition
        The part, as a filter is given it.
    raise_on_failure : bool
        Raise if a check fails; else only report.

    Raises
    ------
    ConformanceError
        With every failed check listed.
    ValueError
        It is no such part.
    """
    from filters.kernels.lift import how_it_runs  # Numba takes longer to import than all the rest

    return checked(type(part).__name__, checks_of(part), part, raise_on_failure, how_it_runs(part))


def checks_of(part: object) -> tuple[PartCheck, ...]:
    """The checks for a part of this kind."""
    for kind, checks in PART_CHECKS.items():
        if isinstance(part, kind):
            return (*checks, check_plain_functions, check_settings)
    kinds = ", ".join(kind.__name__ for kind in PART_CHECKS)
    raise ValueError(f"part must be one of {kinds}, got {part!r}: give an object, such as make_part makes")


def check_plain_functions(part: Any) -> None:
    """A part gives its plain functions, and leaves what follows from them alone."""
    if not isinstance(part, ErrorDefinition):
        try:
            check_functions(part)
        except ValueError as error:
            raise AssertionError(str(error)) from None


def check_settings(part: Any) -> None:
    """A setting that is no number is refused in one line that names it."""
    for field in dataclasses.fields(part) if dataclasses.is_dataclass(part) else ():
        now = getattr(part, field.name)
        number = now is None or (isinstance(now, float | int) and not isinstance(now, bool))
        for value in (float("nan"), "a word") if number else ():
            try:
                dataclasses.replace(part, **{field.name: value})
            except ValueError as error:
                assert_refusal(error, field.name)
            else:
                raise AssertionError(f"{field.name}={value!r} is accepted")


PART_CHECKS: Mapping[type, tuple[PartCheck, ...]] = {
    LandmarkModel: LANDMARK_CHECKS,
    MeasurementModel: MEASUREMENT_CHECKS,
    MotionModel: MOTION_CHECKS,
    ErrorDefinition: ERROR_CHECKS,
}
"""The checks of `check_part` for each kind, besides that of its settings."""
