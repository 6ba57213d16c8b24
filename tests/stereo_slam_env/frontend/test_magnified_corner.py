"""A corner that has come nearer is found where it is: its patch is no blurrier than the picture. About 4 s."""

import numpy as np
import pytest
from scipy.stats import norm

from stereo_slam_env.frontend.matching import search
from stereo_slam_env.frontend.patches import cut_patches, warped_patches

PLACES = 400
GAUSSIAN = 1.0
"""Standard deviation of the point spread of the lens, px; a pixel averages over its square as well."""
BLUR = 1.1 * (GAUSSIAN**2 + 1.0 / 12.0)
"""A tenth more than the variance of the point spread: what a correction of second order leaves out."""
SIZE, WITHIN = 41, 3.0


def edge(x):
    """A step at 0 from 0 to 1, as pixels at x see it."""

    def integral(y):
        return y * norm.cdf(y / GAUSSIAN) + GAUSSIAN * norm.pdf(y / GAUSSIAN)

    return integral(x + 0.5) - integral(x - 0.5)


def corner_at(place):
    """Image of the bright quadrant to the lower right of `place` (u, v), exact but for the 8 bits."""
    columns, rows = (edge(np.arange(SIZE) - at) for at in place)
    return np.rint(60.0 + 140.0 * rows[:, None] * columns).astype(np.uint8)


def displacements(scale, image_blur):
    """Where corners, magnified by `scale`, are found, less where they are; (PLACES, 2) px."""
    rng = np.random.default_rng(0)
    first, now = SIZE // 2 + rng.uniform(-0.5, 0.5, (2, PLACES, 2))
    found = []
    for before, after in zip(first, now, strict=True):
        stored = cut_patches(corner_at(before), [before])
        template = warped_patches(stored, [np.eye(2) / scale], image_blur=image_blur)
        found.append(search(corner_at(after), template, [after], [np.eye(2)], gate=WITHIN).position[0])
    return np.array(found) - now


@pytest.mark.parametrize(("scale", "unmatched"), [(1.1, 4e-3), (1.2, 9e-3), (1.5, 30e-3)])
def test_a_magnified_corner_is_not_displaced(scale, unmatched):
    """Within 5 thousandths of a pixel, standard error 0.7; without the correction it slides into its quadrant."""
    along, uncorrected = (displacements(scale, blur).mean(axis=1) for blur in (BLUR, 0.0))
    standard_error = along.std() / np.sqrt(PLACES)
    assert standard_error < 1e-3
    assert abs(along.mean()) < 5e-3
    assert uncorrected.mean() > unmatched
