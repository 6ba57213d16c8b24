"""A drive round a circle past a fixed cloud of points, so that a second lap sees the landmarks of the first again."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Start, StereoFilter, StereoObservation

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, Frame

RADIUS, SPEED = 15.0, 4.9
LAP = round(2 * np.pi * RADIUS / (SPEED * DT))  # frames
START_COVARIANCE = np.diag(np.repeat([1e-6, 1e-6, 0.5, 0.05], 3) ** 2)


def loop(seed: int, laps: float, *, points: int = 80, noise_scale: float = 1.0, missed: float = 0.0) -> list[Frame]:
    """Ahead along +z and round to the right; points from 2 to 14 m ahead are seen."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(0.0, 2 * np.pi, points)
    beside = RADIUS + rng.choice([-1.0, 1.0], points) * rng.uniform(2.0, 5.0, points)
    cloud = np.stack([RADIUS - beside * np.cos(along), rng.uniform(-1.5, 1.5, points), beside * np.sin(along)], axis=1)
    made = []
    for frame in range(round(laps * LAP)):
        turned = SPEED / RADIUS * DT * frame
        position = RADIUS * np.array([1.0 - np.cos(turned), 0.0, np.sin(turned)])
        heading = Rotation.from_rotvec([0.0, turned, 0.0])
        if frame:
            position += 0.012 * rng.standard_normal(3)
            heading = heading * Rotation.from_rotvec(0.0024 * rng.standard_normal(3))
        p_c = heading.inv().apply(cloud - position)
        exact = CAMERA.project(np.where(p_c[:, 2:] > 0.1, p_c, (0.0, 0.0, 1.0)))
        seen = (p_c[:, 2] > 2.0) & (p_c[:, 2] < 14.0) & CAMERA.in_view(exact) & (rng.uniform(size=points) >= missed)
        ids = np.flatnonzero(seen)
        errors = noise_scale * rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(ids))
        made.append(Frame(position, heading.as_quat(), StereoObservation(ids, exact[ids] + errors)))
    return made


def start(*filters: StereoFilter) -> None:
    """Reset to the first frame of a `loop`."""
    for slam in filters:
        slam.reset(
            Start(
                linear_velocity=(0.0, 0.0, SPEED),
                angular_velocity=(0.0, SPEED / RADIUS, 0.0),
                covariance=START_COVARIANCE,
            )
        )
