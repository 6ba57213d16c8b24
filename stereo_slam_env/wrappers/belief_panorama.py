"""`BeliefPanorama`: directions of the landmarks of the map around the car, in a few numbers for a small policy."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.contract.noise import StereoNoise
from filters.geometry.camera import StereoCamera
from filters.validation import FloatArray, positive, whole_number
from stereo_slam_env.wrappers.belief_observation import Belief
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper, dict_space

FEATURES = ("share", "gain", "elevation", "nearness", "in_view", "unseen")
"""Columns of `panorama`."""
_LOW, _HIGH = -1.0, 2.0
_GAIN_SCALE = 0.1
_NEAR = 10.0
"""m: a landmark at this distance has nearness 1/2."""
FORGOTTEN = 5.0
"""s: the time constant of `unseen`."""
_LARGEST_SIGMA = 1e3
"""Bound of `belief_sigmas`, m and rad."""


class BeliefPanorama(RecordedWrapper, gym.ObservationWrapper[Any, Any, Any]):
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

    def __init__(self, env: gym.Env[Any, Any], sectors: int = 12, reach: float | None = None) -> None:
        super().__init__(env)
        self.sectors = whole_number("sectors", sectors, 3)
        self.inner("slam")
        inner = dict_space(env, "BeliefPanorama")
        self._camera = self.inner("camera")
        self.reach = self.inner("options").tracking.farthest if reach is None else positive("reach", reach)
        self._noise = self.inner("noise")
        self._last_seen: FloatArray = np.full(sectors, -np.inf)
        self._most = inner["uvd"].shape[0] if "uvd" in inner.spaces else 1  # type: ignore[index]
        added: dict[str, spaces.Space[Any]] = {
            "panorama": spaces.Box(_LOW, _HIGH, (sectors, len(FEATURES)), np.float32),
            "belief_sigmas": spaces.Box(0.0, _LARGEST_SIGMA, (6,), np.float32),
        }
        self.observation_space = spaces.Dict({**inner.spaces, **added})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment; no sector has been in view yet."""
        self._last_seen = np.full(self.sectors, -np.inf)
        return super().reset(seed=seed, options=options)

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with `panorama` and `belief_sigmas`."""
        belief = self.inner("belief")
        pan, tilt = (float(angle) for angle in observation.get("head", (0.0, 0.0)))
        seen = np.empty((self.sectors, len(FEATURES)))
        seen[:, :4] = around(belief, self._camera, self._noise, pan, tilt, self.sectors, self._most, self.reach)
        seen[:, 4] = share_in_view(self._camera, pan, self.sectors)
        now = self.inner("frame").timestamp
        self._last_seen[seen[:, 4] >= 0.5] = now
        seen[:, 5] = 1.0 - np.exp((self._last_seen - now) / FORGOTTEN)
        sigmas = np.sqrt(belief.pose.covariance.diagonal()).clip(0.0, _LARGEST_SIGMA)
        return {
            **observation,
            "panorama": seen.clip(_LOW, _HIGH).astype(np.float32),
            "belief_sigmas": sigmas.astype(np.float32),
        }


def around(
    belief: Belief,
    camera: StereoCamera,
    noise: StereoNoise,
    pan: float,
    tilt: float,
    sectors: int,
    most: int,
    reach: float = math.inf,
) -> FloatArray:
    """The first four columns of `BeliefPanorama`, those of the map; (sectors, 4), not clipped.

    `camera` and `noise` are of the measurements that a look would bring, `pan` and `tilt` of the head, rad; the share
    of `most` landmarks is 1; landmarks farther away than `reach`, m, do not count.
    """
    seen = np.zeros((sectors, 4))
    if len(belief) == 0:
        return seen
    distances = np.sqrt(np.einsum("ni,ni->n", belief.points_c, belief.points_c))
    near = distances <= reach
    (c_pan, s_pan), (c_tilt, s_tilt) = ((math.cos(angle), math.sin(angle)) for angle in (pan, tilt))
    R_bc = np.array(
        [[c_pan, s_pan * s_tilt, s_pan * c_tilt], [0.0, c_tilt, -s_tilt], [-s_pan, c_pan * s_tilt, c_pan * c_tilt]]
    )
    points_b, distances = belief.points_c[near] @ R_bc.T, distances[near]
    azimuth = np.arctan2(points_b[:, 0], points_b[:, 2])
    elevation = np.arctan2(-points_b[:, 1], np.hypot(points_b[:, 0], points_b[:, 2]))
    sector = np.floor((azimuth + math.pi) * (sectors / (2.0 * math.pi))).astype(np.int64) % sectors
    gains = _gains(belief.points_c[near], distances, belief.relative_covariances[near], camera, noise)

    counts = np.bincount(sector, minlength=sectors)
    seen[:, 0] = counts / most
    seen[:, 1] = _GAIN_SCALE * np.log1p(np.bincount(sector, gains, sectors))
    seen[:, 2] = np.bincount(sector, elevation, sectors) / (0.5 * math.pi * np.maximum(counts, 1))
    np.maximum.at(seen[:, 3], sector, 1.0 / (1.0 + distances / _NEAR))
    return seen


def _gains(
    points_c: FloatArray, distances: FloatArray, covariances: FloatArray, camera: StereoCamera, noise: StereoNoise
) -> FloatArray:
    """Gain of one look at each landmark (N, 3), see `BeliefPanorama`; (N,) nats."""
    sights = points_c / distances[:, None]
    along = np.einsum("ni,nij,nj->n", sights, covariances, sights)
    across = 0.5 * (np.einsum("nii->n", covariances) - along)
    left_along = distances**4 * noise.R[2, 2] / camera.disparity_constant**2
    left_across = distances**2 * noise.R[0, 0] / camera.fx**2
    gains: FloatArray = 0.5 * np.log1p(along / left_along) + np.log1p(across / left_across)
    return gains


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
