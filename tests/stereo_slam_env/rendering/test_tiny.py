"""What only TinyRenderer has to show; see test_geometry.py for what it shares with the other back end."""

import numpy as np

from filters.geometry.camera import StereoCamera
from stereo_slam_env.rendering import pinhole
from stereo_slam_env.rendering.tiny import Air
from stereo_slam_env.world.frames import R_SW
from stereo_slam_env.world.scene import Look

from .planes import AHEAD, Wall, drawing, scene_of

CAMERA = StereoCamera(100.0, 100.0, 79.5, 59.5, 0.5, 160, 120)


def test_supersampling_keeps_the_picture():
    scene = scene_of(Wall(20.0, 0.5).box)
    with drawing("tiny", scene, CAMERA) as renderer:
        plain = renderer.render_pair(AHEAD)
    for factor in (2, 3):
        with drawing("tiny", scene, CAMERA, supersample=factor) as renderer:
            fine = renderer.render_pair(AHEAD)
        assert fine.left.shape == plain.left.shape
        assert np.abs(fine.left.astype(int) - plain.left.astype(int)).mean() < 2


def test_haze_and_sky_are_what_the_formulas_say():
    rng = np.random.default_rng(0)
    look = Look(haze_range=90.0)
    rgb = rng.integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    depth = rng.uniform(0.5, 300.0, rgb.shape[:2]).astype(np.float32)
    depth[:70][rng.random((70, CAMERA.width)) < 0.4] = np.inf
    x, y = np.meshgrid((np.arange(160) - CAMERA.cx) / CAMERA.fx, (np.arange(120) - CAMERA.cy) / CAMERA.fy)
    up = (np.stack([x, y, np.ones_like(x)], axis=-1) @ R_SW.T)[..., 2]
    height = np.sqrt(np.clip(up / 0.45, 0.0, 1.0))[..., None]
    sky = (1 - height) * np.array(look.horizon) + height * np.array(look.zenith)
    clear = np.exp(-depth / look.haze_range)[..., None]
    expected = np.where(np.isinf(depth)[..., None], sky, clear * rgb + (1 - clear) * np.array(look.horizon))
    seen = Air(CAMERA, look).over(rgb, depth, R_SW)
    assert np.abs(seen - expected).max() <= 1.0


def test_the_depth_of_an_even_supersampling_is_that_of_the_centres():
    """Between four samples 1/z is averaged where they are on one surface; at an edge one of them is taken."""
    fine = pinhole.supersampled(CAMERA, 2)
    rows, columns = np.indices((fine.height, fine.width))
    depth = 1.0 / (0.02 + 1e-4 * columns + 3e-4 * rows)
    depth[:, 101:] = 5.0
    depth[:, 201:] = np.inf
    seen = pinhole.centre_depth(depth, 2)
    rows, columns = np.indices((CAMERA.height, CAMERA.width))
    plane = 1.0 / (0.02 + 1e-4 * (2 * columns + 0.5) + 3e-4 * (2 * rows + 0.5))
    np.testing.assert_allclose(seen[:, :50], plane[:, :50], rtol=1e-12)
    np.testing.assert_array_equal(seen[:, 50:100], 5.0)
    assert np.isinf(seen[:, 100:]).all()
