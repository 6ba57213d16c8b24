"""Refinement: to the maximum from a pixel nearby, and a covariance whatever the texture. About 1 s."""

import numpy as np
import pytest

from stereo_slam_env.frontend.matching import refine
from stereo_slam_env.frontend.patches import PATCH, cut_patches

from .textures import Waves, spread_points

NO_OFFSET = np.zeros((1, 2))


def at_pixel(image, pixel, offset=NO_OFFSET, template=None):
    pixel = np.atleast_2d(pixel)
    template = cut_patches(image, pixel, PATCH) if template is None else template
    return refine(image, template, pixel, np.broadcast_to(offset, pixel.shape))


def test_it_gets_there_from_a_pixel_away():
    image, n = Waves(0, shortest=8.0).image(400, 300), 200
    centers = spread_points(np.random.default_rng(0), n, 400, 300)
    refined = refine(image, cut_patches(image, centers, PATCH), np.rint(centers).astype(int), np.zeros((n, 2)))
    assert refined.converged.all()
    assert np.abs(refined.position - centers).max() < 0.1
    assert refined.score.min() > 0.99


def test_where_it_goes_astray_the_parabolas_stand():
    image = Waves(1).image(400, 300)
    pixel = np.rint(spread_points(np.random.default_rng(0), 100, 400, 300)).astype(int)
    elsewhere = cut_patches(Waves(2).image(400, 300), pixel, PATCH)
    refined = at_pixel(image, pixel, np.array([0.25, -0.125]), elsewhere)
    assert not refined.converged.all()
    lost = ~refined.converged
    np.testing.assert_array_equal(refined.position[lost], pixel[lost] + [0.25, -0.125])


@pytest.mark.parametrize("kind", ["flat", "edge", "slanted edge", "point"])
def test_any_texture_has_a_covariance(kind):
    v, u = np.indices((60, 60))
    values = {
        "flat": np.full(u.shape, 90),
        "edge": np.where(u > 30, 200, 50),
        "slanted edge": np.clip(100 + 20 * (u - v), 0, 255),
        "point": np.where((u == 30) & (v == 30), 255, 10),
    }[kind]
    refined = at_pixel(values.astype(np.uint8), (30, 30))
    eigenvalues = np.linalg.eigvalsh(refined.covariance)
    assert np.isfinite(refined.position).all()
    assert (eigenvalues > 0).all()
    noisy = np.clip(values + np.random.default_rng(0).normal(0, 2.0, values.shape), 0, 255).astype(np.uint8)
    seen = at_pixel(noisy, (30, 30), template=cut_patches(values.astype(np.uint8), [(30.0, 30.0)], PATCH))
    smallest, largest = np.linalg.eigvalsh(seen.covariance)[0]
    assert 0 < smallest <= largest
    if kind.endswith("edge"):  # known across, not along
        assert smallest < 0.1**2
        assert largest > 50 * smallest


def test_no_landmarks():
    image = Waves(3).image(60, 60)
    refined = refine(image, np.zeros((0, PATCH, PATCH), dtype=np.float32), np.zeros((0, 2), int), np.zeros((0, 2)))
    assert refined.covariance.shape == (0, 2, 2)
