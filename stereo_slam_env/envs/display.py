"""`render_mode="human"`: a window with the picture of `render()`, or a clear error where none can be opened."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np

from filters.contract.extras import install_command
from stereo_slam_env.rendering.images import Image

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
