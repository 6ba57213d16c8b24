"""Scenes as arrays, and room for them in the state."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.simulator.rays import Obstacles, obstacles
from stereo_slam_env.simulator.state import Fleet
from stereo_slam_env.simulator.traffic import Traffic, traffic_arrays
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.routes import Route
from stereo_slam_env.world.scene import Scene


class SceneArrays(NamedTuple):
    """Landmarks in W (N, 3), m, the solids that hide them, what moves, the scene itself for who draws it, its route."""

    landmarks: FloatArray
    solids: Obstacles
    traffic: Traffic
    scene: Scene
    route: Route

    def __deepcopy__(self, memo: dict[int, Any]) -> SceneArrays:
        return self  # nobody changes it


def scene_arrays(scene: Scene, route: Route) -> SceneArrays:
    """A scene along a route as arrays."""
    landmarks = WorldFrame(CAMERA_HEIGHT).to_world(scene.landmark_points)
    return SceneArrays(landmarks, obstacles(scene.solids), traffic_arrays(scene.moving), scene, route)


def put_scene(fleet: Fleet, b: int, scene: SceneArrays) -> None:
    """Put a scene where row `b` has it; there must be room."""
    landmarks, solids, traffic = len(scene.landmarks), scene.solids, scene.traffic
    nodes, bodies, parts = len(solids.bounds), len(traffic.shares), len(traffic.parts)
    fleet.landmarks[b, :, :landmarks] = scene.landmarks.T
    fleet.solids[b, : len(solids.solids)] = solids.solids
    fleet.bounds[b, :nodes], fleet.links[b, :nodes] = solids.bounds, solids.links
    fleet.tracks[b, :bodies, : traffic.tracks.shape[1]] = traffic.tracks
    fleet.shares[b, :bodies], fleet.balls[b, :bodies] = traffic.shares, traffic.balls
    fleet.parts[b, :parts] = traffic.parts
    frames = put_route(fleet, b, scene.route)
    fleet.sizes[b] = landmarks, nodes, bodies, frames


def put_route(fleet: Fleet, b: int, route: Route) -> int:
    """Put a route where row `b` has it, and return its number of frames."""
    frames, steps = route.frames, route.frames - 1
    fleet.positions[b, :frames], fleet.arc_length[b, :frames] = route.positions, route.arc_length
    fleet.attitudes[b, :frames] = route.attitudes.reshape(-1, 9)
    fleet.speeds[b, :steps], fleet.yaw_rates[b, :steps] = route.speeds, route.yaw_rates
    fleet.travel[b, :steps] = route.travel.reshape(-1, 9)
    return frames


def with_room(fleet: Fleet, scene: SceneArrays) -> Fleet:
    """The same state with room for a scene; itself where there is room."""
    landmarks, solids, traffic = len(scene.landmarks), len(scene.solids.solids), scene.traffic
    bodies, frames, parts = len(traffic.shares), traffic.tracks.shape[1], len(traffic.parts)
    there = (
        *(fleet.landmarks.shape[2], fleet.solids.shape[1], *fleet.tracks.shape[1:3]),
        *(fleet.parts.shape[1], fleet.arc_length.shape[1]),
    )
    needed = landmarks, solids, bodies, frames, parts, scene.route.frames
    if all(need <= room for need, room in zip(needed, there, strict=True)):
        return fleet
    landmarks, solids, bodies, frames, parts, steps = (
        room if need <= room else need + need // 4 for need, room in zip(needed, there, strict=True)
    )
    shapes = {
        **dict.fromkeys(("lost", "inside", "seen", "lasting", "measured_at"), (landmarks,)),
        "landmarks": (3, landmarks),
        **dict.fromkeys(("solids", "bounds", "links"), (solids,)),
        "tracks": (bodies, frames),
        **dict.fromkeys(("shares", "balls"), (bodies,)),
        **dict.fromkeys(("parts", "parts_now"), (parts,)),
        **dict.fromkeys(("positions", "arc_length", "speeds", "yaw_rates", "travel", "attitudes"), (steps,)),
        "exponentials": (max(4096, 4 * landmarks),),
    }

    def grown(name: str) -> Any:
        old = getattr(fleet, name)
        new = np.zeros((len(old), *shapes[name], *old.shape[1 + len(shapes[name]) :]), dtype=old.dtype)
        new[tuple(slice(0, size) for size in old.shape)] = old
        return new

    return fleet._replace(**{name: grown(name) for name in shapes})
