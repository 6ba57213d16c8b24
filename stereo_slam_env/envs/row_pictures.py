"""Pictures of a row: its scene through a renderer with the faults of its cameras, and the window that shows them.

`render_mode="human"` opens the window, or gives a clear error where none can be opened.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np

from filters.contract.extras import install_command, require_core
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from stereo_slam_env.envs.arguments import StereoOptions
from stereo_slam_env.rendering.pinhole import Image, StereoImages, StereoRenderer
from stereo_slam_env.rendering.renderers import CameraEffects, make_renderer
from stereo_slam_env.sensing.padding import TrackingPolicy
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.simulator.state import Kept
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.scene import Scene
from stereo_slam_env.world.surroundings import in_fog, without_texture
from stereo_slam_env.world.traffic import MovingPoints


class Pictures(Kept):
    """The pictures that an environment with these options takes, frame by frame."""

    changes = ("_drawn", "_textured", "_moving", "_effects", "_number", "_images")

    def __init__(self, options: StereoOptions, camera: StereoCamera) -> None:
        if options.renderer == "tiny":
            require_core("pybullet")
        self._options, self._camera = options, camera
        self._frame = WorldFrame(CAMERA_HEIGHT)
        self._renderer: StereoRenderer | None = None
        self._effects: CameraEffects | None = None
        self._moving = MovingPoints(())
        self._textured: Scene | None = None  # what is drawn, until it turns blank
        self._drawn: Scene | None = None
        self._images: StereoImages | None = None
        self._number = 0
        self._built: Scene | None = None  # what the renderer has: only what is looked at is built

    def build(self, scene: Scene, rng: np.random.Generator) -> None:
        """Draw another scene, by cameras whose faults are drawn from `rng`."""
        if self._options.visibility < TrackingPolicy.farthest:
            scene = in_fog(scene, self._options.visibility)
        self._moving = MovingPoints(scene.moving)
        self._effects = CameraEffects.random(rng) if self._options.randomise else None
        self._drawn = self._textured = scene

    def set_frame(self, number: int) -> None:
        """Go to a frame: moving bodies are elsewhere, and textures may be gone."""
        self._number, self._images = number, None
        blank_from = self._options.blank_from
        if self._textured is not None and blank_from is not None and self._time >= blank_from - 1e-9:
            self._drawn, self._textured = without_texture(self._textured), None

    def images(self, pose: Pose) -> StereoImages:
        """Images of the cameras at `pose`; one pose a frame."""
        if self._images is None:
            clean = self._ready().render_pair(pose, self._time)
            self._images = clean if self._effects is None else self._effects.apply(clean, self._number)
        return self._images

    def on_moving_body(self, points_w: FloatArray) -> BoolArray:
        """Mask of points (N, 3) on a body that moves."""
        return self._moving.on_body(self._frame.to_scene(points_w), self._time)

    def close(self) -> None:
        """Stop the renderer; may be called at any time, also twice."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._drawn = self._built = None

    @property
    def _time(self) -> float:
        return self._number * FRAME_PERIOD

    def _ready(self) -> StereoRenderer:
        """The renderer with the scene of now."""
        scene = self._drawn
        assert scene is not None
        if self._renderer is not None and self._built is scene:
            return self._renderer
        if self._renderer is None:
            self._renderer = make_renderer(
                self._options.renderer,
                camera=self._camera,
                frame=self._frame,
                supersample=self._options.supersample,
            )
        self._renderer.build(scene)
        self._built = scene
        return self._renderer


_DRIVER = ("SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER")
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
_REMEDY = (
    "use render_mode='rgb_array' with gymnasium.wrappers.RecordVideo, run under xvfb-run, "
    "or set SDL_VIDEODRIVER=dummy to draw into nothing"
)


def window_for(render_mode: str | None, fps: float) -> Window | None:
    """A window for "human", none for other render modes; an error where pygame or a display is missing."""
    if render_mode != "human":
        return None
    if find_spec("pygame") is None:
        raise ImportError(f"render_mode='human' needs pygame: {install_command('video')}")
    if not _display_named():
        raise RuntimeError(
            f"render_mode='human' needs a display, and neither {' nor '.join(_SCREENS)} is set: {_REMEDY}"
        )
    return Window(fps)


def modes_here(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """The metadata of an environment with the render modes that work on this machine.

    The class declares all of them, so that `gymnasium.make` hands "human" on to it instead of wrapping it; an instance
    declares those that work, so that `check_env`, which tries each, passes without a display.
    """
    works = _display_named() and find_spec("pygame") is not None
    return {**metadata, "render_modes": [mode for mode in metadata["render_modes"] if mode != "human" or works]}


class Window:
    """A window on the screen that shows at most `fps` pictures a second; it opens with the first one."""

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._screen: Any = None

    def show(self, picture: Image) -> None:
        """Show a picture (H, W, 3), all of one size; a RuntimeError where no window can be opened."""
        import pygame

        if self._screen is None:
            try:
                pygame.display.init()
                self._screen = pygame.display.set_mode((picture.shape[1], picture.shape[0]))
            except pygame.error as error:
                raise RuntimeError(f"render_mode='human' cannot open a window: {error}: {_REMEDY}") from error
            # SDL falls back to no screen where the display that is named does not answer.
            if pygame.display.get_driver() in ("offscreen", "dummy") and not _driver_named():
                self.close()
                raise RuntimeError(f"render_mode='human' cannot open a window, the display does not answer: {_REMEDY}")
            pygame.display.set_caption("stereo-slam")
            self._clock = pygame.time.Clock()
        pygame.event.pump()
        self._screen.blit(pygame.surfarray.make_surface(np.swapaxes(picture, 0, 1)), (0, 0))
        pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close it; may be called at any time, also twice."""
        if self._screen is not None:
            import pygame

            pygame.display.quit()
            self._screen = None


def _driver_named() -> bool:
    return any(os.environ.get(name) for name in _DRIVER)


def _display_named() -> bool:
    """Whether there is a screen, or the user says what to do instead; only X11 and Wayland tell by variables."""
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in (*_DRIVER, *_SCREENS))
