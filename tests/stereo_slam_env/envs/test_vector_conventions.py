"""Native vector environments: bits and conventions of Gymnasium's `SyncVectorEnv` (9 s)."""

from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import performance
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import vector as wrappers

import stereo_slam_env  # noqa: F401 (registers the ids)

IDS = ["StereoSlam/Drive-v0", "StereoSlam/DriveGaze-v0", "StereoSlam/Gaze-v0"]
QUICK = {"route": "right-turn", "rig": "qvga", "max_landmarks": 20}
EPISODE = 3
NEXT_STEP, SAME_STEP, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED

every_id = pytest.mark.parametrize("name", IDS)
every_mode = pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)


def vector_of(name, num_envs=2, **options):
    return gym.make_vec(name, num_envs=num_envs, **{**QUICK, "max_episode_steps": EPISODE, **options})


def synchronous(name, mode, num_envs=2):
    kwargs = {"autoreset_mode": mode}
    return gym.make_vec(name, num_envs, "sync", vector_kwargs=kwargs, max_episode_steps=EPISODE, **QUICK)


@cache
def actions_of(name):
    env = vector_of(name, 3)
    return np.random.default_rng(0).uniform(-0.3, 0.3, (12, *env.action_space.shape)).astype(np.float32)


def run(vector, name, steps, mode=NEXT_STEP, seed=1, apart=False):
    """Everything that a reset and some steps give; with DISABLED what is over is reset.

    The last environment starts again after the first step, so that episodes end in different steps.
    """
    calls = [vector.reset(seed=seed)]
    for k, actions in enumerate(actions_of(name)[:steps, : vector.num_envs]):
        calls.append(vector.step(actions))
        over = calls[-1][2] | calls[-1][3]
        if k == 0 and apart:
            mask = np.arange(vector.num_envs) == vector.num_envs - 1
            calls.append(vector.reset(seed=13, options={"reset_mask": mask}))
        elif mode is DISABLED and over.any():
            calls.append(vector.reset(options={"reset_mask": over}))
    vector.close()
    return calls


def assert_equal(first, second):
    """Bit by bit, whatever is in what."""
    assert type(first) is type(second)
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        first, second = list(first.values()), [second[key] for key in first]
    if isinstance(first, (list, tuple)):
        for one, other in zip(first, second, strict=True):
            assert_equal(one, other)
    elif isinstance(first, np.ndarray) and first.dtype == object:
        assert_equal(first.tolist(), second.tolist())
    else:
        np.testing.assert_array_equal(first, second)


@every_id
@pytest.mark.parametrize("options", [{}, {"noise": "heavy-tailed", "observe_ids": False}], ids=["usual", "other"])
def test_observations_are_in_their_space(name, options):
    vector = vector_of(name, 3, **options)
    single = gym.make(name, **{**QUICK, **options})
    assert vector.single_observation_space == single.observation_space
    assert vector.single_action_space == single.action_space
    assert vector.observation_space == batch_space(single.observation_space, 3)
    assert vector.action_space == batch_space(single.action_space, 3)
    for observation, *_ in run(vector, name, 5):
        assert observation in vector.observation_space
        for key, space in vector.observation_space.items():
            assert observation[key].dtype == space.dtype
            assert observation[key].flags.writeable


def of_the_ended(info):
    """Without what `final_info` has of those that go on: Gymnasium has zeros there."""
    if "final_info" not in info:
        return info
    return {**info, "final_info": {key: rows[info["_final_info"]] for key, rows in info["final_info"].items()}}


@every_id
@every_mode
def test_calls_return_what_the_synchronous_vector_returns(name, mode):
    native = run(vector_of(name, autoreset_mode=mode), name, 2 * EPISODE, mode, apart=True)
    for ours, theirs in zip(native, run(synchronous(name, mode), name, 2 * EPISODE, mode, apart=True), strict=True):
        assert_equal(ours[:-1], theirs[:-1])
        if len(ours) == 5 or ours is native[0]:  # else Gymnasium gives the info of those that were reset
            assert_equal(of_the_ended(ours[-1]), of_the_ended(theirs[-1]))
    assert any(call[3].any() for call in native if len(call) == 5)


@every_id
def test_only_those_of_the_mask_are_reset(name):
    vector = vector_of(name, 3, autoreset_mode=DISABLED)
    vector.reset(seed=1)
    before = vector.step(actions_of(name)[0])
    after = vector.reset(options={"reset_mask": np.array([False, True, False])})
    assert after[1]["time"].tolist() == [0.1, 0.0, 0.1]
    assert vector.step(actions_of(name)[1])[4]["time"].tolist() == [0.2, 0.1, 0.2]
    for key, value in before[0].items():
        np.testing.assert_array_equal(value[[0, 2]], after[0][key][[0, 2]])
    vector.step(actions_of(name)[2])
    with pytest.raises(RuntimeError, match=r"environments \[0, 2\] are over: reset them"):
        vector.step(actions_of(name)[3])


@every_id
def test_some_are_stepped_while_the_others_wait(name):
    vector, waiting = vector_of(name, 3), np.array([True, False, True])
    vector.reset(seed=1)
    for actions in actions_of(name)[:EPISODE]:
        some = vector.advance(actions, waiting)
    *_, all_of_them = run(vector_of(name, 3), name, EPISODE)
    for key, value in some[0].items():
        np.testing.assert_array_equal(value[[0, 2]], all_of_them[0][key][[0, 2]])
    assert some[1][1] == 0.0
    assert some[3].tolist() == [True, False, True]
    beyond = vector.advance(actions_of(name)[EPISODE], np.ones(3, dtype=bool))
    assert beyond[4]["time"].tolist() == pytest.approx([0.1 * EPISODE, 0.1, 0.1 * EPISODE])
    with pytest.raises(ValueError, match=r"going must be \(3,\) bool, got \[1, 0\]"):
        vector.advance(actions, [1, 0])
    vector.close()


def test_seeds_are_numbers_in_a_row_or_each_given():
    name = IDS[0]
    expected = run(vector_of(name), name, EPISODE + 3, seed=4)
    for seeds in ([4, 5], np.array([4, 5])):
        assert_equal(expected, run(vector_of(name), name, EPISODE + 3, seed=seeds))
    assert not np.array_equal(run(vector_of(name), name, 0, seed=6)[0][0]["uvd"], expected[0][0]["uvd"])


def test_threads_do_not_change_results():
    name = "StereoSlam/DriveGaze-v0"
    for threads, steps in ((2, 8), (8, 2)):
        assert_equal(run(vector_of(name, 3), name, steps), run(vector_of(name, 3, threads=threads), name, steps))


def test_a_pool_has_so_many_scenes_and_each_makes_place_after_ten_episodes():
    vector, seen = vector_of("StereoSlam/Gaze-v0", 8, scenes=2), []
    vector.reset(seed=0)
    for _ in range(12):
        scenes = [scene.landmarks.tobytes() for scene in vector.unwrapped.core.simulator.scenes]
        assert len(set(scenes)) <= 4  # two, and those that have just made place
        seen += scenes
        vector.reset()
    counts = sorted(seen.count(scene) for scene in set(seen))
    assert len(counts) == pytest.approx(96 / 10, abs=2)
    assert counts[-1] == 10
    name = "StereoSlam/Gaze-v0"
    assert_equal(run(vector_of(name, 3, scenes=2), name, 8), run(vector_of(name, 3, scenes=2), name, 8))


def test_what_was_returned_is_the_caller_s():
    name = "StereoSlam/DriveGaze-v0"
    expected = run(vector_of(name, 3), name, 8)
    vector = vector_of(name, 3)
    calls = [vector.reset(seed=1)]
    for actions in actions_of(name)[:8]:
        for part in (*calls[-1][0].values(), *calls[-1][-1].values(), *calls[-1][1:-1]):
            if part.flags.writeable:
                part[...] = 1
        calls.append(vector.step(actions))
    assert_equal(calls[-1], expected[-1])


@pytest.mark.parametrize("limit", [-1, None])
def test_the_end_of_the_route_is_no_truncation(limit):
    vector = vector_of("StereoSlam/Gaze-v0", 2, max_episode_steps=limit)
    vector.reset(seed=0)
    for _ in range(1000):
        *_, terminated, truncated, info = vector.step(np.zeros((2, 2)))
        assert not truncated.any()
        if terminated.any():
            break
    assert terminated.all()
    assert info["is_success"].all()


def test_a_limit_in_the_last_step_is_both():
    """As `TimeLimit` has it; the single environment at the end of its route."""
    options = {**QUICK, "perturbation": 0.0}
    single = gym.make("StereoSlam/Gaze-v0", max_episode_steps=-1, **options)
    single.reset(seed=0)
    length = next(k for k in range(1, 1000) if single.step(np.zeros(2, dtype=np.float32))[2])
    vector = vector_of("StereoSlam/Gaze-v0", 1, **options, max_episode_steps=length)
    vector.reset(seed=0)
    *_, terminated, truncated, _ = [vector.step(np.zeros((1, 2))) for _ in range(length)][-1]
    assert terminated[0]
    assert truncated[0]


def test_the_registered_limit_holds():
    for name in IDS:
        assert gym.make_vec(name, num_envs=1).unwrapped.max_episode_steps == gym.spec(name).max_episode_steps


@pytest.fixture(scope="module")
def vector():
    vector = vector_of("StereoSlam/Gaze-v0")
    vector.reset(seed=0)
    return vector


class TestWrongInput:
    """One line says what is wrong."""

    @pytest.mark.parametrize(
        ("actions", "message"),
        [
            (np.zeros((3, 2)), r"actions must have shape \(2, 2\), got \(3, 2\)"),
            (np.zeros(2), r"actions must have shape \(2, 2\), got \(2,\)"),
            (np.full((2, 2), np.nan), "actions must be finite"),
            ([[np.inf, 0], [0, 0]], "actions must be finite"),
            ("left", "actions must be numeric"),
            (None, "actions must have shape"),
            ([[1, 2], [3]], "actions must be numeric"),
        ],
    )
    def test_actions(self, vector, actions, message):
        with pytest.raises(ValueError, match=f"^{message}[^\n]*$"):
            vector.step(actions)

    @pytest.mark.parametrize(
        "mask", [None, True, "all", [1, 0], np.array([1.0, 0.0]), np.zeros(2, bool), np.ones(3, bool)], ids=str
    )
    def test_masks(self, vector, mask):
        with pytest.raises(ValueError, match=r"^reset_mask must be \(2,\) bool with at least one True, got [^\n]*$"):
            vector.reset(options={"reset_mask": mask})

    @pytest.mark.parametrize("seed", [1.5, "one", [1], [1, 2, 3], [], [1.5, 2]], ids=str)
    def test_seeds(self, vector, seed):
        with pytest.raises(ValueError, match=r"^seed must be a whole number or 2 of them, got [^\n]*$"):
            vector.reset(seed=seed)

    def test_order(self, vector):
        with pytest.raises(ValueError, match="reset takes no options but scene, and for vectors reset_mask, got 'low'"):
            vector.reset(options={"low": 1})
        fresh = vector_of("StereoSlam/Gaze-v0")
        with pytest.raises(RuntimeError, match="reset the environments before the first step"):
            fresh.step(np.zeros((2, 2)))
        with pytest.raises(ValueError, match="reset_mask must be all True in the first reset"):
            fresh.reset(options={"reset_mask": np.array([True, False])})

    @pytest.mark.parametrize(
        ("options", "error", "message"),
        [
            ({"rout": "loop"}, TypeError, "unexpected keyword argument 'rout', did you mean 'route'"),
            ({"sensor": "images"}, ValueError, "sensor must be 'landmarks'"),
            ({"render_images": True}, ValueError, "render_images must be False"),
            ({"render_mode": "human"}, ValueError, "render_mode must be None or 'rgb_array' in a native"),
            ({"sigma": -1.0}, ValueError, "sigma must be"),
            ({"num_envs": 0}, ValueError, "num_envs must be a whole number >= 1, got 0"),
            ({"threads": 0}, ValueError, "threads must be a whole number >= 1, got 0"),
            ({"scenes": 0}, ValueError, "scenes must be a whole number >= 1, got 0"),
            ({"max_episode_steps": 0}, ValueError, "max_episode_steps must be a whole number >= 1, got 0"),
            ({"autoreset_mode": "never"}, ValueError, "'never' is not a valid AutoresetMode"),
        ],
        ids=str,
    )
    def test_arguments(self, options, error, message):
        with pytest.raises(error, match=message):
            vector_of("StereoSlam/Gaze-v0", **options)


class TestWrappers:
    """Those of Gymnasium that are made for vectors."""

    @every_mode
    def test_record_episode_statistics(self, mode):
        vector = wrappers.RecordEpisodeStatistics(vector_of("StereoSlam/Drive-v0", autoreset_mode=mode))
        *_, last = run(vector, "StereoSlam/Drive-v0", EPISODE)[: EPISODE + 1]
        assert last[4]["episode"]["l"].tolist() == [EPISODE] * 2

    @every_id
    def test_flatten_observation(self, name):
        vector = wrappers.FlattenObservation(vector_of(name))
        for observation, *_ in run(vector, name, EPISODE + 1):
            assert observation in vector.observation_space
            assert observation.shape == (2, gym.spaces.flatdim(vector.unwrapped.single_observation_space))

    def test_rescale_observation_after_flattening(self):
        """The mean of the limits must be a number, so without `ids`, whose are far apart."""
        low, high = np.float32(-1.0), np.float32(1.0)
        flat = wrappers.FlattenObservation(vector_of("StereoSlam/Gaze-v0", observe_ids=False))
        vector = wrappers.RescaleObservation(flat, low, high)
        for observation, *_ in run(vector, "StereoSlam/Gaze-v0", 2):
            assert np.abs(observation).max() <= 1.0 + 1e-5

    def test_numpy_to_torch(self):
        torch = pytest.importorskip("torch")
        pytest.importorskip("array_api_compat", reason="the wrapper needs it")
        vector = wrappers.NumpyToTorch(vector_of("StereoSlam/Gaze-v0"))
        assert isinstance(vector.reset(seed=0)[0]["uvd"], torch.Tensor)
        assert isinstance(vector.step(torch.zeros(2, 2))[1], torch.Tensor)

    @every_mode
    @pytest.mark.skipif(not hasattr(performance, "benchmark_vector_step"), reason="needs a newer Gymnasium")
    def test_the_common_benchmark(self, mode):
        vector = vector_of("StereoSlam/Gaze-v0", autoreset_mode=mode)
        assert performance.benchmark_vector_step(vector, 0.1, seed=0) > 0


def test_names_and_closing():
    vector = vector_of("StereoSlam/Gaze-v0", 3, threads=2)
    assert str(vector) == "RowsVectorEnv(StereoSlam/Gaze-v0, num_envs=3)"
    vector.reset(seed=0)
    vector.close()
    vector.close()
    assert vector.closed
