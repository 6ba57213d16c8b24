"""Scenes whose geometry is known in closed form, and both back ends to draw them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from filters import Pose
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from stereo_slam_env.rendering.renderers import RENDERERS, make_renderer
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.scene import Box, Ground, Look, Material, Scene

FRAME = WorldFrame(1.65)
CAMERA = StereoCamera(300.0, 310.0, 159.5 + 33.0, 119.5 - 22.0, 0.5, 320, 240)
"""With its principal point well off the centre."""
AHEAD = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
PLAIN_GROUND = Ground((-400.3, -400.3), (400.3, 400.3), Material((0.3, 0.6, 0.3)))


def scene_of(*primitives, moving=(), look=None, ground=PLAIN_GROUND) -> Scene:
    return Scene(ground, primitives, (), np.zeros((0, 3)), tuple(moving), look or Look())


RED = Material((0.9, 0.3, 0.2))


@dataclass(frozen=True)
class Wall:
    """The near face of a big box: `distance` m ahead of the camera's start, turned by `yaw`."""

    distance: float
    yaw: float
    material: Material = RED

    @property
    def normal(self):
        return -np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])

    @property
    def box(self) -> Box:
        thickness, side = 4.0, 4.0 * self.distance + 40.0
        center = np.array([self.distance, 0.0, 0.0]) - 0.5 * thickness * self.normal
        return Box(tuple(center.tolist()), (thickness, side, side), self.yaw, self.material)

    def inverse_depth(self, camera: StereoCamera, pose: Pose):
        """1/z is a u + b v + c on the wall: (a, b, c)."""
        R_sc = FRAME.rotation_to_scene(rotations.matrix(pose.orientation))
        n = R_sc.T @ self.normal
        away = self.normal @ (np.array([self.distance, 0.0, 0.0]) - FRAME.to_scene(pose.position))
        a, b = n[0] / camera.fx / away, n[1] / camera.fy / away
        return np.array([a, b, n[2] / away - a * camera.cx - b * camera.cy])


@cache
def gl_missing() -> str | None:
    """Why "gl" cannot be tested here."""
    try:
        from stereo_slam_env.rendering.gl_resources import device

        device()
    except (ImportError, RuntimeError) as error:
        return str(error)
    return None


def skip_where_missing(name: str) -> None:
    if name == "gl" and (reason := gl_missing()):
        pytest.skip(reason)


@contextmanager
def drawing(name: str, scene: Scene, camera: StereoCamera = CAMERA, **options) -> Iterator:
    """A back end with the scene in it."""
    skip_where_missing(name)
    renderer = make_renderer(name, camera=camera, frame=FRAME, **options)
    try:
        renderer.build(scene)
        yield renderer
    finally:
        renderer.close()


both_back_ends = pytest.mark.parametrize("name", list(RENDERERS))
