"""`physics="bullet"` gives the episodes that the environments gave when PyBullet answered all rays (10 s)."""

import hashlib
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)


class Episode(NamedTuple):
    name: str
    arguments: dict[str, Any]
    seed: int
    frames: int
    ids: str
    uvd: list[float]
    position: list[float]
    reward: float

    def make(self, physics):
        return gym.make(f"StereoSlam/{self.name}", disable_env_checker=True, physics=physics, **self.arguments)


EPISODES = [
    Episode(
        "Drive-v0",
        {"policy": "route", "route": "right-turn", "moving_cars": 4, "pedestrians": 4, "time_weight": 0.05},
        1,
        80,
        "26641bf659ef6a8b",
        [4241551.380422708, 1106719.2601881824, 97055.59963265338],
        [22.706935697654924, 0.045287606332422355, 12.904119334894865],
        14.071888888888882,
    ),
    Episode(
        "Drive-v0",
        {"surroundings": "corridor", "noise": "heavy-tailed", "policy": "route", "time_weight": 0.05},
        3,
        81,
        "993abccd6b909816",
        [3811597.1543963696, 1228404.1088068173, 118934.22376545219],
        [0.24091776067738724, -0.04705046234194559, 39.43293275905811],
        5.139994444444439,
    ),
    Episode(
        "Gaze-v0",
        {},
        5,
        121,
        "116508831bd800af",
        [280112.2048330206, 187976.76199919867, 8557.900740956376],
        [0.021326964357703548, 0.12487360084326102, 58.642039879649666],
        0.0010918687108515818,
    ),
    Episode(
        "Gaze-v0",
        {"surroundings": "street", "noise": "quantised", "moving_cars": 3},
        6,
        101,
        "4212c762412af768",
        [664179.0, 493203.0, 39287.0],
        [0.03722764470172951, 0.13136760752042487, 48.71210466687835],
        1.3701990248920064,
    ),
    Episode(
        "DriveGaze-v0",
        {"route": "town", "lane": 1e9, "time_weight": 0.05, "slowest": 0.0, "jerk_weight": 0.0},
        7,
        81,
        "f4a377cda9bdb687",
        [237435.47918350017, 114549.74220275848, 6351.951571094517],
        [3.170678841521988, 2.476317761956892e-19, 39.54645270687868],
        3.5135600837050616,
    ),
]
"""Recorded before there was another physics: digest of all ids, sums of u, v and d, last position, return."""


@pytest.mark.parametrize("episode", EPISODES, ids=lambda episode: f"{episode.name} {episode.arguments}")
def test_an_episode_is_what_it_was(episode):
    ids, uvd, total = [], [], 0.0
    with episode.make("bullet") as env:
        rng = np.random.default_rng(episode.seed)
        _, info = env.reset(seed=episode.seed)
        for k in range(episode.frames):
            if k:
                action = rng.uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)
                _, reward, _, _, info = env.step(action)
                total += reward
            seen = env.unwrapped.frame.observation
            ids.append(seen.ids)
            uvd.append(seen.uvd)
    digest = hashlib.sha256(np.concatenate(ids).astype("<i8").tobytes()).hexdigest()
    assert digest[:16] == episode.ids
    np.testing.assert_allclose(np.concatenate(uvd).sum(axis=0), episode.uvd, rtol=1e-12)
    np.testing.assert_allclose(info["truth_position"], episode.position, atol=1e-11)
    assert total == pytest.approx(episode.reward, rel=1e-11)


def test_exact_physics_is_another_draw_only_from_a_grazing_ray_on():
    """The drive is the same; the landmarks of the first frame are, too."""
    episode = EPISODES[0]
    first = []
    for physics in ("exact", "bullet"):
        with episode.make(physics) as env:
            env.reset(seed=episode.seed)
            first.append(env.unwrapped.frame)
    np.testing.assert_array_equal(first[0].truth_velocity.linear, first[1].truth_velocity.linear)
    shared = np.intersect1d(first[0].observation.ids, first[1].observation.ids)
    assert len(shared) >= 0.95 * len(first[0].observation)
