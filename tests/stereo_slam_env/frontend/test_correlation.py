"""Active search: right place, honest covariance, nothing outside the ellipse; refinement to the maximum. About 4 s."""

import cv2
import numpy as np
import pytest

from stereo_slam_env.frontend.correlation import correlation_map
from stereo_slam_env.frontend.matching import refine, search
from stereo_slam_env.frontend.patches import PATCH, cut_patches

from .textures import Waves, spread_points

SIZE = (500, 391)
SHIFTS = [(0.25, -0.4), (0.5, 0.5), (-1.3, 0.75), (2.1, -2.6)]


def circles(count, sigma):
    return np.tile(sigma**2 * np.eye(2), (count, 1, 1))


def followed(shift, noise, count=400, seed=0, **options):
    """Landmarks of one image searched for in the same image moved by `shift`; the errors (N, 2) and the result."""
    rng, waves = np.random.default_rng(seed), Waves(seed)
    then, now = waves.image(*SIZE, noise=noise, rng=rng), waves.image(*SIZE, shift, noise, rng)
    centers = spread_points(rng, count, *SIZE)
    result = search(now, cut_patches(then, centers, PATCH), centers, circles(count, 2.0), **options)
    return result.position - centers - shift, result


def test_correlation_is_that_of_opencv():
    rng = np.random.default_rng(0)
    windows = rng.integers(0, 255, (20, 36, 54), dtype=np.uint8)
    templates = rng.integers(0, 255, (20, PATCH, PATCH)).astype(np.float32)
    for window, template in zip(windows, templates, strict=True):
        expected = cv2.matchTemplate(window.astype(np.float32), template, cv2.TM_CCOEFF_NORMED)
        np.testing.assert_allclose(correlation_map(window, template), expected, atol=2e-5)


@pytest.mark.parametrize("shift", SHIFTS)
def test_the_position_has_no_bias(shift):
    error, result = followed(shift, noise=0.0)
    assert not result.on_border.any()
    assert np.abs(error.mean(axis=0)).max() < 0.005
    assert error.std(axis=0).max() < 0.03
    assert result.score.min() > 0.98


@pytest.mark.parametrize("noise", [4.0, 7.0, 12.0])
def test_the_covariance_is_that_of_the_errors(noise):
    errors, covariances = [], []
    for seed, shift in enumerate(SHIFTS):
        error, result = followed(shift, noise, seed=seed)
        good = result.score > 0.7
        errors.append(error[good])
        covariances.append(result.covariance[good])
    e, P = np.concatenate(errors), np.concatenate(covariances)
    normalised = np.einsum("ni,nij,nj->n", e, np.linalg.inv(P), e)
    assert len(e) > 1500
    assert np.abs(e.mean(axis=0)).max() < 0.02
    assert 0.7 < 0.5 * normalised.mean() < 1.4
    assert (normalised > 13.8).mean() < 0.01  # 0.1 % of a chi-square with 2


def test_along_an_edge_the_covariance_is_long():
    v, u = np.indices((200, 200))
    edge = 128.0 + 60.0 * np.tanh((u - v) / 3.0)
    rng = np.random.default_rng(0)
    then, now = (np.rint(edge + rng.normal(0, 3.0, edge.shape)).astype(np.uint8) for _ in range(2))
    center = np.array([[100.0, 100.0]])
    found = search(now, cut_patches(then, center, PATCH), center, circles(1, 2.0))
    along, across = np.array([1.0, 1.0]) / np.sqrt(2), np.array([1.0, -1.0]) / np.sqrt(2)
    assert along @ found.covariance[0] @ along > 50 * (across @ found.covariance[0] @ across)
    assert abs((found.position[0] - center[0]) @ across) < 0.15


def test_candidates_are_those_in_the_ellipse():
    waves, n = Waves(2), 200
    rng = np.random.default_rng(4)
    centers = spread_points(rng, n, *SIZE, margin=60)
    angle, (a, b) = rng.uniform(0, np.pi, n), (np.array([5.0, 1.5]))
    axes = np.stack([np.stack([np.cos(angle), -np.sin(angle)], -1), np.stack([np.sin(angle), np.cos(angle)], -1)], 1)
    S = axes @ np.diag([a**2, b**2]) @ axes.transpose(0, 2, 1)
    templates = cut_patches(waves.image(*SIZE), centers, PATCH)
    for inside, radius in ((True, 0.9), (False, 1.25)):
        turned = rng.uniform(0, 2 * np.pi, n)
        away = np.einsum("nij,nj->ni", axes, 3.0 * radius * np.stack([a * np.cos(turned), b * np.sin(turned)], -1))
        away += 0.0 if inside else 1.5 * away / np.linalg.norm(away, axis=1, keepdims=True)
        found = search(waves.image(*SIZE), templates, centers - away, S, gate=3.0)
        hit = np.linalg.norm(found.position - centers, axis=1) < 0.5
        off = found.position - (centers - away)
        squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(S + 0.8 * np.eye(2)), off)
        if inside:
            assert hit.all()
            assert not found.on_border.any()
        else:
            assert not hit.any()
            assert found.on_border.mean() > 0.3
        assert (squared[~found.on_border] <= 9.0).all()


def test_a_tight_ellipse_still_has_its_pixel():
    waves = Waves(0)
    centers = spread_points(np.random.default_rng(1), 50, *SIZE)
    now = waves.image(*SIZE, (0.3, -0.3))
    templates = cut_patches(waves.image(*SIZE), centers, PATCH)
    tight = search(now, templates, centers + np.array([0.3, -0.3]), circles(50, 0.01))
    assert np.abs(tight.position - centers - (0.3, -0.3)).max() < 0.08
    assert not tight.on_border.any()


def test_a_repeated_pattern_has_a_rival_as_good():
    tile = Waves(3).image(14, 14)
    image = np.tile(tile, (20, 20))
    centers = spread_points(np.random.default_rng(0), 40, 280, 280, margin=60)
    repeated = search(image, cut_patches(image, centers, PATCH), centers, circles(40, 6.0))
    assert (repeated.second > 0.95 * repeated.score).all()
    _, unique = followed((0.0, 0.0), noise=2.0)
    assert (unique.second < 0.9 * unique.score).mean() > 0.99


def test_outside_the_image_nothing_is_found():
    image = Waves(6).image(200, 150)
    centers = np.array([[-30.0, 75.0], [100.0, 400.0], [100.0, 75.0], [3.0, 75.0]])
    found = search(image, cut_patches(image, centers, PATCH), centers, circles(4, 2.0))
    assert found.score[:2].tolist() == [-1.0, -1.0]
    assert np.isnan(found.position[:2]).all()
    assert np.isnan(found.covariance[:2]).all()
    assert found.score[2] > 0.99
    assert (found.position[3] >= PATCH // 2 - 1).all()  # the patch does not fit in at u = 3


def test_the_radius_has_a_limit_and_large_ellipses_work():
    waves = Waves(7)
    centers = spread_points(np.random.default_rng(0), 20, *SIZE, margin=80)
    templates = cut_patches(waves.image(*SIZE), centers, PATCH)
    wide = search(waves.image(*SIZE, (30.4, -20.2)), templates, centers, circles(20, 15.0))
    assert np.abs(wide.position - centers - (30.4, -20.2)).max() < 0.1
    limited = search(waves.image(*SIZE, (30.4, -20.2)), templates, centers, circles(20, 15.0), max_radius=10.0)
    assert np.abs(limited.position - centers).max() <= 11.0


def test_no_landmarks_and_bad_input():
    image = Waves(8).image(100, 100)
    nothing = search(image, np.zeros((0, PATCH, PATCH), dtype=np.float32), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    assert nothing.position.shape == (0, 2)
    assert nothing.covariance.shape == (0, 2, 2)
    patch = cut_patches(image, [[50.0, 50.0]], PATCH)
    with pytest.raises(ValueError, match="centers"):
        search(image, patch, [[np.nan, 3.0]], circles(1, 2.0))
    with pytest.raises(ValueError, match="S must"):
        search(image, patch, [[50.0, 50.0]], np.eye(2))
    with pytest.raises(ValueError, match="positive semi-definite"):
        search(image, patch, [[50.0, 50.0]], [np.diag([4.0, -4.0])])


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
