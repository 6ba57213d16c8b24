"""Callbacks of the kernels to parts that give their numbers by NumPy.

The kernels do all the algebra. Where a part has no kernel of its own they call back, and the part sees the state of the
filter as it is at that moment (`JointState`, on the arrays of the storage) and answers with numbers in the scratch.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from filters.contract.inputs import StereoObservation
from filters.contract.validation import unchecked
from filters.engine.frames import ValuePlaces
from filters.engine.new_landmarks import can_start, start_landmarks
from filters.engine.options import Options
from filters.engine.steps import measure_odometry, predict_camera
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.kernels.blas import PLAIN
from filters.kernels.linearisation import FIRST, MOVED
from filters.kernels.recipe import Recipe
from filters.kernels.records import CLONE_POSITION, POINT, REJECTED, STARTED, FrameArrays, Scratch, Storage
from filters.kernels.retraction import SETTLED
from filters.measurements.measurement_model import Stage
from filters.motions.motion_model import ROTATION, StepInput
from filters.state.joint_state import Clone, JointState, world_rotation_of_variables
from filters.state.layout import LinearisedMeasurements, Transport
from filters.updates.extended import Extended, points_in_camera

_DOOR = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 7)


class Room(Protocol):
    """Where the numbers go: the arrays of an engine."""

    recipe: Recipe

    @property
    def storage(self) -> Storage:
        """State of the filters."""

    @property
    def frame(self) -> FrameArrays:
        """What the frame brings."""

    def scratch(self, thread: int) -> Scratch:
        """Room of a thread."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of the filters of an engine, and the rig."""

    camera: StereoCamera
    """The rig."""
    options: Options
    """Of the filters."""


class Doors:
    """The doors of an engine.

    Attributes
    ----------
    address : int
        What the kernels call.
    failure : BaseException or None
        What a part has raised since `failure` was last taken away.
    """

    def __init__(self, parts: Parts, room: Room) -> None:
        self._rig, self._options, self._room = parts.camera, parts.options, room
        self._values = ValuePlaces(parts.options.layout)
        rows = parts.options.layout.rows_of(parts.options.motion.moves)
        self._moved = None if np.array_equal(rows, parts.options.layout.rows) else rows
        self._rows = tuple(parts.options.measurement.rows(with_right) for with_right in (False, True))
        self._noise: dict[int, FloatArray] = {}
        self._after: dict[int, tuple[JointState, Transport]] = {}
        self._answers = (
            self._linearise,
            self._move,
            self._start,
            self._change,
            self._walk,
            self._drift,
        )
        self.failure: BaseException | None = None
        self._entry = None if PLAIN else _DOOR(self._answer)
        self.address: Any = self._answer if PLAIN else ctypes.cast(self._entry, ctypes.c_void_p).value  # type: ignore[arg-type]

    def _answer(self, what: int, b: int, thread: int, *numbers: int) -> None:
        room = self._room.scratch(thread)
        try:
            self._answers[what](b, room, *numbers)
        except BaseException as error:  # whatever is raised must wait until the kernels have ended
            self.failure = error
            room.door[1] = 1

    # --- before the frame ---

    def predict(self, b: int, dt: float, odometry: StepInput | None) -> tuple[FloatArray, ...]:
        """The step of filter b by numbers: values, F and Q of the leading rows; then nu, H and R of the odometry."""
        motion, layout, error = self._options.motion, self._options.layout, self._options.error
        before = self._values.camera(self._room.storage.x[b].copy())
        predicted = predict_camera(motion, before, dt, odometry)
        measured = None if odometry is None else measure_odometry(motion, predicted.state, dt, odometry)
        F, Q, rows = predicted.F, predicted.G @ predicted.Q @ predicted.G.T, self._moved
        if rows is not None:
            F, Q = np.eye(layout.size), np.zeros((layout.size, layout.size))
            F[np.ix_(rows, rows)], Q[np.ix_(rows, rows)] = predicted.F, predicted.G @ predicted.Q @ predicted.G.T
        if layout.walk_rates is not None:
            Q[layout.rows, layout.rows] += layout.walk_rates * dt
        if error.constrains:
            F = error.constrained(F, world_rotation_of_variables(layout, predicted.state), self.view(b))
        step = (self._values.of(predicted.state), F, Q)
        if measured is None:
            return step
        H = measured.H
        if rows is not None:
            H = np.zeros((len(H), layout.size))
            H[:, rows] = measured.H
        return (*step, measured.innovation, H, measured.R)

    # --- the state, as parts see it ---

    def view(self, b: int, room: Scratch | None = None) -> JointState:
        """Filter b on the arrays of the storage, or where a correction has moved it to in a scratch."""
        S, layout, model = self._room.storage, self._options.layout, self._options.landmark
        landmarks, blocks = S.counts[b].tolist()
        n = layout.size + model.size * blocks
        x, values = (S.x[b], S.blocks[b]) if room is None else (room.moved, room.moved_blocks)
        held = S.held[b][S.held[b] >= 0]
        return JointState(
            layout,
            self._values.camera(x.copy()),
            S.P[b, :n, :n].T,
            model,
            self._values.camera(S.predicted[b]),
            values[:blocks, : model.value_size],
            S.first[b, :blocks, : model.value_size],
            S.ids[b, :landmarks],
            S.own[b, :landmarks],
            S.anchor[b, :landmarks, 0],
            held=held,
            clones={**clones_at(values, S.kind[b], held), **anchor_poses(values, S.anchor[b, :landmarks])},
        )

    # --- in the frame ---

    def _linearise(self, b: int, room: Scratch, count: int, where: int, variant: int, number: int) -> None:
        """Innovation, H and R of the selected measurements."""
        options = self._options
        moved_here = where == MOVED and self._room.recipe.plan.moves_by_numbers
        state = self._after[int(room.door[0])][0] if moved_here else self.view(b, room if where == MOVED else None)
        selected = room.select[:count]
        if where == FIRST:
            self._noise[int(room.door[0])] = room.R.copy()
            ahead = options.measurement.in_front(points_in_camera(state, room.land[selected]))
            room.ahead[selected] = ahead
            selected = selected[ahead]
        if len(selected) == 0:
            return
        index, T = room.land[selected], np.array(self._rows[variant][number].T)
        weighted = where == MOVED and options.tail_dof is not None
        R = room.R if weighted else self._noise[int(room.door[0])]
        stage = Stage(room.z[selected, : len(T)], T, R[selected, : len(T), : len(T)])
        point = options.error.linearisation_point(state)
        linear = options.update.linearise(options.measurement, self._rig, state, index, stage, point)
        if moved_here:
            linear = self._after[int(room.door[0])][1].pulled_back(linear, room.delta[: len(state.P)].copy())
        self._write(room, selected, linear)

    def _write(self, room: Scratch, selected: IntArray, linear: LinearisedMeasurements) -> None:
        size = linear.innovation.shape[1]
        measured = self._options.layout.measured
        room.nu[selected, :size] = linear.innovation
        room.H[selected, :size, :measured] = linear.by_leading
        room.H[selected, :size, measured : measured + linear.by_map.shape[2]] = linear.by_map
        room.R[selected, :size, :size] = linear.R
        anchors, own = self._room.recipe.plan.anchors, -self._options.landmark.size
        room.base[selected, 2 - anchors : 2] = linear.map_rows[:, :own:3]
        room.base[selected, 2] = linear.map_rows[:, own]

    def _move(self, b: int, room: Scratch, what: int, *_: int) -> None:
        """The state corrected by delta, and the Jacobian that carries P along."""
        state, error = self.view(b), self._options.error
        n, size = len(state.P), self._options.layout.size
        delta = room.delta[:n].copy()
        moved = error.moved(state, delta)
        step = error.transport(state, moved, delta)
        if what == SETTLED and error.constrains:
            image = world_rotation_of_variables(state.layout, moved.camera)
            step = replace(step, leading=error.constrained(step.leading, image, state))
        self._after[int(room.door[0])] = moved, step
        room.moved[:] = self._values.of(moved.camera)
        room.moved_blocks[: len(moved.blocks), : moved.blocks.shape[1]] = moved.blocks
        for clone in moved.clones.values():
            room.moved_blocks[clone.blocks[0], :3], room.moved_blocks[clone.blocks[1], :4] = (
                clone.position,
                clone.orientation,
            )
        room.F[:] = step.leading
        room.result[:] = step.own is not None, step.by_rotation is not None
        if step.own is not None and step.rows is not None:
            room.D[: len(moved.blocks)] = np.eye(state.size)
            room.D[(step.rows[:, 0] - size) // state.size] = step.own
        if step.by_rotation is not None:  # the rotation error is that at the corrected state by then
            room.W[:size] = 0.0
            room.W[size:n] = np.linalg.solve(step.leading[ROTATION, ROTATION].T, step.by_rotation.T).T

    def _start(self, b: int, room: Scratch, first: int, last: int, *_: int) -> None:
        """Landmarks at those of the measurements first to last - 1 that can start."""
        state, frame, options = self.view(b), self._room.frame, self._options
        unknown = first + np.flatnonzero(room.where[: last - first] < 0)
        least = -np.inf if options.min_disparity is None else options.min_disparity
        able = can_start(options.measurement, self._rig, state, frame.uvd[unknown], least)
        frame.fates[unknown] = np.where(able, STARTED, REJECTED)
        chosen = unknown[able]
        room.place[: len(chosen)] = chosen - first
        room.result[0] = count = len(chosen)
        if count == 0:
            return
        seen = unchecked(StereoObservation, ids=frame.ids[chosen], uvd=frame.uvd[chosen], v_right=None, R=None)
        new = start_landmarks(options.measurement, self._rig, state, seen, frame.R[chosen])
        J, parameters = new.by_leading, new.started.parameters
        anchored = new.started.anchored | options.landmark.in_anchor
        by_anchor = np.eye(len(room.by_anchor), J.shape[2])
        if options.error.constrains:
            here = np.where(anchored[:, None], state.camera.position, np.nan)
            effect = state.model.world_rotation(here, parameters)
            J = options.error.constrained(J.reshape(-1, J.shape[2]), effect.reshape(-1, 3), state).reshape(J.shape)
            by_anchor = options.error.constrained(by_anchor, -rotations.skew(state.camera.position), state)
        room.values[:count, : parameters.shape[1]] = parameters
        room.H[:count, : J.shape[1], : J.shape[2]] = J
        room.values_noise[:count] = new.noise
        room.anchored[:count] = anchored
        room.by_anchor[:] = by_anchor

    def _change(self, b: int, room: Scratch, *_: int) -> None:
        """Landmarks that are practically Gaussian in XYZ become XYZ (Eq. 4)."""
        S, state = self._room.storage, self.view(b)
        if len(state) == 0:
            return
        own = state.own_rows()
        linear = self._options.landmark.become_points(
            state.camera.position, state.anchors(), state.parameters(), state.P[own, own]
        )
        index = np.flatnonzero(linear)
        if len(index) == 0:
            return
        np.subtract.at(S.users[b], S.anchor[b, index, 0], 1)
        S.kind[b, state.parameter_block[index]] = POINT
        state.become_points(index, self._options.error.linearisation_point(state) or state)

    def _walk(self, b: int, room: Scratch, *_: int) -> None:
        """Landmarks as seen from the camera, in W, and the directions that vision cannot see, in `HP`."""
        state = self.view(b)
        at, count = self._options.error.linearisation_point(state) or state, len(state)
        seen = state.model.point(points_in_camera(state, np.arange(count)))
        room.points[:count, :3], room.points[:count, 3] = seen[:, :3] @ state.camera.R_wc.T, seen[:, 3]
        shift = at.world_translation()
        B = np.hstack([at.world_rotation() + shift @ rotations.skew(at.camera.position), shift])
        for name, clone in at.clones.items():  # they stay where the camera was, those that no landmark hangs on
            if isinstance(name, str):
                B[at.block_rows(clone.blocks)] = 0.0
        room.HP[:6, : len(B)] = B.T

    def _drift(self, b: int, room: Scratch, count: int, *_: int) -> None:
        """H of (u, v, d) of the selected landmarks."""
        sensor, state, selected = self._options.measurement, self.view(b), room.select[:count]
        stage = Stage(np.zeros((count, 3)), np.eye(3, sensor.size), room.noise[selected])
        point = self._options.error.linearisation_point(state)
        linear = Extended().linearise(sensor, self._rig, state, room.land[selected], stage, point)
        self._write(room, selected, linear)


def anchor_poses(values: FloatArray, anchors: IntArray) -> dict[str | int, Clone]:
    """Poses that are anchors (N, 2), copies, by the block of their position."""
    poses = np.unique(anchors[anchors[:, 1] >= 0], axis=0)
    return {int(p): Clone(values[p, :3].copy(), values[q, :4].copy(), np.array([p, q])) for p, q in poses}


def clones_at(values: FloatArray, kind: IntArray, held: IntArray) -> dict[str | int, Clone]:
    """Clones of the pose among the held blocks, copies, in the order in which they were made, by their numbers."""
    positions = np.flatnonzero(kind[held] == CLONE_POSITION)
    return {
        str(number): Clone(values[held[k], :3].copy(), values[held[k + 1], :4].copy(), held[k : k + 2])
        for number, k in enumerate(positions)
    }
