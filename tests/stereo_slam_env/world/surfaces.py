"""Points on the surfaces of solids, as the kernels of the world draw them."""

import numpy as np

from stereo_slam_env.world import compiled
from stereo_slam_env.world.scene import table_of


def sample_surface(shape, count, rng):
    """Points on the side (of balls: the whole) surface, m, and unit outward normals; (count, 3) each."""
    return compiled.sample(table_of([shape]), np.array([count]), rng)
