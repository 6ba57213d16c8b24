"""The long benchmarks in short: they run, and what they show holds in the small already."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import gymnasium as gym
import numpy as np
import pytest

from stereo_slam_env.envs.recorder import RenderedDrive
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all

pytestmark = pytest.mark.slow

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", BENCHMARKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


soak = script("covariance_soak")


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py")))
def test_every_benchmark_finds_what_it_imports(name: str) -> None:
    assert callable(script(name).main)


def test_filters_of_all_forms_are_timed_beside_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """20 landmarks, 6 frames; the benchmarks have up to 200, and 60."""
    beside_rivals, alone = script("rival_speed"), script("filter_speed")
    monkeypatch.setattr(beside_rivals, "WARM_UP", 2)
    seconds, entering = beside_rivals.measure(20, 4)
    assert entering > 0.0
    assert {"shared anchors", "6-D", "filterpy EKF, 6-D state"} <= set(seconds)
    monkeypatch.setattr(alone, "FILTERS", {name: alone.FILTERS[name] for name in (alone.SHARED, "one clone")})
    assert all(time > 0.0 for time in (*seconds.values(), *alone.measure(20, alone.BURST).values()))


@pytest.mark.parametrize("case", soak.CASES, ids=str)
def test_the_covariance_stays_a_covariance(case: soak.Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """300 updates and five blind stretches; the benchmark has 100,000."""
    monkeypatch.setattr(soak, "LOOK_EVERY", 50)
    health, error, _ = soak.soak(case, 300)
    # Six numbers for each landmark repeat their anchor: singular by construction, on either side of zero.
    assert health.smallest_eigenvalue > (-1e-12 if case.landmark == "inverse-depth" else 1e-12)
    assert health.smallest_variance > 0
    assert health.asymmetry <= 1e-12
    assert health.failed == 0
    assert error < 0.2


def test_consensus_keeps_a_filter_consistent_under_heavy_tails_and_wrong_associations() -> None:
    """2 drives of 30 frames; the gate alone is overconfident several times over."""
    heavy_tails = script("heavy_tails")
    labels = ["gate", "consensus", "consensus + re-weighting"]
    by_seed = [heavy_tails.run_seed(seed, 30, heavy_tails.ASSUMED_SIGMA, labels) for seed in range(2)]
    runs = [run for of_seed in by_seed for run in of_seed]
    figures = dict(zip(labels, summarise_all(runs, figures_of(runs, divergence_percent=10.0)), strict=True))
    for label in labels[1:]:
        assert figures[label].diverged == 0
        assert figures[label].pose_anees / 6 < 1.5
    assert figures["gate"].pose_anees / 6 > 3.0


def test_a_bootstrap_interval_knows_a_ratio_of_one_and_a_half() -> None:
    against_batch = script("against_batch")
    errors = np.random.default_rng(0).standard_normal((60, 3))
    ratio, low, high = against_batch.interval(1.5 * errors, errors)
    assert [ratio, low, high] == pytest.approx([1.5, 1.5, 1.5])
    other = np.random.default_rng(1).standard_normal((60, 3))
    ratio, low, high = against_batch.interval(errors, other)
    assert low < 1.0 < high
    assert low < ratio < high


def test_a_filter_ends_where_smoothing_ends() -> None:
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    against_batch = script("against_batch")
    found = against_batch.run_seed(0, 60, False, ["shared-anchor"])
    assert found["batch"].chi2 == pytest.approx(1.0, abs=0.05)
    assert np.linalg.norm(found["batch"].end - found["shared-anchor"].end) < 0.05
    assert found["batch"].ate < found["shared-anchor"].ate


def test_sky_and_haze_cost_little_beside_the_bare_calls() -> None:
    """The median of 15 ratios; the benchmark has every size."""
    speed = script("rendering_speed")
    times = speed.measure("320x240", 50, 5, names=[speed.BARE, speed.TINY])
    assert np.median(np.divide(times[speed.TINY], times[speed.BARE])) < 1.25


def test_kills_lose_nothing() -> None:
    """Two kills; the benchmark has as many as one likes."""
    tally = script("kill_anywhere").disturb(kills=2, jobs=1)
    assert tally.kills == 2


def test_who_knows_how_the_car_accelerates_has_a_lower_bound_and_xyz_gives_most_away() -> None:
    """One drive of 20 frames."""
    efficiency = script("efficiency")
    found = efficiency.run_seed(0, 20, "pixels", batch=False)
    bound, as_driven = found[efficiency.BOUND], found[efficiency.AS_DRIVEN]
    assert as_driven.position < bound.position
    assert as_driven.rotation < bound.rotation
    assert max(efficiency.FILTERS, key=lambda label: found[label].anees) == "euclidean"


def test_memory_of_an_environment_does_not_grow() -> None:
    """9 resets and 180 steps; the benchmark has 500 and 50,000."""
    memory = script("environment_memory")
    env = gym.make("StereoSlam/Drive-v0", **{**memory.CHEAP, "route": "right-turn"})
    resets, held = memory.measure(env, seeds=9, steps=20)
    env.close()
    assert resets[-1] == 9
    gained, _ = memory.growth(held[2:])
    assert gained < memory.WANTED


def test_bare_calls_and_a_filter_in_the_loop_are_a_part_of_a_step() -> None:
    """Two rounds of 5 steps; the benchmark has seven of 200."""
    speed = script("environment_speed")
    options = {"route": "right-turn", "rig": "qvga", "policy": "route", "physics": "bullet"}
    alone, with_filter = (speed.made("StereoSlam/Drive-v0", options, w) for w in ((), (speed.FilterInTheLoop,)))
    times = [speed.measure_steps(env, steps=5, rounds=2) for env in (alone, with_filter)]
    for env in (alone, with_filter):
        env.close()
    assert all(0.0 < found["bare"] < found["step"] for found in times)
    assert times[1]["step"] > times[0]["step"]
    assert speed.pybullet.rayTestBatch.__name__ == "rayTestBatch"  # as it was before


def test_a_filter_and_an_environment_stay_sound_while_they_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """500 updates and 100 steps; the benchmark has 1,000,000 and 100,000."""
    long_run = script("soak")
    monkeypatch.setattr(long_run, "LOOKS", 10)
    of_filter, _ = long_run.soak_filter("shared-anchor", 500)
    assert of_filter.worst["quaternion_off_unit"] < 1e-12
    assert of_filter.worst["asymmetry"] < 1e-12
    assert of_filter.worst["lack_of_definiteness"] < 0.0
    of_env = long_run.soak_environment("StereoSlam/Drive-v0", {**long_run.CHEAP, "max_landmarks": 20}, 100)
    assert of_env.worst["quaternion_off_unit"] < 1e-12
    assert of_env.worst["outside_of_its_space"] == of_env.worst["not_finite"] == 0.0
    assert of_env.done == list(range(10, 101, 10))


def test_a_leak_and_a_slow_down_would_be_seen() -> None:
    """2 MB per 100,000 and a tenth slower at the end; NaN is the worst of all."""
    long_run = script("soak")
    done = list(range(1000, 101_000, 1000))
    log = long_run.Log(done, [80.0 + 2e-5 * k for k in done], [1.0] * 90 + [1.1] * 10)
    assert log.slope == pytest.approx(2.0)
    assert log.slower == pytest.approx(1.1)
    for value in (1.0, float("nan"), 2.0):
        log.note(anything=value)
    assert np.isnan(log.worst["anything"])


def test_the_same_corners_are_compared_with_every_blur() -> None:
    """16 frames of a small image; the benchmark has 8 drives of 60 frames of a large one."""
    image_blur = script("image_blur")
    drive = RenderedDrive({"route": "straight", "rig": "qvga"}, seed=0, frames=16)
    blocks = list(image_blur.displacements(drive.camera, drive.pairs(), drive.front_end, [0.0, 1.0]))
    assert len(blocks) == 2
    for without, matched in blocks:
        assert without.shape == matched.shape
        assert len(without) > 0
        assert 0.0 < np.abs(matched - without).max() < 2 * image_blur.OUTLIER
    mean, error, _ = image_blur.summary([matched for _, matched in blocks])
    everything = np.concatenate([matched for _, matched in blocks])
    np.testing.assert_allclose(mean, 1e3 * everything.mean(axis=0) / image_blur.LATER)
    assert np.all(error > 0.0)
