"""Patches: cut where asked, warped as the plane through the landmark would, no blurrier than the picture. About 1 s."""

import numpy as np
import pytest
from scipy.stats import norm

from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.geometry import rotations
from stereo_slam_env.frontend.matching import search
from stereo_slam_env.frontend.patches import PATCH, SUPPORT, cut_patches, local_affine, parallax, warped_patches

from .textures import Waves, spread_points

WAVES = Waves(0, shortest=7.0)


def offsets(size):
    reach = np.arange(size) - size // 2
    return np.stack(np.meshgrid(reach, reach), axis=-1).astype(float)


def test_a_patch_is_centred_between_the_pixels():
    image = WAVES.image(300, 200)
    centers = spread_points(np.random.default_rng(0), 50, 300, 200)
    patches = cut_patches(image, centers)
    truth = WAVES.at(centers[:, None, None] + offsets(SUPPORT))
    assert patches.shape == (50, SUPPORT, SUPPORT)
    assert patches.dtype == np.float32
    assert np.sqrt(np.mean((patches - truth) ** 2)) < 1.0  # rounding to 8 bits leaves 0.3
    assert abs((patches - truth).mean()) < 0.02


def test_whole_pixels_are_copied_and_the_border_is_repeated():
    image = WAVES.image(100, 80)
    inside, corner = cut_patches(image, [(40.0, 30.0), (0.0, 79.0)], 5)
    np.testing.assert_array_equal(inside, image[28:33, 38:43])
    np.testing.assert_array_equal(corner[2:, :3], image[79, 0])
    np.testing.assert_array_equal(corner[:3, 2:], image[77:80, 0:3])
    far = cut_patches(image, [(-1000.0, 40.0), (50.0, 5000.0)], 5)
    np.testing.assert_array_equal(far[0], np.repeat(far[0][:, :1], 5, axis=1))
    assert cut_patches(image, np.zeros((0, 2))).shape == (0, SUPPORT, SUPPORT)


def random_views(rng, count):
    """Affine maps (count, 2, 2) that magnify by 1 to 1.6, turn and shear."""
    return np.linalg.inv(rng.uniform(1.0, 1.6, (count, 1, 1)) * np.eye(2) + rng.uniform(-0.15, 0.15, (count, 2, 2)))


class Parabolas:
    """Quadratic textures, which Catmull-Rom interpolation reproduces: values, and second derivatives (N, 2, 2)."""

    def __init__(self, rng, count):
        self.slope, half = rng.uniform(-5, 5, (count, 2)), rng.uniform(-1, 1, (count, 2, 2))
        self.second = half + half.transpose(0, 2, 1)

    def at(self, points):
        bend = 0.5 * np.einsum("n...i,nij,n...j->n...", points, self.second, points)
        return 100.0 + np.einsum("n...i,ni->n...", points, self.slope) + bend


def test_a_quadratic_texture_is_warped_exactly():
    rng = np.random.default_rng(4)
    affine, texture = random_views(rng, 60), Parabolas(rng, 60)
    stored = texture.at(np.broadcast_to(offsets(SUPPORT), (60, SUPPORT, SUPPORT, 2))).astype(np.float32)
    seen = texture.at(np.einsum("nij,rcj->nrci", affine, offsets(PATCH)))
    np.testing.assert_allclose(warped_patches(stored, affine), seen, atol=1e-3)


def test_the_blur_that_magnification_adds_is_taken_away():
    """Blur C adds tr(C H) / 2 to a quadratic texture, with H the second derivatives as they look now."""
    rng = np.random.default_rng(5)
    affine, texture, blur = random_views(rng, 60), Parabolas(rng, 60), 0.7
    stored = texture.at(np.broadcast_to(offsets(SUPPORT), (60, SUPPORT, SUPPORT, 2))).astype(np.float32)
    gained = blur * (np.linalg.inv(affine.transpose(0, 2, 1) @ affine) - np.eye(2))
    assert np.abs(gained).max() < 1.5
    second = affine.transpose(0, 2, 1) @ texture.second @ affine
    added = 0.5 * np.einsum("nij,nji->n", gained, second)
    difference = warped_patches(stored, affine, image_blur=blur) - warped_patches(stored, affine)
    np.testing.assert_allclose(difference, np.broadcast_to(-added[:, None, None], difference.shape), atol=2e-3)


@pytest.mark.parametrize("scale", [3.0, 1e3, 1e9])
def test_no_more_than_one_and_a_half_square_pixels_of_blur_are_taken_away(scale):
    texture = Parabolas(np.random.default_rng(6), 1)
    stored = texture.at(offsets(SUPPORT)[None]).astype(np.float32)
    affine = [np.eye(2) / scale]
    added = 0.5 * 1.5 * np.trace(texture.second[0]) / scale**2
    difference = warped_patches(stored, affine, image_blur=1.0) - warped_patches(stored, affine)
    np.testing.assert_allclose(difference, np.full_like(difference, -added), atol=1e-3)


def test_no_change_of_view_leaves_the_middle_as_it_is():
    patches = cut_patches(WAVES.image(300, 200), spread_points(np.random.default_rng(2), 1500, 300, 200))
    same = warped_patches(patches, np.tile(np.eye(2), (1500, 1, 1)))
    edge = (SUPPORT - PATCH) // 2
    np.testing.assert_allclose(same, patches[:, edge:-edge, edge:-edge], atol=1e-3)


def test_shrinking_does_not_alias():
    fine = np.indices((100, 100)).sum(axis=0) % 2 * 100 + 50  # a chess board of single pixels
    shrunk = warped_patches(cut_patches(fine.astype(np.uint8), [(50.0, 50.0)]), [2.0 * np.eye(2)])
    assert np.ptp(shrunk) < 5
    np.testing.assert_allclose(shrunk, 100, atol=3)


def plane_points(uvd, pixels):
    """Where the rays of `pixels` (N, K, 2) meet the fronto-parallel planes through the landmarks."""
    depth = CAMERA.disparity_constant / uvd[:, 2]
    return CAMERA.ray(pixels) * depth[:, None, None]


def test_the_affine_map_is_the_derivative_of_the_plane_s_image():
    rng = np.random.default_rng(3)
    uvd = rng.uniform((300, 100, 4), (1000, 300, 60), (30, 3))
    R = np.array([rotations.exp(phi) for phi in rng.uniform(-0.2, 0.2, (30, 3))])
    t = rng.uniform(-1.0, 1.0, (30, 3))
    step = 1e-4 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    now = plane_points(uvd, uvd[:, None, :2] + step) @ R.transpose(0, 2, 1) + t[:, None]
    pixels = CAMERA.project(now)[..., :2]
    forward = np.stack([pixels[:, 0] - pixels[:, 1], pixels[:, 2] - pixels[:, 3]], axis=2) / 2e-4
    np.testing.assert_allclose(local_affine(CAMERA, uvd, R, t), np.linalg.inv(forward), atol=1e-5)


def test_one_step_serves_for_all_and_infinity_is_nothing_special():
    uvd = np.array([[600.0, 200.0, 20.0], [700.0, 150.0, 0.0]])
    R, t = rotations.exp([0.0, 0.1, 0.0]), np.array([0.0, 0.0, -5.0])
    each = local_affine(CAMERA, uvd, np.stack([R, R]), np.stack([t, t]))
    np.testing.assert_array_equal(local_affine(CAMERA, uvd, R, t), each)
    np.testing.assert_allclose(each[1], local_affine(CAMERA, uvd[1:], R, np.zeros(3))[0])
    near, far = np.linalg.det(each)
    assert near < 0.7 < 0.9 < far  # five metres nearer, only the near one has grown


def test_parallax_is_what_a_little_more_depth_would_change():
    uvd = np.array([[600.0, 200.0, 20.0], [900.0, 150.0, 6.0], [700.0, 150.0, 0.0]])
    R, t = rotations.exp([0.0, 0.1, 0.02]), np.array([0.4, 0.1, -3.0])
    share = 1e-6
    w = uvd[:, 2] / CAMERA.disparity_constant

    def seen(inverse_depth):
        return CAMERA.project_scaled(CAMERA.ray(uvd) @ R.T + inverse_depth[:, None] * t, inverse_depth)[:, :2]

    numeric = (seen(w * (1 + share)) - seen(w * (1 - share))) / (2 * share)
    np.testing.assert_allclose(parallax(CAMERA, uvd, R, t), numeric, atol=1e-4)


def test_bad_input_is_named():
    image = WAVES.image(60, 60)
    with pytest.raises(ValueError, match="centers"):
        cut_patches(image, [[np.nan, 3.0]])
    patches = cut_patches(image, [[30.0, 30.0]])
    with pytest.raises(ValueError, match="affine"):
        warped_patches(patches, np.full((1, 2, 2), np.inf))
    with pytest.raises(ValueError, match="one matrix per patch"):
        warped_patches(patches, np.tile(np.eye(2), (2, 1, 1)))


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
