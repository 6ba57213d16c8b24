"""A scene of your own: an avenue of columns and balls, driven like any other.

Surroundings are a function from a route to a plain description; it knows no physics engine and no renderer, and works
along every route. Give it a name, and the environment takes it as `surroundings=`.

Run it: python examples/custom_scene.py --picture avenue.png
"""

import argparse

import cv2
import gymnasium as gym
import numpy as np

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.world.layout import Layout, facing_points
from stereo_slam_env.world.road import ASPHALT_HEIGHT, RoadNetwork, Strip, paved, road_along
from stereo_slam_env.world.scene import Material, Scene, Sphere
from stereo_slam_env.world.surroundings import SURROUNDINGS, Surroundings

GRASS = Material((1.0, 1.0, 1.0), "grass", (6.0, 6.0))
LANE = Strip(4.0, ASPHALT_HEIGHT, Material((1.0, 1.0, 1.0), "asphalt", (7.0, 7.0)))
STONE = Material((0.95, 0.9, 0.8), "brick", (4.0, 4.0))
EVERY, ASIDE, HEIGHT, PER_COLUMN = 8.0, 9.0, 6.0, 25


def build_avenue(route, rng):
    """A column with a ball on top every few metres, on both sides of the road."""
    road = road_along(route)
    network = RoadNetwork([road])
    layout = Layout(network)  # keeps things off the road and clear of each other
    for at in np.arange(0, len(road.points), round(EVERY / 0.5)):
        across = np.array([-road.tangents[at, 1], road.tangents[at, 0]])
        for side in (-1, 1):
            place = road.points[at] + side * (ASIDE + rng.uniform(0, 4)) * across
            layout.claim(place, 0.0, (1.4, 1.4), room=1.0, clearance=6.0, make=column)
    points = facing_points(layout.primitives, PER_COLUMN * len(layout.primitives), 12.0, network.nearest, rng)
    return Scene(
        network.ground(150.0, GRASS), tuple(layout.primitives), paved([road], [LANE]), np.arange(len(points)), points
    )


def column(placed):
    """What stands at a place."""
    ball = Sphere(placed.point(0.0, 0.0, HEIGHT + 0.7), 0.8, STONE)
    return [placed.rod((0.0, 0.0, 0.0), (0.0, 0.0, HEIGHT), 0.6, STONE), ball]


SURROUNDINGS["avenue"] = Surroundings("columns on both sides", build_avenue, walkway=5.0)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--picture", help="PNG file to write of what is seen half-way")
    given = parser.parse_args()
    env = gym.make(
        "StereoSlam/Drive-v0",
        surroundings="avenue",
        route="right-turn",
        policy="route",
        rig="vga",
        render_mode="rgb_array",
    )
    env.reset(seed=0)
    seen = []
    for _ in range(40):
        observation, *_ = env.step(env.action_space.sample())
        seen.append(observation["mask"].sum())
    if given.picture:
        cv2.imwrite(given.picture, env.render()[..., ::-1])
    print(f"{min(seen)} to {max(seen)} landmarks in a frame of the avenue")
    env.close()
