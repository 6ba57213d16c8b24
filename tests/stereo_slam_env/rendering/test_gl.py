"""What only the OpenGL back end has to show: samples, memory, several of them, forks, what is missing. About 12 s."""

import multiprocessing
import os
import re
import subprocess
import sys

import numpy as np
import pytest

from filters import Pose
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from stereo_slam_env.rendering.renderers import make_renderer
from stereo_slam_env.world.routes import ROUTES
from stereo_slam_env.world.scene import Box, Cylinder, Look, Material
from stereo_slam_env.world.street import build_street

from .planes import AHEAD, FRAME, Wall, drawing, scene_of, skip_where_missing

CAMERA = StereoCamera(100.0, 100.0, 79.5, 59.5, 0.5, 160, 120)
BARK = Material((0.8, 0.7, 0.6), "bark", (0.7, 1.3))
POLES = tuple(Cylinder((8.0 + 2 * i, 3.0 - i, 0.0), (8.5 + 2 * i, 3.2 - i, 5.0), 0.2, BARK) for i in range(6))
SCENE = scene_of(Wall(40.0, 0.3, Material((0.9, 0.9, 0.9), "leaves", (3.0, 3.0))).box, *POLES)


@pytest.fixture(autouse=True)
def _needs_gl():
    skip_where_missing("gl")


def new_renderer(camera=CAMERA, **options):
    return make_renderer("gl", camera=camera, frame=FRAME, **options)


def same(one, two):
    return all(np.array_equal(getattr(one, part), getattr(two, part)) for part in ("left", "right", "depth"))


@pytest.mark.parametrize("options", [{"samples": 4}, {"supersample": 2}, {"supersample": 2, "samples": 4}], ids=str)
def test_more_samples_smooth_the_edges_and_leave_the_depth_alone(options):
    with drawing("gl", SCENE, CAMERA) as renderer:
        plain = renderer.render_pair(AHEAD)
    with drawing("gl", SCENE, CAMERA, **options) as renderer:
        smooth = renderer.render_pair(AHEAD)
    np.testing.assert_array_equal(smooth.depth, plain.depth)
    difference = np.abs(smooth.left.astype(int) - plain.left.astype(int)).max(axis=2)
    assert 0.005 < (difference > 8).mean() < 0.5
    assert not np.array_equal(smooth.left, smooth.right)


def test_it_looks_like_the_other_back_end():
    route = ROUTES["right-turn"]()
    scene = build_street(route, np.random.default_rng(0))
    camera = StereoCamera(170.0, 170.0, 160.0, 110.0, 0.5, 320, 240)
    pose = Pose(route.positions[30], rotations.exp_quaternion([0.0, route.headings[30], 0.0]))
    pictures = {}
    for name in ("tiny", "gl"):
        with drawing(name, scene, camera) as renderer:
            pictures[name] = renderer.render_pair(pose)
    tiny, gl = pictures["tiny"], pictures["gl"]
    assert (np.isfinite(tiny.depth) == np.isfinite(gl.depth)).mean() > 0.999
    both = np.isfinite(tiny.depth) & np.isfinite(gl.depth)
    assert (np.abs(gl.depth[both] / tiny.depth[both] - 1) < 1e-3).mean() > 0.999
    for one, two in ((tiny.left, gl.left), (tiny.right, gl.right)):
        difference = two.astype(int) - one.astype(int)
        assert np.abs(difference).mean() < 8  # texels: nearest there, interpolated here
        np.testing.assert_allclose(difference.mean(axis=(0, 1)), 0.0, atol=2.5)


def test_far_from_the_origin_things_are_as_exact():
    """Two kilometres along the road: the same depths of the same surroundings, to the precision of vertices there."""
    depths = []
    for start in (0.0, 2000.0):
        box = Box((start + 12.0, 1.0, 2.0), (2.0, 4.0, 4.0), 0.3, Material((0.9, 0.2, 0.2)))
        with drawing("gl", scene_of(box), CAMERA) as renderer:
            depths.append(renderer.render_pair(Pose(np.array([0.0, 0.0, start + 0.3]), AHEAD.orientation)).depth)
    near, far = depths
    on_box = (near < 14.0) & (far < 14.0) & (np.indices(near.shape)[0] < CAMERA.cy)
    assert on_box.sum() > 100
    np.testing.assert_allclose(far[on_box], near[on_box], atol=4e-4)


def test_several_renderers_do_not_disturb_each_other():
    small = StereoCamera(50.0, 50.0, 39.5, 29.5, 0.3, 80, 60)
    other_scene = scene_of(Wall(15.0, -0.4).box, look=Look(haze_range=30.0))
    with drawing("gl", SCENE, CAMERA) as renderer:
        alone = renderer.render_pair(AHEAD)
    with drawing("gl", other_scene, small) as renderer:
        other_alone = renderer.render_pair(AHEAD)
    one, two = new_renderer(), new_renderer(small)
    one.build(SCENE)
    two.build(other_scene)
    for _ in range(2):
        assert same(one.render_pair(AHEAD), alone)
        assert same(two.render_pair(AHEAD), other_alone)
    one.close()
    assert same(two.render_pair(AHEAD), other_alone)
    two.close()


def resident_megabytes():
    with open("/proc/self/statm") as statistics:
        return int(statistics.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="memory is read from /proc")
def test_memory_stays_flat_over_many_scenes_and_many_renderers():
    def scenes(count):
        with drawing("gl", SCENE, CAMERA) as renderer:
            for _ in range(count):
                renderer.build(SCENE)
                renderer.render_pair(AHEAD)

    def renderers(count):
        for i in range(count):
            renderer = new_renderer()
            renderer.build(SCENE)
            renderer.render_pair(AHEAD)
            if i % 2:
                renderer.close()  # the others are dropped

    for cycles, count in ((scenes, 60), (renderers, 30)):
        cycles(8)
        before = resident_megabytes()
        cycles(count)
        assert resident_megabytes() - before < 8.0


@pytest.mark.parametrize("used_before", [False, True])
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_drawing_in_a_fork_is_refused_and_does_not_hang(used_before):
    with drawing("gl", SCENE, CAMERA) as renderer:
        renderer.render_pair(AHEAD)
        context = multiprocessing.get_context("fork")
        answers = context.SimpleQueue()

        def draw():
            try:
                (renderer if used_before else new_renderer()).render_pair(AHEAD)
            except RuntimeError as error:
                answers.put(str(error))

        child = context.Process(target=draw)
        child.start()
        child.join(30)
        try:
            assert child.exitcode == 0
            assert 'start processes with the method "forkserver" or "spawn"' in answers.get()
        finally:
            child.kill()


def test_what_is_missing_is_named_with_its_remedy(missing_gl):
    with pytest.raises((ImportError, RuntimeError), match=re.escape(missing_gl)) as caught:
        new_renderer()
    assert "\n" not in str(caught.value)


def test_too_many_samples_are_refused():
    with pytest.raises(ValueError, match=r"samples must be from 1 to \d+ .* got 1000"):
        new_renderer(samples=1000)


def test_drawing_needs_a_scene_and_an_open_renderer():
    renderer = new_renderer()
    with pytest.raises(RuntimeError, match="build"):
        renderer.render_pair(AHEAD)
    renderer.build(SCENE)
    renderer.close()
    renderer.close()
    with pytest.raises(RuntimeError, match="closed"):
        renderer.render_pair(AHEAD)
    with pytest.raises(RuntimeError, match="closed"):
        renderer.build(SCENE)


def test_pytorch_with_triton_can_be_loaded_after_it():
    pytest.importorskip("triton", reason="PyTorch for the CPU comes without Triton")
    code = "from stereo_slam_env.rendering.gl_resources import device; device(); import triton._C.libtriton"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100)
    assert ended.returncode == 0, ended.stderr
