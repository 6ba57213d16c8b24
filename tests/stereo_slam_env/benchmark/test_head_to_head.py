"""What is printed of one filter against another one (2 s)."""

from dataclasses import replace

import pytest

from filters import ConstantVelocity, StereoEKF
from stereo_slam_env.benchmark import Scenario, compare
from stereo_slam_env.benchmark.head_to_head import Bench
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource

from ...synthetic_runs import scored

TINY = Scenario("tiny", ReferenceSource("short_turn", {"landmarks": 15}), frames=6, gate=0.99)


class ItsOwnWay(StereoEKF):
    def __init__(self, camera, noise, **options):
        super().__init__(camera, noise, motion=ConstantVelocity(2.0, 0.4), **options)


class NotReady(StereoEKF):
    def __init__(self, camera, noise, **options):
        raise ValueError("no weights in ./weights: train them first")


@pytest.fixture(scope="module")
def bench():
    return Bench(seeds=2)


def test_a_filter_with_its_own_motion_runs_and_the_print_says_what_it_did_not_get(bench):
    result = bench(ItsOwnWay, scenario=TINY)
    result.assert_completed()
    assert (
        "note: ItsOwnWay does not get the common motion: it has its own, "
        "ConstantVelocity(sigma_acceleration=2.0, sigma_angular_acceleration=0.4)." in str(result)
    )


def test_the_reason_of_a_failure_is_printed(bench):
    reason = "start: ValueError: no weights in ./weights: train them first"
    result = bench(NotReady, scenario=TINY)
    assert f"NotReady failed: seed 0, {reason}" in str(result)
    before = bench(ItsOwnWay, scenario=TINY)
    was, now = ([replace(run, filter_name="mine") for run in side.runs] for side in (before, result))
    changed = compare(_Runs(was), _Runs(now))
    assert f"mine failed in 2 runs of after, first at {reason}." in str(changed)


class _Runs:
    def __init__(self, runs):
        self.runs, self.figures = runs, scored(runs)[1]
