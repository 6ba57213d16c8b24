"""`physics="bullet"`: PyBullet answers what hides landmarks and what the car touches, one row after the other."""

from __future__ import annotations

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.poses import Pose
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.simulator.motion import CHOICE
from stereo_slam_env.simulator.state import Fleet, Rules, Sensed
from stereo_slam_env.world.frames import R_SW, WorldFrame
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Scene
from stereo_slam_env.world.vehicle import Car


class BulletAnswers:
    """A PyBullet world for each row; each is started by its first scene."""

    def __init__(self, count: int) -> None:
        self.worlds = [PhysicsWorld() for _ in range(count)]
        self._car, self._frame = Car(), WorldFrame(CAMERA_HEIGHT)

    def build(self, b: int, scene: Scene) -> None:
        """Replace the world of a row."""
        self.worlds[b].build(scene, self._car.size)

    def answer(self, rules: Rules, fleet: Fleet, sensed: Sensed, b: int) -> None:
        """Put the answers for the frame that a row has moved to into `fleet.seen` and `fleet.touching`."""
        world, pose, body = self.worlds[b], _pose(fleet.pose[b]), _pose(fleet.body[b])
        world.set_time(fleet.step[b] * rules.dt)
        standing, moving = fleet.sizes[b, [0, 4]].tolist()
        on_bodies = standing + np.flatnonzero(fleet.inside[b, standing : standing + moving])
        fleet.seen[b, on_bodies] = self._seen(rules, fleet, b, pose, on_bodies)
        tracked = sensed.ids[b, : sensed.number[b] - sensed.moving[b]]
        tracked_inside = tracked[fleet.inside[b, tracked] == 1]
        fleet.seen[b, tracked_inside] = self._seen(rules, fleet, b, pose, tracked_inside)
        kept_count = int(np.count_nonzero(fleet.seen[b, tracked_inside]))
        if kept_count < rules.refill_below:
            self._draw(rules, fleet, b, pose, tracked, rules.most - kept_count)
        R_wc = body.R_wc
        middle = self._frame.to_scene(body.position + R_wc @ np.array(self._car.body_c))
        fleet.touching[b] = world.ego_collides(middle, self._frame.rotation_to_scene(R_wc) @ R_SW.T)

    def _draw(self, rules: Rules, fleet: Fleet, b: int, pose: Pose, tracked: IntArray, wanted: int) -> None:
        """Rays for landmarks in the order in which `sensing.draw` will take them, for as many as it can need."""
        fresh = (fleet.inside[b, : fleet.sizes[b, 0]] == 1) & ~fleet.lost[b, : fleet.sizes[b, 0]]
        fresh[tracked] = False
        candidates, used = np.flatnonzero(fresh), fleet.used[b, CHOICE]
        depths = pose.R_wc[:, 2] @ (fleet.landmarks[b][:, candidates] - pose.position[:, None])
        order = candidates[np.argsort(fleet.exponentials[b, used : used + len(candidates)] * depths)]
        fleet.seen[b, order] = False
        while wanted > 0 and len(order):
            tested, order = order[: 2 * wanted], order[2 * wanted :]
            fleet.seen[b, tested] = self._seen(rules, fleet, b, pose, tested)
            wanted -= int(np.count_nonzero(fleet.seen[b, tested]))

    def close(self) -> None:
        """Stop the engines."""
        for world in self.worlds:
            world.close()

    def _seen(self, rules: Rules, fleet: Fleet, b: int, pose: Pose, landmarks: IntArray) -> BoolArray:
        """Mask of the landmarks of a row that both cameras see from `pose`."""
        right = pose.position + rules.camera[5] * pose.R_wc[:, 0]
        cameras = self._frame.to_scene(np.array([pose.position, right]))
        return self.worlds[b].visible(cameras, self._frame.to_scene(fleet.landmarks[b, :, landmarks]))


def _pose(numbers: FloatArray) -> Pose:
    return Pose(numbers[:3].copy(), numbers[3:].copy())
