"""Cost of a stereo pair from each back end, beside PyBullet's bare call.

    OPENBLAS_NUM_THREADS=1 taskset -c 0 python benchmarks/rendering_speed.py
    OPENBLAS_NUM_THREADS=1 taskset -c 0 python benchmarks/rendering_speed.py --sizes 320x240 --bodies 300

A street of textured boxes: houses, poles, parked cars and clutter, as many as asked for. Measured in turns, in one
process: two bare `getCameraImage` calls with the same matrices and flags, their pixels and depths made arrays;
`TinyRenderer.render_pair` and `GLRenderer.render_pair` (without and with four samples a pixel). PyBullet built with
NumPy returns arrays. Built without, it returns tuples, and making arrays of them adds half of the time of the calls: a
cost of that build, not of the renderer. Everything is on one core: `taskset` for the process, and Mesa's renderer
without threads (LP_NUM_THREADS=0, the default of the back end). Times are processor time, 20 % quantile; ratios are
those of times of the same turn, median, because the machine's speed changes from turn to turn.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from functools import partial

import cv2
import numpy as np
import pybullet

from filters import Pose
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from harness import arguments, show, undisturbed
from stereo_slam_env.rendering import pinhole
from stereo_slam_env.rendering.gl import GLRenderer
from stereo_slam_env.rendering.pinhole import StereoRenderer
from stereo_slam_env.rendering.tiny import TinyRenderer
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Box, Ground, Material, Scene

FRAME = WorldFrame(1.65)
LENGTH = 150.0
POSES = 3
BARE, TINY, GL, GL_SAMPLES = EVERYTHING = ("two bare calls", "tiny", "gl", "gl, 4 samples")
REPEATS = {BARE: 1, TINY: 1, GL: 4, GL_SAMPLES: 2}
"""Pairs in a row in one turn: what is quick is measured more often."""


def street_of_boxes(bodies: int, seed: int = 0) -> Scene:
    """A street along x: a fifth of the boxes are houses, the others poles, cars and clutter between them."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice(4, size=bodies, p=[0.2, 0.25, 0.25, 0.3])
    return Scene(
        Ground((-20.3, -80.3), (LENGTH + 150.3, 80.3), Material((1.0, 1.0, 1.0), "asphalt", (7.0, 7.0))),
        tuple(_box(rng, kind) for kind in kinds),
        (),
        np.zeros((0, 3)),
    )


def _box(rng: np.random.Generator, kind: int) -> Box:
    along, side = float(rng.uniform(4.0, LENGTH)), float(rng.choice([-1.0, 1.0]))
    color = tuple(rng.uniform(0.5, 1.0, 3).tolist())
    if kind == 0:
        size = (float(rng.uniform(8.0, 16.0)), 10.0, float(rng.uniform(6.0, 14.0)))
        facade = Material(color, str(rng.choice(["plaster", "brick", "office", "balcony"])), (6.4, 6.4))
        return Box((along, side * float(rng.uniform(14.0, 30.0)), 0.5 * size[2]), size, 0.0, facade)
    if kind == 1:
        return Box((along, side * float(rng.uniform(5.5, 8.0)), 3.0), (0.2, 0.2, 6.0), 0.0, Material(color, "bark"))
    if kind == 2:
        return Box((along, side * 4.2, 0.75), (4.2, 1.8, 1.5), 0.0, Material(color, "roof", (2.0, 2.0)))
    size = tuple(rng.uniform(0.3, 1.5, 3).tolist())
    place = (along, side * float(rng.uniform(5.0, 9.0)), 0.5 * size[2])
    return Box(place, size, float(rng.uniform(0.0, np.pi)), Material(color, "brick", (1.0, 1.0)))


def bare_calls(world: PhysicsWorld, camera: StereoCamera, pose: Pose) -> Callable[[], object]:
    """What `TinyRenderer` cannot do without: two calls of PyBullet, and arrays of what they return."""
    R_wc = rotations.matrix(pose.orientation)
    eyes = (pose.position, pose.position + camera.baseline * R_wc[:, 0])
    views = [pinhole.view_matrix(FRAME.to_scene(eye), FRAME.rotation_to_scene(R_wc)) for eye in eyes]
    projection = pinhole.projection_matrix(camera, pinhole.NEAR, pinhole.FAR, pinhole.TINY_OFFSET)

    def draw() -> None:
        for view in views:
            _, _, rgba, depth, _ = pybullet.getCameraImage(
                camera.width,
                camera.height,
                viewMatrix=view.flatten(order="F").tolist(),
                projectionMatrix=projection.flatten(order="F").tolist(),
                lightDirection=[0.35, 0.55, 0.9],
                lightColor=[1.0, 1.0, 1.0],
                lightAmbientCoeff=0.72,
                lightDiffuseCoeff=0.45,
                lightSpecularCoeff=0.0,
                shadow=0,
                flags=pybullet.ER_NO_SEGMENTATION_MASK,
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=world._connected,
            )
            np.frombuffer(bytes(rgba), dtype=np.uint8)
            np.asarray(depth, dtype=np.float32)

    return draw


def camera_of(size: str) -> StereoCamera:
    """The reference rig, or one of the same field of view with another size."""
    width, height = (int(number) for number in size.split("x"))
    focal = 721.5 * width / 1344
    return StereoCamera(focal, focal, 0.5 * width + 3.5, 0.5 * height - 2.5, 0.571, width, height)


def measure(size: str, bodies: int, turns: int, names: Sequence[str] = EVERYTHING) -> dict[str, list[float]]:
    """Processor time of each in each turn, s."""
    camera, scene = camera_of(size), street_of_boxes(bodies)
    world = PhysicsWorld()
    world.build(scene, (4.0, 1.8, 1.0))
    world.dress(scene)
    renderers: dict[str, StereoRenderer] = {TINY: TinyRenderer(camera, FRAME)}
    if GL in names:
        renderers[GL] = GLRenderer(camera, FRAME)
    if GL_SAMPLES in names:
        renderers[GL_SAMPLES] = GLRenderer(camera, FRAME, samples=4)
    for renderer in renderers.values():
        renderer.build(scene)
    times: dict[str, list[float]] = {name: [] for name in names}
    for turn in range(turns * POSES):
        pose = Pose(np.array([0.0, 0.0, 12.0 * (turn % POSES)]), np.array([0.0, 0.0, 0.0, 1.0]))
        draw = {name: partial(renderer.render_pair, pose) for name, renderer in renderers.items()}
        draw[BARE] = bare_calls(world, camera, pose)
        for name in names if turn % 2 else names[::-1]:
            began = time.process_time()
            for _ in range(REPEATS[name]):
                draw[name]()
            times[name].append((time.process_time() - began) / REPEATS[name])
    for thing in (*renderers.values(), world):
        thing.close()
    return times


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, sizes=["1344x391", "320x240"], bodies=[50, 300, 1000], turns=5)
    cv2.setNumThreads(1)
    rows = []
    for size in given.sizes:
        for bodies in given.bodies:
            times = {name: np.array(t) for name, t in measure(size, bodies, given.turns).items()}
            cells = [f"{1e3 * undisturbed(times[name]):.1f}" for name in EVERYTHING]
            ratios = np.median(times[TINY] / times[BARE]), np.median(times[TINY] / times[GL])
            rows.append((size, str(bodies), *cells, f"{ratios[0]:.3f}", f"{ratios[1]:.1f}"))
    title = f"ms of a stereo pair on {len(os.sched_getaffinity(0))} core(s)"
    show(title, ("size", "bodies", *EVERYTHING, "tiny / bare", "pairs/s of gl / tiny"), rows)


if __name__ == "__main__":
    main()
