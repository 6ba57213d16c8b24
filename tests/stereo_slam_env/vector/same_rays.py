"""The rays of the vector environments in single ones, so that both see the same landmarks."""

import pytest

from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.rays import obstacles, visible


@pytest.fixture(scope="module")
def same_rays():
    """Single environments ask the compiled rays instead of PyBullet, which hits what passes within a millimetre."""
    build = PhysicsWorld.build

    def with_obstacles(self, scene, ego_size):
        build(self, scene, ego_size)
        self.obstacles = obstacles(scene.solids)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PhysicsWorld, "build", with_obstacles)
        patch.setattr(PhysicsWorld, "visible", lambda self, cameras, points: visible(self.obstacles, cameras, points))
        yield
