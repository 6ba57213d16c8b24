"""What a real camera adds: the amounts that were asked for, the same for the same seed and frame."""

import numpy as np
import pytest

from stereo_slam_env.rendering.pinhole import StereoImages, grey
from stereo_slam_env.rendering.renderers import CameraEffects

SHAPE = (391, 640)


def flat_pair(level, channels=3):
    image = np.full((*SHAPE, channels)[: 3 if channels > 1 else 2], level, dtype=np.uint8)
    return StereoImages(image, image.copy(), np.full(SHAPE, 7.0))


def textured_pair(seed=0):
    left, right = np.random.default_rng(seed).integers(0, 256, (2, *SHAPE, 3), dtype=np.uint8)
    return StereoImages(left, right, np.full(SHAPE, 7.0))


def test_a_perfect_camera_changes_nothing_and_copies():
    pair = textured_pair()
    seen = CameraEffects().apply(pair, 3)
    np.testing.assert_array_equal(seen.left, pair.left)
    np.testing.assert_array_equal(seen.right, pair.right)
    assert seen.left is not pair.left
    CameraEffects.random(np.random.default_rng(1)).apply(pair, 0)
    np.testing.assert_array_equal([pair.left, pair.right], [textured_pair().left, textured_pair().right])
    drawn = [CameraEffects.random(np.random.default_rng(seed)) for seed in range(20)]
    assert len({effects.seed for effects in drawn}) == 20
    assert np.std([effects.gain for effects in drawn]) > 0.05
    assert seen.depth is pair.depth


def test_noise_depends_on_seed_frame_and_eye_only():
    effects = CameraEffects.random(np.random.default_rng(4))
    pair = flat_pair(120)
    one = effects.apply(pair, 7)
    effects.apply(pair, 8)
    np.testing.assert_array_equal(effects.apply(pair, 7).left, one.left)
    np.testing.assert_array_equal(CameraEffects.random(np.random.default_rng(4)).apply(pair, 7).right, one.right)
    quiet = CameraEffects(read_noise=4.0)
    draws = [quiet.apply(pair, 0).left, quiet.apply(pair, 0).right, quiet.apply(pair, 1).left,
             CameraEffects(read_noise=4.0, seed=1).apply(pair, 0).left]  # fmt: skip
    together = np.corrcoef([draw[..., 0].ravel().astype(float) for draw in draws])
    assert np.abs(together - np.eye(4)).max() < 5.0 / np.sqrt(np.prod(SHAPE))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("level", "read", "shot"), [(120, 4.0, 0.0), (180, 2.0, 0.1), (60, 0.0, 0.2)])
def test_the_noise_is_as_strong_as_asked_for(channels, level, read, shot):
    seen = CameraEffects(read_noise=read, shot_noise=shot, seed=3).apply(flat_pair(level, channels), 0)
    for image in (seen.left, seen.right):
        noise = grey(image).astype(float) - level
        # Rounding to whole grey levels adds a twelfth to the variance.
        expected = np.sqrt(read**2 + shot * level + 1 / 12)
        assert noise.std() == pytest.approx(expected, rel=0.01)
        assert abs(noise.mean()) < 5 * expected / np.sqrt(noise.size)
        kurtosis = np.mean(noise**4) / np.mean(noise**2) ** 2
        assert kurtosis == pytest.approx(3.0, abs=0.1)


def test_noise_is_white():
    noise = CameraEffects(read_noise=5.0).apply(flat_pair(128), 0).left[..., 0].astype(float) - 128
    for shift in ((0, 1), (1, 0), (1, 1), (0, 8)):
        correlation = (noise * np.roll(noise, shift, axis=(0, 1))).mean() / noise.var()
        assert abs(correlation) < 5.0 / np.sqrt(noise.size)


def test_gain_and_gamma_make_the_tone_curve():
    seen = CameraEffects(gain=1.2, gamma=0.8).apply(flat_pair(100), 0).left
    assert seen[0, 0, 0] == round(255 * (1.2 * 100 / 255) ** 0.8)
    assert (CameraEffects(gain=3.0).apply(flat_pair(100), 0).left == 255).all()


def test_vignetting_darkens_the_corners_and_not_the_middle():
    seen = CameraEffects(vignetting=0.3).apply(flat_pair(200), 0).left
    assert seen[0, 0, 0] == seen[-1, -1, 2] == 140
    assert seen[SHAPE[0] // 2, SHAPE[1] // 2, 1] == 200
    assert 140 < seen[0, SHAPE[1] // 2, 0] < 200


def test_blur_spreads_a_point_by_its_sigma():
    image = np.zeros((*SHAPE, 3), dtype=np.uint8)
    image[100:102, 200:202] = 250
    seen = CameraEffects(blur=1.5).on(image, 0, 0)[..., 0].astype(float)
    columns = np.arange(SHAPE[1])
    center = (seen * columns).sum() / seen.sum()
    variance = (seen * (columns - center) ** 2).sum() / seen.sum()
    assert center == pytest.approx(200.5, abs=0.02)
    assert variance == pytest.approx(1.5**2 + 0.25, rel=0.1)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"gain": 0.0}, "gain must be > 0, got 0.0"),
        ({"gamma": np.nan}, "gamma must be > 0, got nan"),
        ({"read_noise": -1.0}, "read_noise must be >= 0, got -1.0"),
        ({"vignetting": 1.5}, "vignetting must be from 0 to 1, got 1.5"),
        ({"blur": np.inf}, "blur must be >= 0, got inf"),
    ],
)
def test_bad_numbers_are_refused(bad, message):
    with pytest.raises(ValueError, match=message):
        CameraEffects(**bad)
