"""Where something may stand that nobody has looked at yet: what a planner can know of landmarks that are in no map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filters.validation import FloatArray, IntArray
from stereo_slam_env.policies.foresight import CameraPoses, Eyes
from stereo_slam_env.world.routes import Route

SPACING = 3.0
"""Of places along the route, m."""
OFFSETS = np.array([-0.75, -0.5, -0.25, 0.25, 0.5, 0.75])
"""Of places across it, in shares of the farthest depth at which landmarks are measured."""


class UnseenPlaces:
    """Places beside the route, at the height of the camera, that have not been in view so far.

    Parameters
    ----------
    route : Route
        The nominal drive; places go on straight ahead after its end, as far as can be seen.
    eyes : Eyes
        What is in view.
    """

    def __init__(self, route: Route, eyes: Eyes) -> None:
        self._eyes = replace(eyes, most=None)
        station = np.arange(0.0, route.length + eyes.farthest, SPACING)
        frame = np.minimum(np.searchsorted(route.arc_length, station), route.frames - 1)
        heading = route.headings[frame]
        ahead = np.stack([np.sin(heading), np.zeros_like(heading), np.cos(heading)], axis=1)
        across = np.stack([np.cos(heading), np.zeros_like(heading), -np.sin(heading)], axis=1)
        middle = route.positions[frame] + np.maximum(station - route.length, 0.0)[:, None] * ahead
        self._points = (middle[:, None] + eyes.farthest * OFFSETS[:, None] * across[:, None]).reshape(-1, 3)

    def __len__(self) -> int:
        return len(self._points)

    def look(self, cameras: CameraPoses) -> None:
        """Whatever is in view of a camera has been seen now."""
        in_view = self._eyes.sight(self._points, cameras).in_view.reshape(-1, len(self._points))
        self._points = self._points[~in_view.any(axis=0)]

    def discovered(self, cameras: CameraPoses) -> IntArray:
        """How many places each of B sequences of K looks, (B, K) cameras, would be the first to see; (B,)."""
        near = self._near(cameras.positions)
        discovered: IntArray = self._eyes.sight(near, cameras).in_view.any(axis=-2).sum(axis=-1)
        return discovered

    def _near(self, positions: FloatArray) -> FloatArray:
        """Places that one of the cameras could see if it looked there."""
        low, high = (end(positions.reshape(-1, 3), axis=0) for end in (np.min, np.max))
        reach = self._eyes.reach
        near: FloatArray = self._points[((self._points >= low - reach) & (self._points <= high + reach)).all(axis=1)]
        return near
