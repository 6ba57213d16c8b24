"""`BeliefPanorama`: directions of the landmarks of the map around the car, in a few numbers for a small policy."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from filters.contract.noise import StereoNoise
from filters.contract.validation import positive, whole_number
from filters.engine.batch import RelativeLandmarks
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.kernels.compilation import entry
from stereo_slam_env.envs.filter_rows import FilterRows
from stereo_slam_env.envs.row_wrapper import RowsWrapper
from stereo_slam_env.envs.rows import Arrays, Seeds, Step

FEATURES = ("share", "gain", "elevation", "nearness", "in_view", "unseen")
"""Columns of `panorama`."""
_LOW, _HIGH = -1.0, 2.0
_GAIN_SCALE = 0.1
_NEAR = 10.0
"""m: a landmark at this distance has nearness 1/2."""
_FORGOTTEN = 5.0
"""s: the time constant of `unseen`."""
_LARGEST_SIGMA = 1e3
"""Bound of `belief_sigmas`, m and rad."""


class BeliefPanorama(RowsWrapper):
    """Adds the keys `panorama` (sectors, 6) and `belief_sigmas` (6,) to the observation, float32.

    `panorama`: sector k is the azimuth from -pi + 2 pi k / sectors on, about the vertical of the *car's* straight-ahead
    direction (the middle of the rows), positive to the right: the observation key `head` (pan, tilt; rad) is taken off
    the direction of the camera, R_wc = R_wb R_y(pan) R_x(tilt). Without that key the camera looks straight ahead.
    Columns, 0 in a sector without landmarks, clipped to [-1, 2]:

    | Column | Name | Meaning |
    |--------|------|---------|
    | 0 | share | landmarks of the map there within `reach`, over the rows of `uvd`; only those count below, too |
    | 1 | gain | 0.1 ln(1 + sum of the gains of one look at each, in its position relative to the camera, nats) |
    | 2 | elevation | mean elevation, over pi/2; up is positive |
    | 3 | nearness | 1 / (1 + z / 10 m) of the nearest, z its distance |
    | 4 | in_view | share of the sector that the camera sees now, by azimuth |
    | 5 | unseen | 1 - exp(-t / 5 s), t the time since half of it was in view; 1: never |

    A look gains ln(sqrt(1 + c_r / s_r^2) (1 + c_l / s_l^2)): c_r and c_l are the variances of the relative position
    along and across the line of sight, s_r = z^2 sigma_d / (f b) and s_l = z sigma_u / f what one measurement at the
    distance z leaves of them. Landmarks are taken as independent, so a sum says more than there is.

    `belief_sigmas` are the standard deviations of the pose: position in W, m, and rotation in the camera frame, rad; at
    most 1e3.

    Parameters
    ----------
    env : gymnasium.Env
        With `BeliefObservation` inside.
    sectors : int
        Rows of `panorama`, at least 3.
    reach : float, optional
        Landmarks farther away do not count, m. None: as far as the landmark sensor of the environment sees.

    Raises
    ------
    ValueError
        `sectors` is not an integer of at least 3, `reach` is not positive, or there is no filter in the loop.
    """

    def __init__(self, env: Any, sectors: int = 12, reach: float | None = None) -> None:
        super().__init__(env)
        self._sectors = whole_number("sectors", sectors, 3)
        self._beliefs: FilterRows = self.needed("beliefs")
        inner = self.dict_space()
        self._camera, self._noise = self.needed("camera"), self.needed("noise")
        self._reach = self.needed("options").tracking.farthest if reach is None else positive("reach", reach)
        self._last_seen = np.full((self.num_envs, sectors), -np.inf)
        self._in_view = np.zeros((self.num_envs, sectors))
        self._times = np.zeros(self.num_envs)
        self._most = inner["uvd"].shape[0] if "uvd" in inner else 1  # type: ignore[index]
        added: dict[str, spaces.Space[Any]] = {
            "panorama": spaces.Box(_LOW, _HIGH, (sectors, len(FEATURES)), np.float32),
            "belief_sigmas": spaces.Box(0.0, _LARGEST_SIGMA, (6,), np.float32),
        }
        self.observation_space = spaces.Dict({**inner, **added})
        self._panorama_shown = True

    def select_keys(self, keys: Collection[str]) -> None:
        """Without `panorama` no map is read."""
        self._panorama_shown = "panorama" in keys
        self.rows.select_keys(keys)

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """No sector has been in view yet."""
        self.rows.reset(chosen, seeds, options)
        self._last_seen[chosen] = -np.inf
        self._look_around(chosen)

    def step(self, actions: Any, going: BoolArray) -> Step:
        step = self.rows.step(actions, going)
        self._look_around(going)
        return step

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = self.rows.observe()
        sigmas = np.sqrt(np.einsum("bii->bi", self._beliefs.pose_covariances)).clip(0.0, _LARGEST_SIGMA)
        added = {"belief_sigmas": sigmas.astype(np.float32)}
        if self._panorama_shown:
            added["panorama"] = self._panorama()
        return {**observation, **added}, info

    def _panorama(self) -> NDArray[np.float32]:
        features = np.empty((self.num_envs, self._sectors, len(FEATURES)))
        maps, angles = self._beliefs.maps, self.world.angles()
        features[..., :4] = panoramas(maps, angles, self._camera, self._noise, self._sectors, self._most, self._reach)
        features[..., 4] = self._in_view
        features[..., 5] = 1.0 - np.exp((self._last_seen - self._times[:, None]) / _FORGOTTEN)
        return features.clip(_LOW, _HIGH).astype(np.float32)

    def _look_around(self, which: BoolArray) -> None:
        """Remember what is in view of some rows."""
        self._times[which] = self.world.times()[which]
        in_view = share_in_view(self._camera, self.world.angles()[which, :1], self._sectors)
        self._in_view[which] = in_view
        self._last_seen[which] = np.where(in_view >= 0.5, self._times[which, None], self._last_seen[which])


def share_in_view(camera: StereoCamera, pan: float | FloatArray, sectors: int) -> FloatArray:
    """Share of each sector between the azimuths of the left and right border of the left image; (sectors,).

    `pan` of many heads is (B, 1), and the result then (B, sectors).
    """
    left, right = math.atan2(-camera.cx, camera.fx), math.atan2(camera.width - 1 - camera.cx, camera.fx)
    width = 2.0 * math.pi / sectors
    centres = -math.pi + width * (np.arange(sectors) + 0.5)
    away = np.abs((centres - pan - 0.5 * (left + right) + math.pi) % (2.0 * math.pi) - math.pi)
    overlap = 0.5 * (right - left + width) - away
    share: FloatArray = overlap.clip(0.0, min(width, right - left)) / width
    return share


def panoramas(
    maps: RelativeLandmarks,
    angles: FloatArray,
    camera: StereoCamera,
    noise: StereoNoise,
    sectors: int,
    most: int,
    reach: float,
) -> FloatArray:
    """The first four columns of `BeliefPanorama` of each row, those of the map; (B, sectors, 4), not clipped.

    `camera` and `noise` are of the measurements that a look would bring, `angles` (B, 2) of the heads, rad; the share
    of `most` landmarks is 1; landmarks farther away than `reach`, m, do not count.
    """
    sector_sums = np.zeros((len(angles), sectors, 4))
    along, across = noise.R[2, 2] / camera.disparity_constant**2, noise.R[0, 0] / camera.fx**2
    _panoramas(
        maps.offsets, maps.points_c, maps.covariances, maps.located, angles, along, across, most, reach, sector_sums
    )
    return sector_sums


@entry
def _panoramas(
    offsets: IntArray,
    points_c: FloatArray,
    covariances: FloatArray,
    located: BoolArray,
    angles: FloatArray,
    noise_along: float,
    noise_across: float,
    most: int,
    reach: float,
    seen: FloatArray,
) -> None:
    sectors = seen.shape[1]
    for b in range(len(angles)):
        sin_pan, cos_pan = math.sin(angles[b, 0]), math.cos(angles[b, 0])
        sin_tilt, cos_tilt = math.sin(angles[b, 1]), math.cos(angles[b, 1])
        for m in range(offsets[b], offsets[b + 1]):
            x, y, z = points_c[m, 0], points_c[m, 1], points_c[m, 2]
            distance = math.sqrt(x * x + y * y + z * z)
            if not located[m] or distance > reach:
                continue
            right = cos_pan * x + sin_pan * sin_tilt * y + sin_pan * cos_tilt * z
            down = cos_tilt * y - sin_tilt * z
            ahead = -sin_pan * x + cos_pan * sin_tilt * y + cos_pan * cos_tilt * z
            azimuth = math.atan2(right, ahead)
            sector = math.floor((azimuth + math.pi) * (sectors / (2.0 * math.pi))) % sectors
            along, spread = 0.0, 0.0
            for i in range(3):
                for j in range(3):
                    along += points_c[m, i] * covariances[m, i, j] * points_c[m, j]
                spread += covariances[m, i, i]
            along /= distance * distance
            across = 0.5 * (spread - along)
            square = distance * distance
            gain = 0.5 * math.log1p(along / (square * square * noise_along))
            gain += math.log1p(across / (square * noise_across))
            row = seen[b, sector]
            row[0] += 1.0
            row[1] += gain
            row[2] += math.atan2(-down, math.sqrt(right * right + ahead * ahead))
            row[3] = max(row[3], 1.0 / (1.0 + distance / _NEAR))
        for k in range(sectors):
            row = seen[b, k]
            row[2] /= 0.5 * math.pi * max(row[0], 1.0)
            row[0] /= most
            row[1] = _GAIN_SCALE * math.log1p(row[1])
