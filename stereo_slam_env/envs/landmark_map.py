"""The filter's map as a picture: `LandmarkMap`, for policies and networks that take images."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from filters.contract.validation import positive, whole_number
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.envs.filter_rows import FilterRows
from stereo_slam_env.envs.row_wrapper import RowsWrapper
from stereo_slam_env.envs.rows import Arrays, Seeds, Step

DENSITY, SIGMA, SEEN, PATH = range(4)
"""Channels of the picture."""
_SHADE = 64
"""Brightness of one landmark in its pixel; four saturate it."""
_HALF = 0.5
"""A landmark whose position has this standard deviation, m, is half as bright as one that is known exactly."""


class LandmarkMap(RowsWrapper):
    """The observation gains `map`, a picture of the filter's map from above, the car in the middle, heading up.

    `map` is (size, size, 4) uint8, what convolutional policies take for an image. Its channels are: how many landmarks
    there are; how well their positions relative to the camera are known, 255 / (1 + sigma / 0.5 m), the best of a
    pixel; which of them are measured in this frame; and the path driven. All but the measurements is by the filter.

    Parameters
    ----------
    env : gymnasium.Env
        With `BeliefObservation` inside.
    size : int
        Pixels of each side.
    reach : float
        From the car to the edges of the picture, m.
    path : int
        Frames of the path that are drawn.

    Raises
    ------
    ValueError
        An argument is impossible, or there is no filter in the loop.
    """

    def __init__(self, env: Any, size: int = 64, reach: float = 40.0, path: int = 300) -> None:
        super().__init__(env)
        self._beliefs: FilterRows = self.needed("beliefs")
        self._size, self._reach = whole_number("size", size, 8, 1024), positive("reach", reach)
        picture = spaces.Box(0, 255, (size, size, 4), np.uint8)
        self.observation_space = spaces.Dict({**self.dict_space(), "map": picture})
        self._path = np.full((whole_number("path", path, 1), self.num_envs, 3), np.nan)
        self._map_shown = True

    def select_keys(self, keys: Collection[str]) -> None:
        """Without `map` none is drawn."""
        self._map_shown = "map" in keys
        self.rows.select_keys(keys)

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """Start with an empty path."""
        self.rows.reset(chosen, seeds, options)
        self._path[:, chosen] = np.nan
        self._path[0, chosen] = self._beliefs.poses[chosen, :3]

    def step(self, actions: Any, going: BoolArray) -> Step:
        step = self.rows.step(actions, going)
        self._path[1:, going] = self._path[:-1, going]
        self._path[0, going] = self._beliefs.poses[going, :3]
        return step

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = self.rows.observe()
        return ({**observation, "map": self._pictures()} if self._map_shown else observation), info

    def _pictures(self) -> NDArray[np.uint8]:
        count, maps, angles = self.num_envs, self._beliefs.maps, self.world.angles()
        owner = np.repeat(np.arange(count), np.diff(maps.offsets))
        drawn = np.zeros((count, self._size, self._size, 4))
        pixel, inside = self._pixels(maps.points_c, owner, angles)
        inside &= maps.located
        pixel = tuple(axis[inside] for axis in pixel)
        np.add.at(drawn, (*pixel, DENSITY), _SHADE)
        sigmas = np.sqrt(np.einsum("nii->n", maps.covariances[inside]))
        np.maximum.at(drawn, (*pixel, SIGMA), 255.0 / (1.0 + sigmas / _HALF))
        measured = self.world.measured(np.ones(count, dtype=np.bool_))
        measured_owner = np.repeat(np.arange(count), np.diff(measured.offsets))
        names = np.stack([owner[inside], maps.ids[inside]]), np.stack([measured_owner, measured.ids])
        in_view = np.isin(*(owners * 2**32 + ids for owners, ids in names))
        drawn[(*(axis[in_view] for axis in pixel), SEEN)] = 255.0
        poses = self._beliefs.poses
        path = np.einsum("bji,kbj->kbi", rotations.matrix(poses[:, 3:]), self._path - poses[:, :3]).reshape(-1, 3)
        driven = ~np.isnan(path[:, 0])
        on_path, inside = self._pixels(path[driven], np.tile(np.arange(count), len(self._path))[driven], angles)
        drawn[(*(axis[inside] for axis in on_path), PATH)] = 255.0
        return np.minimum(drawn, 255.0).astype(np.uint8)

    def _pixels(self, points_c: FloatArray, owner: IntArray, angles: FloatArray) -> tuple[Any, BoolArray]:
        """Row of the vector, and row and column in its picture, of points (N, 3) m in the frames of the cameras.

        Also which of them (N,) are in the picture.
        """
        (pan, tilt), (x, y, z) = angles[owner].T, points_c.T
        level = np.sin(tilt) * y + np.cos(tilt) * z
        right, ahead = np.cos(pan) * x + np.sin(pan) * level, np.cos(pan) * level - np.sin(pan) * x
        scale = 0.5 * self._size / self._reach
        row, column = (np.floor(0.5 * self._size + scale * along).astype(np.int64) for along in (-ahead, right))
        inside: BoolArray = (row >= 0) & (row < self._size) & (column >= 0) & (column < self._size)
        return (owner, row, column), inside
