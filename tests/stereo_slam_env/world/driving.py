"""Drive the ego car through a scene and count what it hits."""

import numpy as np

from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.world.frames import R_SW, WorldFrame
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.vehicle import Car

from ..simulator.vehicles import drive, vehicle

FRAME = WorldFrame(1.65)


def nominal_poses(route):
    return [
        Pose(p, rotations.exp_quaternion([0.0, yaw, 0.0]))
        for p, yaw in zip(route.positions, route.headings, strict=True)
    ]


def swaying_poses(route, seed):
    simulator = vehicle(route=route, seed=seed, perturbation=1.0)
    return [frame.truth for frame in drive(simulator, [[0, 0]] * (route.frames - 1))]


def collisions(scene, poses):
    """Frames in which the car touches something; every other frame is tried."""
    world, car = PhysicsWorld(), Car()
    try:
        world.build(scene, car.size)
        hit = []
        for frame in range(0, len(poses), 2):
            pose = poses[frame]
            world.set_time(frame * FRAME_PERIOD)
            R_wc = rotations.matrix(pose.orientation)
            middle = FRAME.to_scene(pose.position + R_wc @ np.array(car.body_c))
            if world.ego_collides(middle, FRAME.rotation_to_scene(R_wc) @ R_SW.T):
                hit.append(frame)
        return hit
    finally:
        world.close()
