"""A drive round a circle past a fixed cloud of points, so that a second lap sees the landmarks of the first again."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from filters import ConstantVelocity, StereoCamera, StereoFilter, StereoNoise, StereoObservation, UpdateReport
from tests.filters.drives import Frame

CAMERA = StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391)
NOISE = StereoNoise.independent_pixels(1.0)
MOTION = ConstantVelocity(3.0, 0.6)
RADIUS, SPEED, DT = 15.0, 4.9, 0.1
START_COVARIANCE = np.diag(np.repeat([1e-6, 1e-6, 0.5, 0.05], 3) ** 2)
LAP = round(2 * np.pi * RADIUS / (SPEED * DT))  # frames


def loop(seed: int, frames: int, *, points: int = 80, noise_scale: float = 1.0, reach: float = 14.0) -> list[Frame]:
    """Ahead along +z and round to the right; points between `reach` and 2 m are seen."""
    rng = np.random.default_rng(seed)
    # In the middle of the next points there is always one in view: they stand along the circle, on both sides.
    along = rng.uniform(0.0, 2 * np.pi, points)
    beside = RADIUS + rng.choice([-1.0, 1.0], points) * rng.uniform(2.0, 5.0, points)
    cloud = np.stack([RADIUS - beside * np.cos(along), rng.uniform(-1.5, 1.5, points), beside * np.sin(along)], axis=1)
    rate = SPEED / RADIUS
    shaken = rng.standard_normal((frames, 6)) * np.repeat([0.3, 0.06], 3) * 0.1
    position, heading = np.zeros(3), Rotation.identity()
    made = []
    for frame in range(frames):
        if frame:
            angle = rate * DT * frame
            position = RADIUS * np.array([1.0 - np.cos(angle), 0.0, np.sin(angle)]) + shaken[frame, :3]
            heading = Rotation.from_rotvec([0.0, angle, 0.0]) * Rotation.from_rotvec(shaken[frame, 3:])
        p_c = heading.inv().apply(cloud - position)
        uvd = CAMERA.project(np.where(p_c[:, 2:] > 0.1, p_c, [0.0, 0.0, 1.0]))
        seen = (p_c[:, 2] > 2.0) & (p_c[:, 2] < reach) & CAMERA.in_view(uvd)
        errors = noise_scale * rng.multivariate_normal(np.zeros(3), NOISE.R, points)
        ids = np.flatnonzero(seen)
        made.append(Frame(position, heading.as_quat(), StereoObservation(ids, (uvd + errors)[ids])))
    return made
