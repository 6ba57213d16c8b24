"""A scene and a route of your own, by names that the environment takes like any other.

A scene is a function from a route and a random generator to a plain description; it knows no physics engine and no
renderer, and works along every route. A route is a speed and a yaw rate for each step of 0.1 s.

Run it: python examples/custom_scene.py --picture avenue.png
"""

import argparse

import cv2
import gymnasium as gym
import numpy as np

import stereo_slam_env as sse
from stereo_slam_env.world import (
    ASPHALT_HEIGHT,
    Layout,
    Material,
    RoadNetwork,
    Route,
    Scene,
    Sphere,
    Strip,
    facing_points,
    paved,
    road_along,
)

GRASS = Material((1.0, 1.0, 1.0), "grass", (6.0, 6.0))
LANE = Strip(4.0, ASPHALT_HEIGHT, Material((1.0, 1.0, 1.0), "asphalt", (7.0, 7.0)))
STONE = Material((0.95, 0.9, 0.8), "brick", (4.0, 4.0))


def build_avenue(route, rng):
    """Columns with a ball on top, every 8 m on both sides of the road."""
    road = road_along(route)
    network = RoadNetwork([road])
    layout = Layout(network)  # keeps things off the road and clear of each other
    for station in np.arange(0.0, road.length, 8.0):
        for side in (-1, 1):
            place, yaw = road.place(station, side * rng.uniform(9.0, 13.0))
            layout.claim(place, yaw, (1.4, 1.4), room=1.0, clearance=6.0, make=column)
    points = facing_points(layout.primitives, 25 * len(layout.primitives), 12.0, network, rng)
    ground, lane = network.ground(150.0, GRASS), paved([road], [LANE])
    return Scene(ground, tuple(layout.primitives), lane, points)


def column(at):
    """What stands at a place."""
    return [at.rod((0.0, 0.0, 0.0), (0.0, 0.0, 6.0), 0.6, STONE), Sphere(at.point(0.0, 0.0, 6.7), 0.8, STONE)]


sse.register_scene("avenue", build_avenue)
sse.register_route("slalom", Route("slalom", np.full(60, 5.0), 0.2 * np.sin(np.arange(60) / 8.0)))

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--picture", help="PNG file to write of the view half-way")
    given = parser.parse_args()
    scene = {"surroundings": "avenue", "route": "slalom", "policy": "route", "rig": "vga"}
    env = gym.make("StereoSlam/Drive-v0", **scene, render_mode="rgb_array")
    env.reset(seed=0)
    seen = [env.step(env.action_space.sample())[0]["mask"].sum() for _ in range(30)]
    if given.picture:
        cv2.imwrite(given.picture, env.render()[..., ::-1])
    print(f"{min(seen)} to {max(seen)} landmarks in a frame of the avenue")
    env.close()
