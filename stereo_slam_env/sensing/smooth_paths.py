"""Smooth paths of a camera in closed form, sums of waves with random phases: a car's and one through the air.

Their frame has x right, y down and z forward, level; accelerations are continuous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from filters.geometry.arrays import FloatArray
from stereo_slam_env.sensing.imu import Path

_SUSPENSION = 0.007
"""Roll and pitch of a car's body by the acceleration, rad per m/s^2."""


def velocity_on(path: Path, t: float) -> FloatArray:
    """Linear velocity in W and angular velocity in the camera frame, (6,)."""
    h = 1e-4
    at, R = path(np.array([t - h, t + h]))
    return np.concatenate([(at[1] - at[0]) / (2.0 * h), (R[0].inv() * R[1]).as_rotvec() / (2.0 * h)])


@dataclass(frozen=True, eq=False)
class _Waves:
    """A sum of sines: amplitudes, angular frequencies and phases, (N,) each."""

    amplitudes: FloatArray
    frequencies: FloatArray
    phases: FloatArray

    @classmethod
    def drawn(cls, amplitudes: Sequence[float], frequencies: Sequence[float], rng: np.random.Generator) -> _Waves:
        """Draw waves with random phases, and amplitudes and frequencies up to a fifth off."""
        a, f = (np.array(values) * rng.uniform(0.8, 1.2, len(values)) for values in (amplitudes, frequencies))
        return cls(a, f, rng.uniform(0.0, 2.0 * np.pi, len(a)))

    def __call__(self, t: FloatArray, derivative: int = 0) -> FloatArray:
        """The sum, or a derivative of it, at t (N,)."""
        angle = np.multiply.outer(t, self.frequencies) + self.phases + 0.5 * np.pi * derivative
        return np.asarray(np.sin(angle) @ (self.amplitudes * self.frequencies**derivative))


def driven_path(rng: np.random.Generator) -> Path:
    """Path of a car: the road winds, the speed changes, the body leans with both and follows the road's unevenness."""
    side, ahead = _Waves.drawn([4.0, 1.0], [0.5, 0.9], rng), _Waves.drawn([1.6, 0.8], [0.6, 1.1], rng)
    # As a road of class B of ISO 8608 is after the suspension: amplitudes grow with the length of the waves.
    road = _Waves.drawn([0.02, 0.008, 0.003], [1.0, 3.0, 9.0], rng)
    pitching, rolling = (_Waves.drawn([2e-3, 2e-3], [4.0, 9.0], rng) for _ in range(2))
    speed = rng.uniform(6.0, 10.0)

    def path(t: FloatArray) -> tuple[FloatArray, Rotation]:
        vx, vz = side(t, 1), speed + ahead(t, 1)
        heading, fast = np.arctan2(vx, vz), np.hypot(vx, vz)
        along, across = (vx * side(t, 2) + vz * ahead(t, 2)) / fast, (vz * side(t, 2) - vx * ahead(t, 2)) / fast
        angles = [heading, _SUSPENSION * along + pitching(t), -_SUSPENSION * across + rolling(t)]
        return np.column_stack([side(t), road(t), speed * t + ahead(t)]), Rotation.from_euler(
            "YXZ", np.column_stack(angles)
        )

    return path


def flown_path(rng: np.random.Generator) -> Path:
    """Path of a camera in the hand or on a drone: slow ways, faster turns."""
    ways = [_Waves.drawn(a, [0.5, 1.3], rng) for a in ([2.0, 0.3], [0.5, 0.2], [1.5, 0.3])]
    turns = [_Waves.drawn(a, [0.7, 1.9], rng) for a in ([0.5, 0.1], [0.05, 0.03], [0.05, 0.03])]

    def path(t: FloatArray) -> tuple[FloatArray, Rotation]:
        angles = np.column_stack([turn(t) for turn in turns])
        return np.column_stack([way(t) for way in ways]), Rotation.from_euler("YXZ", angles)

    return path
