"""Renderers by name."""

from __future__ import annotations

from functools import cache
from typing import Literal

from filters.geometry.camera import StereoCamera
from stereo_slam_env.files.package_versions import version_of
from stereo_slam_env.rendering.gl import GLRenderer
from stereo_slam_env.rendering.images import ImageQuality, StereoRenderer
from stereo_slam_env.rendering.tiny import TinyRenderer
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.physics import PhysicsWorld

RendererName = Literal["tiny", "gl"]
RENDERERS: dict[str, str] = {
    "tiny": "PyBullet's own, on the CPU: everywhere, the same bits every time, slow",
    "gl": "OpenGL without a display: fast; needs EGL and the extra gl",
}
"""Names and what they stand for."""


def make_renderer(
    name: str,
    *,
    camera: StereoCamera,
    frame: WorldFrame,
    world: PhysicsWorld,
    supersample: int = 1,
    samples: int = 1,
) -> StereoRenderer:
    """A back end that draws both views.

    Parameters
    ----------
    name : str
        One of `RENDERERS`.
    camera : StereoCamera
        The rig.
    frame : WorldFrame
        Where W sits in the scene.
    world : PhysicsWorld
        What "tiny" draws: build it with the scene before the renderer. "gl" does not touch it.
    supersample : int
        Draw this many times finer and average.
    samples : int
        Samples a pixel at the edges of things, only "gl".

    Raises
    ------
    ValueError
        There is no such renderer, or it cannot do what is asked for.
    ImportError, RuntimeError
        What "gl" needs is missing; the text says what to install.
    """
    _require_known(name)
    if not isinstance(supersample, int) or supersample < 1:
        raise ValueError(f"supersample must be a whole number from 1, got {supersample!r}")
    if name == "tiny":
        if samples != 1:
            raise ValueError(f'samples must be 1 with renderer "tiny", got {samples!r}: use supersample')
        return TinyRenderer(world, camera, frame, supersample)
    return GLRenderer(camera, frame, supersample, samples)


def image_quality(name: str, supersample: int = 1) -> ImageQuality:
    """Quality of the images of a back end; a `ValueError` where there is no such renderer."""
    _require_known(name)
    back_end: type[StereoRenderer] = TinyRenderer if name == "tiny" else GLRenderer
    return back_end.image_quality(supersample)


@cache
def renderer_identity(name: str) -> dict[str, str]:
    """`name`, `version` and `device` of what made the pictures: results with different ones are not to be compared.

    Raises as `make_renderer`.
    """
    _require_known(name)
    if name == "tiny":
        return {"name": name, "version": f"PyBullet {version_of('pybullet')}", "device": "CPU"}
    from stereo_slam_env.rendering.gl_resources import device

    return {"name": name, **device()}


def _require_known(name: str) -> None:
    if name not in RENDERERS:
        raise ValueError(f"renderer must be one of {', '.join(RENDERERS)}, got {name!r}")
