"""A corner that has come nearer is found where it is: its patch is no blurrier than the picture (< 1 s)."""

import numpy as np
import pytest
from scipy.stats import norm

from stereo_slam_env.frontend.matching import search
from stereo_slam_env.frontend.patches import cut_patches, warped_patches

SIDE = 20
PLACES = SIDE**2
GAUSSIAN = 1.0
"""Standard deviation of the point spread of the lens, px; a pixel averages over its square as well."""
BLUR = 1.1 * (GAUSSIAN**2 + 1.0 / 12.0)
"""A tenth more than the variance of the point spread: what a correction of second order leaves out."""
TILE = 41
"""Room for one corner, px."""


def edge(x):
    """A step at 0 from 0 to 1, as pixels at x see it."""

    def integral(y):
        return y * norm.cdf(y / GAUSSIAN) + GAUSSIAN * norm.pdf(y / GAUSSIAN)

    return integral(x + 0.5) - integral(x - 0.5)


def corners_at(places):
    """Image of one corner a tile, each at its place (PLACES, 2) in the tile, exact but for the 8 bits.

    The bright quadrant is to the lower right.
    """
    columns, rows = edge(np.arange(TILE) - places.T[:, :, None])
    tiles = np.rint(60.0 + 140.0 * rows[:, :, None] * columns[:, None, :]).astype(np.uint8)
    return np.ascontiguousarray(
        tiles.reshape(SIDE, SIDE, TILE, TILE).transpose(0, 2, 1, 3).reshape(SIDE * TILE, SIDE * TILE)
    )


def displacements(scale, image_blur):
    """Where corners, magnified by `scale`, are found, less where they are; (PLACES, 2) px."""
    then, now = TILE // 2 + np.random.default_rng(0).uniform(-0.5, 0.5, (2, PLACES, 2))
    origin = TILE * np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2)
    stored = cut_patches(corners_at(then), origin + then)
    templates = warped_patches(stored, np.tile(np.eye(2) / scale, (PLACES, 1, 1)), image_blur=image_blur)
    found = search(corners_at(now), templates, origin + now, np.tile(np.eye(2), (PLACES, 1, 1)))
    return found.position - (origin + now)


@pytest.mark.parametrize(("scale", "unmatched"), [(1.1, 4e-3), (1.2, 9e-3), (1.5, 30e-3)])
def test_a_magnified_corner_is_not_displaced(scale, unmatched):
    """Within 5 thousandths of a pixel, standard error up to 0.7; uncorrected it slides into its quadrant."""
    along, uncorrected = (displacements(scale, blur).mean(axis=1) for blur in (BLUR, 0.0))
    assert along.std() / np.sqrt(PLACES) < 1e-3
    assert abs(along.mean()) < 5e-3
    assert uncorrected.mean() > unmatched
