"""A stranger's camera whose clock is late by an unknown time: a measurement that depends on the velocity."""

from __future__ import annotations

from dataclasses import dataclass

from filters import MeasurementModel, Variable

OFFSET = Variable("time-offset", [0.0], [[0.015**2]])


def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@dataclass(frozen=True)
class LateClock(MeasurementModel):
    """(u, v, d) of where the points are `time-offset` seconds after the time of the state, at constant velocity."""

    variables: tuple[Variable, ...] = (OFFSET,)
    sees_velocity = True

    def project(self, camera, h, values):
        """The points move by -(w x p + v) a second."""
        tau, v, w, s = values.time_offset[0], values.velocity[:3], values.velocity[3:], h[3]
        m = _cross(w, h)
        x, y, z = h[0] - tau * (m[0] + s * v[0]), h[1] - tau * (m[1] + s * v[1]), h[2] - tau * (m[2] + s * v[2])
        return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, camera.fx * camera.baseline * s / z

    def unproject(self, camera, uvd, values):
        """The same, solved for the point: (I - [a]x)^-1 = (I + [a]x + a a^T) / (1 + a^T a), a = tau w."""
        tau, v, w = values.time_offset[0], values.velocity[:3], values.velocity[3:]
        s, a = uvd[2] / (camera.fx * camera.baseline), (tau * w[0], tau * w[1], tau * w[2])
        x, y = (uvd[0] - camera.cx) / camera.fx, (uvd[1] - camera.cy) / camera.fy
        g = x + tau * s * v[0], y + tau * s * v[1], 1.0 + tau * s * v[2]
        m, along = _cross(a, g), a[0] * g[0] + a[1] * g[1] + a[2] * g[2]
        below = 1.0 + a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        return (
            (g[0] + m[0] + along * a[0]) / below,
            (g[1] + m[1] + along * a[1]) / below,
            (g[2] + m[2] + along * a[2]) / below,
            s,
        )
