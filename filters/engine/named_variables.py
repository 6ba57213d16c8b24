"""Named variables of a filter: beliefs, linear measurements of them, clones of the pose, others that come and go."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.noise import gate_limit
from filters.contract.outputs import (
    POSE,
    VELOCITY,
    Correction,
    MovedLandmarks,
    PoseBelief,
    Variable,
    VariableBelief,
    VariableSteps,
)
from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import covariance_matrix, finite_array, gate_probability, require_known
from filters.engine.options import Options
from filters.geometry.arrays import IntArray
from filters.geometry.poses import ADDITIVE, Pose, relative_jacobian
from filters.motions.motion_model import CameraState

if TYPE_CHECKING:
    from filters.engine.row import Row


class VariableFilter(StereoFilter):
    """Filter whose state is a list of named variables, and a map."""

    options: Options
    _row: Row

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map, (N,), ascending; cheaper to ask than `landmarks`."""
        return self._row.ids

    @property
    def camera_state(self) -> CameraState:
        """Values of pose, velocity and variables, without their covariance."""
        return self._row.camera

    def correct(
        self, innovation: ArrayLike, H: Mapping[Any, ArrayLike], R: ArrayLike, gate: float | None = None
    ) -> Correction:
        """Correct with any measurement, linearised: zero velocity, GPS, wheels, a plane, a loop, a window of poses.

        Parameters
        ----------
        innovation : (k,) array_like
            Measured minus predicted.
        H : mapping of str, int or tuple of them to (k, s) array_like
            Jacobian of the measurement by the errors of variables and clones ("pose", "velocity", "bias", ...), and of
            landmarks by their ids: of the anchor (3), where the landmark has one, then its own (3, or as many as it
            has); of a tuple by those of all its names. What is not named does not matter to the measurement.
        R : (k, k) array_like
            Covariance of the measurement; zero rows are constraints.
        gate : float, optional
            Probability with which a consistent measurement is used. None: it always is.

        Returns
        -------
        Correction
            Whether it was used, and its normalised innovation squared.

        Raises
        ------
        ValueError
            There is no such variable or landmark, a shape is wrong, or a number is not finite.
        """
        limit, nu = np.inf, finite_array("innovation", innovation, ("k",))
        if len(nu) == 0 or not isinstance(H, Mapping) or not H:
            raise ValueError("H must name at least one variable, and innovation must have at least one number")
        if (gate := gate_probability(gate)) is not None:
            limit = gate_limit(gate, len(nu))
        rows = self._row.rows_of(H)
        parts = [finite_array(f"H of {n!r}", H[n], (len(nu), len(at))) for n, at in zip(H, rows, strict=True)]
        R = covariance_matrix("R", R, len(nu))
        nis, used = self._row.correct(nu, np.concatenate(rows), np.hstack(parts), R, limit)
        return Correction(used, nis, len(nu))

    def belief(self, *names: str) -> VariableBelief:
        """Belief of named variables: "pose", "velocity", one that a part has asked for, or a clone of the pose.

        Of several, their values one after the other, and their joint covariance.

        Raises
        ------
        ValueError
            There is no variable of such a name.
        """
        camera = self.camera_state
        variables = {
            POSE: np.concatenate([camera.position, camera.orientation]),
            VELOCITY: np.concatenate([camera.linear_velocity, camera.angular_velocity]),
            **camera.variables,
            **self._row.held_values(),
        }
        require_known("there is no variable", names, variables)
        return VariableBelief(np.concatenate([variables[name] for name in names]), self._row.joint(*names))

    @property
    def clones(self) -> tuple[str, ...]:
        """Names of the clones of the pose, in the order in which they were made."""
        return tuple(name for name, one in self._row.held.items() if one.variable is None)

    def clone_pose(self, name: str) -> None:
        """Keep the present pose as a variable of that name, correlated with all others, until it is forgotten.

        Raises
        ------
        ValueError
            There is a variable of that name already.
        """
        if not isinstance(name, str):
            raise ValueError(f"name must be a string, got {name!r}")
        self._require_new(name)
        self._row.clone_pose(name)

    def forget_clone(self, name: str) -> None:
        """Marginalise a clone of the pose out.

        Raises
        ------
        ValueError
            There is no clone of that name.
        """
        require_known("there is no clone", [name], self.clones)
        self._row.remove(name)

    def relative_pose(self, name: str) -> PoseBelief:
        """Pose of the camera as seen from a clone of an earlier one: how the camera has moved since.

        Its covariance holds the correlation of both poses, so what is common to both, such as the error of an early
        heading, is not in it.

        Raises
        ------
        ValueError
            There is no clone of that name.
        """
        require_known("there is no clone", [name], self.clones)
        camera, clone = self._row.camera, self._row.held_values()[name]
        first, last = Pose(clone[:3], clone[3:]), Pose(camera.position, camera.orientation)
        J, moved = relative_jacobian(first, last), first.inverse() @ last
        return PoseBelief(moved.position, moved.orientation, J @ self._row.joint(name, POSE) @ J.T)

    def add_variable(self, variable: Variable, H: Mapping[Any, ArrayLike] | None = None) -> None:
        """Add a variable to the state: a body that has come into view, a door, a second sensor.

        Parameters
        ----------
        variable : Variable
            Its name, value and prior; `random_walk` is added in every step. Its retraction is addition, and it is
            estimated.
        H : mapping of str, int or tuple of them to (s, w) array_like, optional
            Where the value is made of what the filter knows: its Jacobian by the errors of variables and landmarks,
            named as in `correct`. Its error is the sum of these and one of its own, whose covariance is the variable's.

        Raises
        ------
        ValueError
            There is a variable of that name, it is considered or has another retraction, or an array has a wrong shape.
        """
        self._require_new(variable.name)
        if variable.considered or variable.retraction is not ADDITIVE:
            raise ValueError(f"variable {variable.name!r} must be estimated, and its retraction addition")
        H = {} if H is None else H
        J = {name: finite_array(f"H of {name!r}", H[name], (variable.size, "w")) for name in H}
        for (name, jacobian), rows in zip(J.items(), self._row.rows_of(J), strict=True):
            finite_array(f"H of {name!r}", jacobian, (variable.size, len(rows)))
        self._row.add(variable, J)

    def remove_variable(self, name: str) -> None:
        """Marginalise an added variable or a clone out.

        Raises
        ------
        ValueError
            None of that name was added.
        """
        require_known("there is no added variable", [name], self._row.held)
        self._row.remove(name)

    def move_variable(
        self,
        name: str | tuple[str, ...],
        value: ArrayLike,
        F: ArrayLike,
        Q: ArrayLike,
        landmarks: MovedLandmarks | None = None,
    ) -> None:
        """Step of an added variable, perhaps with landmarks that it carries along, such as those on a moving body.

        P becomes T (P + Q) T^T, T the identity but for these rows: noise stands before the step, as in Eq. 6. Call it
        between `predict` and `update`.

        Parameters
        ----------
        name : str or tuple of str
            An added variable, or a clone of the pose; of several, all below is one after the other.
        value : (v,) array_like
            After the step; of a clone position and orientation (7,).
        F, Q : (s, s) array_like
            Jacobian by the error before the step, and the covariance of the noise that is added to it.
        landmarks : MovedLandmarks, optional
            Landmarks in the map that move with it. They must have a finite position.

        Raises
        ------
        ValueError
            There is no such variable or landmark, or a shape is wrong.
        """
        names = (name,) if isinstance(name, str) else tuple(name)
        require_known("there is no added variable", names, self._row.held)
        values = self._row.held_values()
        size = sum(len(rows) for rows in self._row.rows_of(names))
        numbers = finite_array("value", value, (sum(len(values[one]) for one in names),))
        moved = MovedLandmarks.none(size) if landmarks is None else landmarks
        finite_array("landmarks.by_variable", moved.by_variable, (len(moved.ids), 3, size))
        unknown = moved.ids[~np.isin(moved.ids, self.ids)]
        if len(unknown):
            raise ValueError(f"landmarks.ids must be in the map, not there: {unknown[:5].tolist()}")
        if not np.isfinite(self._row.landmark_positions(moved.ids)).all():
            raise ValueError("landmarks must have a finite position to be moved: forget those at infinity")
        F, Q = finite_array("F", F, (size, size)), covariance_matrix("Q", Q, size)
        carriers = np.zeros(len(moved.ids), dtype=np.int64)
        self._row.move(VariableSteps((names,), numbers[None], F[None], Q[None], moved, carriers))

    def _require_new(self, name: str) -> None:
        if name in (*self.options.layout.places, *self._row.held):
            raise ValueError(f"name must be new, there is a variable {name!r} already: remove_variable it first")
