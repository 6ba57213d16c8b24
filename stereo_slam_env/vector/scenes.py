"""Scenes of many environments as arrays: built for an episode, or taken from a pool."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.envs.options import StereoOptions
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.vector.state import Fleet
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.rays import Obstacles, obstacles
from stereo_slam_env.world.routes import Route
from stereo_slam_env.world.surroundings import build_scene


class SceneArrays(NamedTuple):
    """Landmarks in W (N, 3), m, and the solids that hide them."""

    landmarks: FloatArray
    solids: Obstacles


def scene_arrays(options: StereoOptions, route: Route, rng: np.random.Generator) -> SceneArrays:
    """The scene that an environment with these options builds."""
    scene = build_scene(options.surroundings, route, rng, randomise=options.randomise)
    return SceneArrays(WorldFrame(CAMERA_HEIGHT).to_world(scene.landmark_points), obstacles(scene.solids))


def put_scene(fleet: Fleet, b: int, scene: SceneArrays) -> None:
    """Put a scene where environment `b` has it; there must be room."""
    landmarks, solids = len(scene.landmarks), len(scene.solids.solids)
    fleet.landmarks[b, :, :landmarks] = scene.landmarks.T
    fleet.solids[b, :solids] = scene.solids.solids
    nodes = len(scene.solids.bounds)
    fleet.bounds[b, :nodes], fleet.links[b, :nodes] = scene.solids.bounds, scene.solids.links
    fleet.sizes[b] = landmarks, nodes


def with_room(fleet: Fleet, scene: SceneArrays) -> Fleet:
    """The same state with room for a scene; itself where there is room."""
    landmarks, solids = len(scene.landmarks), len(scene.solids.solids)
    if landmarks <= fleet.landmarks.shape[2] and solids <= fleet.solids.shape[1]:
        return fleet
    landmarks = max(landmarks + landmarks // 4, fleet.landmarks.shape[2])
    solids = max(solids + solids // 4, fleet.solids.shape[1])
    shapes = {
        "lost": (landmarks,),
        "landmarks": (3, landmarks),
        "solids": (solids,),
        "bounds": (solids,),
        "links": (solids,),
        "exponentials": (max(4096, 4 * landmarks),),
    }

    def grown(name: str) -> Any:
        old = getattr(fleet, name)
        new = np.zeros((len(old), *shapes[name], *old.shape[1 + len(shapes[name]) :]), dtype=old.dtype)
        new[tuple(slice(0, size) for size in old.shape)] = old
        return new

    return fleet._replace(**{name: grown(name) for name in shapes})
