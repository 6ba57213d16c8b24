"""The joint state as a point of its manifold, dense, from the plain functions of the parts: what the engine is held to.

Corrections and differences are in the standard coordinates of P. What the engine has is read from it: H from its
scratch, the retraction by a measurement of the whole error.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from filters import StereoEKF, StereoObservation
from filters.contract.outputs import VELOCITY
from filters.geometry import rotations, symmetric
from filters.geometry.derivatives import columns_of, jacobian_of
from filters.geometry.vectors import turned_by
from filters.joint_state import Clone, JointState, StateLayout
from filters.motions.motion_model import POSITION, ROTATION, CameraState


def turned(q: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Orientation with a rotation vector on the right."""
    return (Rotation.from_quat(q) * Rotation.from_rotvec(theta)).as_quat()


def turn_between(q: np.ndarray, other: np.ndarray) -> np.ndarray:
    return (Rotation.from_quat(q).inv() * Rotation.from_quat(other)).as_rotvec()


def own_blocks(state: JointState) -> np.ndarray:
    """Blocks of landmarks that are no points of W, whose numbers have a retraction of their own."""
    if state.model.in_world:
        return state.parameter_block[:0]
    free = state.anchor_block < 0 if state.model.anchored else np.zeros(len(state), dtype=bool)
    return state.parameter_block[~free]


def plus(state: JointState, e: np.ndarray) -> JointState:
    """The state with errors (n,) added."""
    layout, camera = state.layout, state.camera
    by_block = e[layout.size :].reshape(-1, state.size)
    blocks, own = state.blocks.copy(), own_blocks(state)
    blocks[:, :3] += by_block[:, :3]
    if len(own):
        blocks[own] = columns_of(state.model.retract_by, state.blocks[own], by_block[own])
    others = {
        x.name: x.retraction.retract(camera.variables[x.name], e[layout.places[x.name]]) for x in layout.variables
    }
    clones = {
        name: Clone(
            clone.position + by_block[clone.blocks[0], :3],
            turned(clone.orientation, by_block[clone.blocks[1], :3]),
            clone.blocks,
        )
        for name, clone in state.clones.items()
    }
    moved = CameraState(
        camera.position + e[POSITION],
        turned(camera.orientation, e[ROTATION]),
        camera.linear_velocity + e[layout.linear_velocity],
        camera.angular_velocity + e[layout.angular_velocity],
        others,
    )
    return replace(state, camera=moved, blocks=blocks, clones=clones)


def minus(state: JointState, other: JointState) -> np.ndarray:
    """Errors (n,) that lead from `state` to `other`."""
    layout, here, there = state.layout, state.camera, other.camera
    e = np.zeros(len(state.P))
    e[POSITION], e[ROTATION] = there.position - here.position, turn_between(here.orientation, there.orientation)
    e[layout.linear_velocity] = there.linear_velocity - here.linear_velocity
    e[layout.angular_velocity] = there.angular_velocity - here.angular_velocity
    for x in layout.variables:
        e[layout.places[x.name]] = x.retraction.local(here.variables[x.name], there.variables[x.name])
    blocks, own = np.zeros((len(state.blocks), state.size)), own_blocks(state)
    blocks[:, :3] = other.blocks[:, :3] - state.blocks[:, :3]
    if len(own):
        blocks[own] = columns_of(state.model.local_by, state.blocks[own], other.blocks[own])
        if state.model.additive:  # azimuth, the first number, is an angle
            blocks[own, 0] = np.arctan2(np.sin(blocks[own, 0]), np.cos(blocks[own, 0]))
    for name, clone in state.clones.items():
        now = other.clones[name]
        blocks[clone.blocks, :3] = (now.position - clone.position, turn_between(clone.orientation, now.orientation))
    e[layout.size :] = blocks.ravel()
    return e


def at_first_estimates(state: JointState) -> JointState:
    """The state with the predicted variables and the map as it was first estimated."""
    blocks, own = state.first_blocks.copy(), own_blocks(state)[:, None]
    follows = np.array(state.model.follows, dtype=np.int64)
    blocks[own, follows] = state.blocks[own, follows]
    return replace(state, camera=state.predicted, blocks=blocks)


def gamma(state: JointState) -> np.ndarray:
    """Effect of a rotation of the world about its origin on the errors, (n, 3)."""
    own = own_blocks(state)
    effect = np.zeros((len(state.blocks), state.size, 3))
    effect[:, :3] = -rotations.skew(state.blocks[:, :3])
    for clone in state.clones.values():
        effect[clone.blocks, :3] = -rotations.skew(clone.position), rotations.matrix(clone.orientation).T
    for one in state.added.values():
        if not one.variable.in_world:
            effect[one.blocks] = 0.0

    def around(theta, y):
        h = state.model.point_of(y)
        return state.model.local_by(y, state.model.start_from((*turned_by(theta, h[:3]), *h[3:])))

    if len(own):
        effect[own] = jacobian_of(around, np.zeros((len(own), 3)), state.blocks[own])[1]
    return np.vstack([gamma_of_variables(state.layout, state.camera), effect.reshape(-1, 3)])


def gamma_of_variables(layout: StateLayout, camera: CameraState) -> np.ndarray:
    """Effect of a rotation of the world on the errors of the variables, (c, 3)."""
    effect = np.zeros((layout.size, 3))
    effect[POSITION], effect[ROTATION] = -rotations.skew(camera.position), camera.R_wc.T
    effect[layout.linear_velocity] = -rotations.skew(camera.linear_velocity)
    for variable in layout.variables:
        effect[layout.places[variable.name]] = variable.world_rotation(camera.variables[variable.name])
    return effect


def constrained(J: np.ndarray, image: np.ndarray, predicted: CameraState, layout: StateLayout) -> np.ndarray:
    """Jacobian by the variables that takes a rotation of the world to its image, as first estimates have it."""
    adjusted = J.copy()
    adjusted[:, ROTATION] += (image - J @ gamma_of_variables(layout, predicted)) @ predicted.R_wc
    return adjusted


def translations(state: JointState) -> np.ndarray:
    """Effect of a shift of the world on the errors, (n, 3)."""
    blocks = np.tile(np.eye(3), (len(state.blocks), 1, 1))
    blocks[state.parameter_block[state.anchor_block >= 0]] = 0.0
    leading = np.zeros((state.layout.size, 3))
    leading[POSITION] = np.eye(3)
    return np.vstack([leading, blocks.reshape(-1, 3)])


def values_at(slam: StereoEKF, camera: CameraState) -> dict[str, np.ndarray]:
    """Values that the sensor takes."""
    felt = np.concatenate([camera.R_wc.T @ camera.linear_velocity, camera.angular_velocity])
    return {**camera.variables, VELOCITY: felt}


def measured(slam: StereoEKF, state: JointState) -> np.ndarray:
    """Numbers of the sensor for all landmarks of a state, (N, s)."""
    seen = state.model.relative_to(state.camera.position, state.anchors(), state.parameters()).homogeneous
    points_c = np.hstack([seen[:, :3] @ state.camera.R_wc, seen[:, 3:]])
    return slam.options.measurement.predict(slam.camera, points_c, values_at(slam, state.camera))


def started(slam: StereoEKF, state: JointState, uvd: np.ndarray) -> np.ndarray:
    """Values of the landmarks that start at measurements (M, 3), (M, v)."""
    camera, model = state.camera, state.model
    points_c = slam.options.measurement.backproject(slam.camera, uvd, values_at(slam, camera))
    seen = np.hstack([points_c[:, :3] @ camera.R_wc.T, points_c[:, 3:]])
    if not model.anchored:
        seen[:, :3] += camera.position * seen[:, 3:4]
    return columns_of(model.start_from, seen)


@dataclass(frozen=True)
class Linearised:
    """Measurements of M landmarks as an update has linearised them, the last stage."""

    innovation: np.ndarray
    """(M, k)."""
    H: np.ndarray
    """(M, k, n), by all errors."""
    R: np.ndarray
    """(M, k, k)."""

    def innovation_covariances(self, P: np.ndarray) -> np.ndarray:
        """S of each, from the lower triangle of P."""
        return self.H @ symmetric.full(P) @ self.H.transpose(0, 2, 1) + self.R


def linearised(slam: StereoEKF, observation: StereoObservation) -> Linearised:
    """What an update of landmarks that are all in the map would make of them; no landmark may leave."""
    twin = copy.deepcopy(slam)
    twin.update(observation)
    recipe, room, n, count = twin.engine.recipe, twin.engine.scratch(0), len(slam.state.P), len(observation)
    plan, variant = recipe.plan, int(observation.v_right is not None)
    k = int(plan.rows[variant, plan.stages[variant] - 1, 0])
    H, own = np.zeros((count, k, n)), plan.measured + 3 * plan.anchors
    for m in range(count):
        given, (anchor, first) = room.H[m, :k], room.base[m]
        H[m, :, : plan.measured] = given[:, : plan.measured]
        if plan.anchors:
            H[m, :, anchor : anchor + 3] += given[:, plan.measured : own]
        H[m, :, first : first + plan.size] += given[:, own : own + plan.size]
    return Linearised(room.nu[:count, :k].copy(), H, room.R[:count, :k, :k].copy())


def retracted(slam: StereoEKF, delta: np.ndarray) -> JointState:
    """State of a filter moved by delta (n,), whatever its P, which stays."""
    twin, state = copy.deepcopy(slam), slam.state
    twin.state = replace(state, P=np.asfortranarray(np.eye(len(delta))))
    return replace(moved_by(twin, delta)[0], P=state.P)


def moved_by(slam: StereoEKF, delta: np.ndarray) -> tuple[JointState, np.ndarray]:
    """State of a filter that a measurement says to be wrong by delta (n,), and how it carries P along: J P J^T."""
    twin, n = copy.deepcopy(slam), len(delta)
    P = symmetric.full(twin.state.P)
    twin.engine.correct(0, np.arange(n), np.eye(n), 2.0 * delta, P, np.inf)  # the gain is 1 / 2, and P / 2 is left
    return twin.state, 2.0 * symmetric.full(twin.state.P)
