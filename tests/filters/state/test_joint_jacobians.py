"""Every Jacobian of the joint state against finite differences: new landmarks, H and the transport, whole columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filters import StereoNoise, StereoObservation
from filters.engine.new_landmarks import start_landmarks
from filters.errors.error_definition import ErrorDefinition
from filters.errors.invariant import RightInvariant
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.motion_model import POSITION, ROTATION
from filters.state.joint_state import JointState, NewLandmarks
from filters.state.layout import StateLayout, Transport
from filters.updates.extended import points_in_camera

from ..engine.linear_problems import dense
from ..jacobians import (
    CAMERA,
    COUNT,
    MODELS,
    SENSORS,
    Case,
    Cases,
    Situation,
    assert_jacobian,
    moved,
    situations_of,
    values_of,
    visible,
)
from ..numeric import numeric_jacobian
from ..slots import ERRORS, MEASUREMENTS, UPDATES
from ..third_party import BiasedOdometry, ShearedPair
from .states import augment, clone_pose, without_map

CASES = Cases()
case = CASES.case
DEFINITIONS = list(ERRORS.items())


def sight(sensor: MeasurementModel, s: Situation) -> StereoObservation:
    """The landmarks of the situation as the sensor measures them."""
    z = sensor.predict(CAMERA, s.rays_c, values_of(sensor.variables))
    return StereoObservation(np.arange(COUNT), z[:, :3], v_right=z[:, 3] if sensor.size == 4 else z[:, 1] + 0.5)


def seen_state(model: LandmarkModel, sensor: MeasurementModel, s: Situation, layout: StateLayout) -> JointState:
    """Two generations of landmarks and a clone of the pose; the camera has moved on from where it saw them."""
    here = replace(s.camera, variables=values_of(layout.variables))
    there = replace(here, position=here.position - s.anchor_offset[0])
    state = without_map(there, np.eye(layout.size), model, layout)
    observation, R = sight(sensor, s), np.broadcast_to(np.eye(3), (COUNT, 3, 3))
    half = COUNT // 2
    augment(state, start_landmarks(sensor, CAMERA, state, observation.select(np.arange(half)), R[:half]))
    clone_pose(state, "clone")
    state.camera = here
    augment(state, start_landmarks(sensor, CAMERA, state, observation.select(np.arange(half, COUNT)), R[half:]))
    state.camera = replace(here, position=here.position + 0.5 * s.anchor_offset[1])
    # First-estimates Jacobians are those of the state where the state is the first estimate.
    return replace(state, predicted=state.camera, first_blocks=state.blocks)


def started(model: LandmarkModel, sensor: MeasurementModel, s: Situation, by_leading, by_uvd=0.0) -> NewLandmarks:
    """New landmarks with R = diag(1, 2, 3), from a pose, variables and measurements in error."""
    layout, seen = StateLayout.of(sensor.variables, ()), sight(sensor, s)
    camera = replace(s.camera, variables=values_of(sensor.variables))
    error = np.concatenate([by_leading[:6], np.zeros(6), by_leading[6:]])
    state = without_map(moved(camera, error, sensor.variables), np.eye(layout.size), model, layout)
    R = np.broadcast_to(np.diag([1.0, 2.0, 3.0]), (COUNT, 3, 3))
    return start_landmarks(sensor, CAMERA, state, StereoObservation(seen.ids, seen.uvd + by_uvd), R)


# H is a chain of three: every pair of landmark, measurement and error definition meets in some case.
for _i, (_landmark, _model) in enumerate(MODELS.items()):
    for _j, (_measurement, _sensor) in enumerate(SENSORS.items()):
        _situations = visible(_sensor, situations_of(_model))

        @case(f"new landmarks: {_landmark}, {_measurement}", _situations, seeds=1)
        def _(s: Situation, model=_model, sensor=_sensor):
            new = started(model, sensor, s, np.zeros(StateLayout.of(sensor.variables, ()).measured))

            def function(e: np.ndarray) -> np.ndarray:
                return model.local(new.started.parameters, started(model, sensor, s, e).started.parameters)

            return function, new.by_leading

        _error, _definition = DEFINITIONS[(_i + _j) % len(DEFINITIONS)]
        for _update, _linearisation in UPDATES.items():
            if not _linearisation.by_jacobians:
                continue

            @case(f"H: {_landmark}, {_measurement}, {_error}, {_update}", _situations, seeds=1)
            def _(s: Situation, model=_model, sensor=_sensor, error=_definition, update=_linearisation):
                state = seen_state(model, sensor, s, StateLayout.of(sensor.variables, ()))
                index = np.arange(COUNT)[::-1].copy()
                R = np.broadcast_to(StereoNoise.independent_pixels(1.0).R, (COUNT, 3, 3))
                stages = sensor.stages(sight(sensor, s), R)

                def predicted(e: np.ndarray) -> np.ndarray:
                    other = error.moved(state, e)
                    z = sensor.predict(CAMERA, points_in_camera(other, index), other.camera.variables)
                    return np.concatenate([z @ stage.T.T for stage in stages], axis=1)

                point = error.linearisation_point(state)
                parts = [update.linearise(sensor, CAMERA, state, index, stage, point) for stage in stages]
                whole = [dense(part, len(state.P))[1].reshape(*part.innovation.shape, -1) for part in parts]
                return predicted, np.concatenate(whole, axis=1)


LAYOUTS = {"": StateLayout(), " with variables": StateLayout.of(ShearedPair().variables, BiasedOdometry().variables)}


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
# Variables are rows beside those of landmarks: each error definition meets them with one or two parametrisations.
for _i, (_error, _definition) in enumerate({**ERRORS, "right-invariant": RightInvariant(reset=True)}.items()):
    for _j, (_landmark, _model) in enumerate(MODELS.items()):
        for _layout, _places in LAYOUTS.items():
            if _layout and (_i + _j) % len(ERRORS):
                continue

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
                claimed[layout.errors : layout.size, layout.errors : layout.size] = 0.0  # padding is no error
                return lambda e: local(there, error.moved(state, delta + e), error), claimed


@pytest.mark.parametrize("named", CASES, ids=lambda named: named.name)
def test_jacobian_of_the_joint_state_equals_finite_differences(named: Case) -> None:
    assert_jacobian(named)


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_the_noise_of_a_new_landmark_is_that_of_its_measurement(model: LandmarkModel, sensor: MeasurementModel) -> None:
    """J R J^T, with the J of finite differences."""
    for situation in visible(sensor, situations_of(model)):
        s, nothing = situation(np.random.default_rng(0)), np.zeros(StateLayout.of(sensor.variables, ()).measured)
        new = started(model, sensor, s, nothing)

        def function(e: np.ndarray, s=s, nothing=nothing, new=new) -> np.ndarray:
            return model.local(new.started.parameters, started(model, sensor, s, nothing, e).started.parameters)

        J = numeric_jacobian(function, 3, s.step)
        expected = J @ np.diag([1.0, 2.0, 3.0]) @ J.transpose(0, 2, 1)
        sigmas = np.sqrt(np.einsum("mii->mi", expected))
        scale = sigmas[:, :, None] * sigmas[:, None]
        np.testing.assert_allclose(new.noise / scale, expected / scale, rtol=0, atol=1e-6)
