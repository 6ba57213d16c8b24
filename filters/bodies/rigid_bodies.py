"""Rigid bodies in the state: a point, axes, velocity and angular velocity each, all in W, and landmarks that they move.

The landmarks of a body stay points of W, which each step moves along, so that a measurement knows nothing of bodies.

Derivation: docs/derivations/rigid_bodies.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from filters.contract.validation import did_you_mean, finite_array, positive
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray

BODY_SIZE = 12
"""Error numbers of a body: point (W, m), rotation (its axes, rad, on the right), velocity of the point (W, m/s) and
angular velocity (W, rad/s)."""
P, ROTATION, V, W = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


@dataclass(frozen=True)
class RigidBodies:
    """Rigid bodies with a constant twist and white accelerations, born where landmarks move together.

    Parameters
    ----------
    sigma_acceleration : (3,) array_like
        Acceleration of the point, m/s^2, by the axes of W: right, down, ahead. An impulse of a dt begins each step.
    sigma_angular_acceleration : (3,) array_like
        The same of the angular velocity, rad/s^2.
    sigma_velocity, sigma_angular_velocity : (3,) array_like
        Prior of a new body about its first guess, m/s, and about zero, rad/s.
    smallest_turning : float
        Width, m, below which a body's turn is not estimated: the noise of its depths would be taken for a shape.
    least_points : int
        Landmarks that must move together for a body to be born.
    patience : int
        Frames without a measurement of any of its landmarks after which a body leaves the state.
    reach : float
        Distance from the landmarks of a body, m, within which others may join it.
    slowest : float
        Speed, m/s, below which a body is not born.

    Raises
    ------
    ValueError
        A number is impossible.
    """

    sigma_acceleration: tuple[float, float, float] = (1.5, 0.3, 2.5)
    sigma_angular_acceleration: tuple[float, float, float] = (0.1, 0.6, 0.1)
    sigma_velocity: tuple[float, float, float] = (3.0, 0.5, 3.0)
    sigma_angular_velocity: tuple[float, float, float] = (0.05, 0.4, 0.05)
    smallest_turning: float = 0.9
    least_points: int = 4
    patience: int = 5
    reach: float = 2.0
    slowest: float = 0.5

    def __post_init__(self) -> None:
        for name in ("sigma_acceleration", "sigma_angular_acceleration", "sigma_velocity", "sigma_angular_velocity"):
            sigmas = finite_array(name, getattr(self, name), (3,))
            if (sigmas < 0.0).any():
                raise ValueError(f"{name} must be standard deviations >= 0, got {sigmas.tolist()}")
            object.__setattr__(self, name, tuple(sigmas.tolist()))
        for name in ("smallest_turning", "reach", "slowest"):
            positive(name, getattr(self, name), allow_zero=name != "reach")
        for name, least in (("least_points", 3), ("patience", 0)):
            value = getattr(self, name)
            if type(value) is not int or value < least:
                raise ValueError(f"{name} must be an integer >= {least}, got {value!r}")

    @classmethod
    def of(cls, option: RigidBodies | Mapping[str, Any] | bool | None) -> RigidBodies | None:
        """The bodies of an option: None or False for none, True for the defaults, or a table of settings.

        Raises
        ------
        ValueError
            It is something else, or names a setting that does not exist.
        """
        if option is None or option is False:
            return None
        if option is True:
            return cls()
        if isinstance(option, cls):
            return option
        if not isinstance(option, Mapping):
            raise ValueError(f"bodies must be RigidBodies, a table of its settings or None, got {option!r}")
        names = [one.name for one in fields(cls)]
        for name in option:
            if name not in names:
                raise ValueError(f"bodies has no setting {name!r}{did_you_mean(str(name), names)}: {', '.join(names)}")
        return cls(**option)

    def noise(self, dt: float, turning: bool) -> FloatArray:
        """Covariance (12, 12) of the impulses that begin a step of `dt` seconds."""
        angular = self.sigma_angular_acceleration if turning else _STILL
        return np.diag(np.concatenate([np.zeros(6), self.sigma_acceleration, angular]) * dt) ** 2

    def prior(self, turning: bool) -> FloatArray:
        """Covariance (6, 6) of the twist of a new body, besides that of its first guess."""
        return np.diag([*self.sigma_velocity, *(self.sigma_angular_velocity if turning else _STILL)]) ** 2


_STILL = (1e-3, 2e-3, 1e-3)
"""Angular velocity, rad/s, and acceleration, rad/s^2, of a body whose turn is not estimated."""


@dataclass(frozen=True, eq=False)
class BodyStep:
    """Steps of K bodies with a constant twist, and what they do to points of W."""

    points: FloatArray
    """(K, 3): the bodies' points before the step, m."""
    moved: FloatArray
    """(K, 13): point, orientation (xyzw), velocity and angular velocity after it."""
    F: FloatArray
    """(K, 12, 12): Jacobian by the errors before it."""
    D: FloatArray
    """(K, 3, 3): rotation of the step."""
    by_velocity: FloatArray
    """(K, 3, 3): Jacobian of a shift by the velocity."""
    by_turn: FloatArray
    """(K, 3, 3): Jacobian of the shift of the body's point by the angular velocity."""

    @classmethod
    def of(cls, bodies: FloatArray, dt: float) -> BodyStep:
        """Step of `dt` seconds of bodies (K, 13): m' = p + s + D (m - p), s = J_l(omega dt) v dt, D = Exp(omega dt)."""
        p, q, v, w = bodies[:, :3], bodies[:, 3:7], bodies[:, 7:10], bodies[:, 10:]
        D, J = rotations.exp(w * dt), dt * rotations.right_jacobian(-w * dt)
        turned_v, R = rotations.turned(D, v), rotations.matrix(q)
        by_turn = np.zeros((len(bodies), 3, 3))
        for k in range(len(bodies)):
            by_turn[k] = dt * np.reshape(rotations.left_jacobian_derivative_of(*w[k] * dt, *v[k] * dt), (3, 3))
        F = np.tile(np.eye(BODY_SIZE), (len(bodies), 1, 1))
        F[:, P, V], F[:, P, W] = J, by_turn
        F[:, ROTATION, W] = (D @ R).transpose(0, 2, 1) @ J
        F[:, V, V], F[:, V, W] = D, -rotations.skew(turned_v) @ J
        turned_q = rotations.multiply(rotations.exp_quaternion(w * dt), q)
        moved = np.hstack([p + rotations.turned(J, v), turned_q, turned_v, w])
        return cls(p, moved, F, D, J, by_turn)

    def carry(self, k: IntArray, points_w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points of W (N, 3) on the bodies k (N,) after the step, and their Jacobians (N, 3, 12) by its errors."""
        D = self.D[k]
        turned = rotations.turned(D, points_w - self.points[k])
        by_body = np.zeros((len(points_w), 3, BODY_SIZE))
        by_body[:, :, P], by_body[:, :, V] = np.eye(3) - D, self.by_velocity[k]
        by_body[:, :, W] = self.by_turn[k] - rotations.skew(turned) @ self.by_velocity[k]
        return self.moved[k, :3] + turned, by_body


@dataclass(frozen=True, eq=False)
class BodiesBelief:
    """Belief of the K moving bodies in the state."""

    ids: IntArray
    """(K,): ascending; the variable of body 3 is "body-3"."""
    positions: FloatArray
    """(K, 3), m, in W: of a point that moves with the body, the centre of its landmarks when it was born."""
    orientations: FloatArray
    """(K, 4), xyzw: of axes that move with the body, those of the camera when it was born."""
    linear: FloatArray
    """(K, 3), m/s, in W: velocity of the point."""
    angular: FloatArray
    """(K, 3), rad/s, in W."""
    covariances: FloatArray
    """(K, 12, 12), of position (W, m), rotation (axes of the body, rad, on the right), linear and angular velocity."""
    turning: BoolArray
    """(K,): whether the turn is estimated; of narrow bodies it is held at zero."""
    landmarks: tuple[IntArray, ...]
    """Ids of the landmarks in the map that are on each."""
    motion: RigidBodies
    """How they move."""
    dt: float
    """Step of the filter, s."""

    def __len__(self) -> int:
        return len(self.ids)

    def predict(self, seconds: float) -> BodiesBelief:
        """Belief so many seconds later, by steps like the last one of the filter, without measurements.

        Raises
        ------
        ValueError
            `seconds` is negative or not finite.
        """
        positive("seconds", seconds, allow_zero=True)
        count = math.ceil(seconds / self.dt - 1e-9)
        values = np.hstack([self.positions, self.orientations, self.linear, self.angular])
        covariances = self.covariances
        for k in range(count):
            dt = seconds - (count - 1) * self.dt if k == count - 1 else self.dt
            step = BodyStep.of(values, dt)
            noise = np.array([self.motion.noise(dt, turning) for turning in self.turning]).reshape(covariances.shape)
            values, covariances = step.moved, step.F @ (covariances + noise) @ step.F.transpose(0, 2, 1)
        p, q, v, w = np.split(values, [3, 7, 10], axis=1)
        return replace(self, positions=p, orientations=q, linear=v, angular=w, covariances=covariances)
