"""PyBullet as the oracle of whole scenes, with what moves in them: rays and contacts frame by frame (15 s)."""

from functools import cache

import numpy as np
import pytest
from numba import njit

from stereo_slam_env.sensing.padding import TrackingPolicy
from stereo_slam_env.simulator import Simulator, visible
from stereo_slam_env.simulator.bullet import BulletAnswers
from stereo_slam_env.simulator.frame_kernel import _touches
from stereo_slam_env.simulator.rays import Obstacles, traversal, tree
from stereo_slam_env.simulator.scene_arrays import scene_arrays
from stereo_slam_env.simulator.sensing import is_visible, view_of
from stereo_slam_env.simulator.state import make_rules
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.routes import named_route
from stereo_slam_env.world.surroundings import build_scene

from .vehicles import CAMERA, ONE, STILL

SCENES = ["street", "groves", "field", "corridor"]
GRAZING = 0.002
"""m; what moves a surface by less than this is within the accuracy of PyBullet's hits."""
MOST_DIFFERENT = 1e-3


@njit
def all_visible(rules, fleet, waiting, ids):
    around = view_of(rules, fleet, 0)
    return np.array([is_visible(around, waiting, i) for i in ids])


@njit
def touches_now(rules, fleet, waiting):
    return _touches(rules, fleet, waiting, 0)


def solids_now(simulator, by=0.0):
    """Standing and moving solids of this frame as one scene, their surfaces moved outwards."""
    fleet, arrays = simulator.fleet, simulator.scenes[0]
    rows = np.concatenate([arrays.solids.solids, fleet.parts_now[0, : len(arrays.traffic.parts)]])
    kind = rows[:, 9]
    rows[kind == 0.0, 3:6] = np.maximum(rows[kind == 0.0, 3:6] + by, 1e-4)
    rows[kind == 1.0, 6:8] = np.maximum(rows[kind == 1.0, 6:8] + by, 1e-4)
    rows[kind == 2.0, 6] = np.maximum(rows[kind == 2.0, 6] + by, 1e-4)
    return Obstacles(rows, *tree(rows))


def grazes(simulator, ids):
    """Whether what is seen of landmarks changes when all solids grow or shrink a little, or the landmark moves."""
    frame, pose = WorldFrame(simulator.rules.camera_height), simulator.pose(0)
    cameras = frame.to_scene([pose.position, pose.position + CAMERA.baseline * pose.R_wc[:, 0]])
    points = frame.to_scene(simulator.fleet.landmarks[0][:, ids].T)
    larger, smaller = (visible(solids_now(simulator, by), cameras, points) for by in (GRAZING, -GRAZING))
    grazing, usual = larger != smaller, solids_now(simulator)
    for step in GRAZING * np.concatenate([np.eye(3), -np.eye(3)]):
        grazing |= visible(usual, cameras, points + step) != visible(usual, cameras, points)
    return grazing


@cache
def compared(surroundings, seed):
    """Landmarks asked for, those that differ and do not graze, those that differ; frames, and those that differ."""
    route = named_route("right-turn")
    scene = build_scene(surroundings, route, np.random.default_rng(seed), moving_cars=6, pedestrians=6)
    simulator = Simulator(make_rules(CAMERA, TrackingPolicy(max_landmarks=20)), 1, None)
    simulator.put(0, scene_arrays(scene, route), np.random.default_rng(seed).spawn(4))
    simulator.begin(ONE)
    oracle, answers = BulletAnswers(1), simulator.rules._replace(refill_below=0)
    oracle.build(0, scene)
    asked = wrong = touched_wrong = 0
    not_grazing, hidden, frames = 0, 0, 0
    room = traversal()
    for _ in range(route.frames - 2):
        simulator.step(STILL, ONE)
        mark = simulator.fleet.inside[0]
        pose = simulator.pose(0)
        p_c = pose.to_camera(simulator.scenes[0].landmarks)
        mark[:] = 0
        mark[: len(p_c)] = (p_c[:, 2] > 4.0) & CAMERA.in_view(CAMERA.project(p_c), 2.0) & (p_c[:, 2] < 150.0)
        ids = np.flatnonzero(mark)
        asks = simulator.sensed._replace(ids=ids[None], number=np.array([len(ids)]))
        oracle.answer(answers, simulator.fleet, asks, 0)
        found = all_visible(simulator.rules, simulator.fleet, room, ids)
        different = ids[found != simulator.fleet.seen[0, ids]]
        asked, wrong, hidden = asked + len(ids), wrong + len(different), hidden + int((~found).sum())
        not_grazing += int((~grazes(simulator, different)).sum()) if len(different) else 0
        touched_wrong += touches_now(simulator.rules, simulator.fleet, room) != simulator.fleet.touching[0]
        frames += 1
    oracle.close()
    assert hidden > 0
    return asked, not_grazing, wrong, frames, touched_wrong


@pytest.mark.parametrize("surroundings", SCENES)
def test_what_differs_grazes_something(surroundings):
    asked, not_grazing, _, frames, touched_wrong = compared(surroundings, 0)
    assert asked > 1000
    assert not_grazing == 0
    assert frames > 70
    assert touched_wrong == 0


def test_hardly_anything_differs():
    asked, _, wrong, *_ = map(sum, zip(*(compared(name, 0) for name in SCENES), strict=True))
    assert wrong <= MOST_DIFFERENT * asked
