"""`physics="bullet"` gives the episodes that the environments gave when PyBullet answered all rays (10 s)."""

import hashlib

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)

EPISODES = [
    (
        *("Drive-v0", {"policy": "route", "route": "right-turn", "moving_cars": 4, "pedestrians": 4}, 1, 80),
        *("26641bf659ef6a8b", [4241551.380422708, 1106719.2601881824, 97055.59963265338]),
        *([22.706935697654924, 0.045287606332422355, 12.904119334894865], 14.071888888888882),
    ),
    (
        *("Drive-v0", {"surroundings": "corridor", "noise": "heavy-tailed", "policy": "route"}, 3, 81),
        *("993abccd6b909816", [3811597.1543963696, 1228404.1088068173, 118934.22376545219]),
        *([0.24091776067738724, -0.04705046234194559, 39.43293275905811], 5.139994444444439),
    ),
    (
        *("Gaze-v0", {}, 5, 121),
        *("116508831bd800af", [280112.2048330206, 187976.76199919867, 8557.900740956376]),
        *([0.021326964357703548, 0.12487360084326102, 58.642039879649666], 0.0010918687108515818),
    ),
    (
        *("Gaze-v0", {"surroundings": "street", "noise": "quantised", "moving_cars": 3}, 6, 101),
        *("4212c762412af768", [664179.0, 493203.0, 39287.0]),
        *([0.03722764470172951, 0.13136760752042487, 48.71210466687835], 1.3701990248920064),
    ),
    (
        *("DriveGaze-v0", {"route": "town", "lane": 1e9, "slowest": 0.0, "jerk_weight": 0.0}, 7, 81),
        *("f4a377cda9bdb687", [237435.47918350017, 114549.74220275848, 6351.951571094517]),
        *([3.170678841521988, 2.476317761956892e-19, 39.54645270687868], 3.5135600837050616),
    ),
]
"""Recorded before there was another physics: id, arguments, seed, frames; digest of all ids, sums of u, v and d, last
position, return."""


def made(name, arguments, physics):
    weight = {} if name == "Gaze-v0" else {"time_weight": 0.05}
    return gym.make(f"StereoSlam/{name}", disable_env_checker=True, physics=physics, **weight, **arguments)


@pytest.mark.parametrize(("name", "arguments", "seed", "frames", "digest", "sums", "position", "paid"), EPISODES)
def test_an_episode_is_what_it_was(name, arguments, seed, frames, digest, sums, position, paid):
    ids, uvd, total = [], [], 0.0
    with made(name, arguments, "bullet") as env:
        rng = np.random.default_rng(seed)
        _, info = env.reset(seed=seed)
        for k in range(frames):
            if k:
                action = rng.uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)
                _, reward, _, _, info = env.step(action)
                total += reward
            seen = env.unwrapped.frame.observation
            ids.append(seen.ids)
            uvd.append(seen.uvd)
    assert hashlib.sha256(np.concatenate(ids).astype("<i8").tobytes()).hexdigest()[:16] == digest
    np.testing.assert_allclose(np.concatenate(uvd).sum(axis=0), sums, rtol=1e-12)
    np.testing.assert_allclose(info["truth_position"], position, atol=1e-11)
    assert total == pytest.approx(paid, rel=1e-11)


def test_exact_physics_is_another_draw_only_from_a_grazing_ray_on():
    """The drive is the same; the landmarks of the first frame are, too."""
    name, arguments, seed, *_ = EPISODES[0]
    first = []
    for physics in ("exact", "bullet"):
        with made(name, arguments, physics) as env:
            env.reset(seed=seed)
            first.append(env.unwrapped.frame)
    np.testing.assert_array_equal(first[0].truth_velocity.linear, first[1].truth_velocity.linear)
    shared = np.intersect1d(first[0].observation.ids, first[1].observation.ids)
    assert len(shared) >= 0.95 * len(first[0].observation)
