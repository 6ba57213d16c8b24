"""Vehicles of the simulator in scenes of a few things, for tests."""

import numpy as np

from stereo_slam_env.recording.recording import LandmarkTruth
from stereo_slam_env.sensing.corruptions import NOISE_MODELS
from stereo_slam_env.sensing.padding import TrackingPolicy
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT, RIGS
from stereo_slam_env.simulator import Simulator
from stereo_slam_env.simulator.scene_arrays import scene_arrays
from stereo_slam_env.simulator.state import make_rules
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.routes import straight
from stereo_slam_env.world.scene import Ground, Material, Scene

CAMERA = RIGS["reference"]
GREY = Material((0.5, 0.5, 0.5))
ONE = np.ones(1, dtype=bool)
STILL = np.zeros((1, 4))


def scene_of(*solids, points_w=(), moving=()):
    points = WorldFrame(CAMERA_HEIGHT).to_scene(np.reshape(points_w, (-1, 3)))
    return Scene(Ground((-50.3, -50.3), (50.3, 50.3), GREY), solids, (), points, tuple(moving))


def vehicle(scene=None, route=None, seed=1, noise="uvd", sigma=1e-9, policy=None, **rules):
    """One vehicle after the first frame; without noise, odometry errors and sway unless they are asked for."""
    tracking = TrackingPolicy(**(policy or {}))
    rules = {"perturbation": 0.0, "odometry_sigmas": (0.0, 0.0), **rules}
    made = make_rules(CAMERA, tracking, noise=noise, sigma=sigma, **rules)
    simulator = Simulator(made, 1, NOISE_MODELS[noise](sigma))
    simulator.put(0, scene_arrays(scene or scene_of(), route or straight()), np.random.default_rng(seed).spawn(4))
    simulator.begin(ONE)
    return simulator


def drive(simulator, commands):
    """The frames of a drive, the first one before any command."""
    frames = [simulator.frame(0)]
    for command in commands:
        simulator.step(np.array([command], dtype=float), ONE)
        frames.append(simulator.frame(0))
    return frames


def truth_of(simulator):
    points = simulator.scenes[0].landmarks
    return LandmarkTruth(np.arange(len(points)), points)
