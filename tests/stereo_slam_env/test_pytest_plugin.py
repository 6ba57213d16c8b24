"""Somebody's tests of his own filter, run by pytest in pytest (10 s)."""

import subprocess
import sys

import pytest

from filters import InverseDepthStereoEKF, StereoNoise
from stereo_slam_env.benchmark import Scenario
from stereo_slam_env.benchmark.head_to_head import Bench
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource

pytest_plugins = ["pytester"]

FILTERS = """
import time
from filters import InverseDepthStereoEKF, StereoEKF, StereoNoise

class Same(InverseDepthStereoEKF):
    "The paper's filter by another name."

class Boastful(InverseDepthStereoEKF):
    "It believes that its measurements are far better than they are."
    def __init__(self, camera, noise, **options):
        super().__init__(camera, StereoNoise(noise.R / 9.0), **options)

class Slow(InverseDepthStereoEKF):
    def update(self, observation):
        time.sleep(0.02)
        return super().update(observation)

class Broken(InverseDepthStereoEKF):
    def update(self, observation):
        raise RuntimeError("no more")
"""
SCENARIO = """
import pytest
from stereo_slam_env.benchmark import Scenario
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource

@pytest.fixture
def bench(slam_bench):
    tiny = Scenario("tiny", ReferenceSource("short_turn", {"landmarks": 15}), frames=6, gate=None)
    return lambda tested, **how: slam_bench(tested, **{"scenario": tiny, **how})
"""


class Boastful(InverseDepthStereoEKF):
    """It believes that its measurements are far better than they are."""

    def __init__(self, camera, noise, **options):
        super().__init__(camera, StereoNoise(noise.R / 9.0), **options)


ALONE = [
    f"-pno:{name}"
    for name in ("hypothesispytest", "benchmark", "xdist", "randomly", "timeout", "cacheprovider", "stereo_slam")
]
"""Without what is installed: not even the plug-in itself, which is loaded from here."""


def run_tests(pytester, body, *arguments):
    pytester.makepyfile(my_filters=FILTERS)
    pytester.makepyfile(f"from my_filters import *\n{SCENARIO}\n{body}")
    return pytester.runpytest_inprocess("-p", "stereo_slam_env.pytest_plugin", *ALONE, *arguments)


def test_a_good_filter_passes_in_a_few_lines(pytester):
    result = run_tests(
        pytester,
        """
def test_mine(bench):
    result = bench(Same, against="inverse-depth")
    result.assert_not_worse(percent=5)
    result.assert_consistent()
    result.assert_faster_than(ms=1000)
    assert result.summary.runs == 10

def test_by_name(bench):
    bench("shared-anchor", seeds=7).assert_completed()

def test_runs_are_kept(bench):
    assert bench(Same).runs[0] is bench(Same, against="dual-bearing").runs[0]
    assert bench(Same, options={"error": "so3"}).runs[0] is not bench(Same).runs[0]
""",
    )
    result.assert_outcomes(passed=3)


def test_failures_show_the_figures(pytester):
    result = run_tests(
        pytester,
        """
def test_boastful(bench):
    bench(Boastful).assert_consistent()

def test_slow(bench):
    bench(Slow, seeds=1).assert_faster_than(ms=10)

def test_broken(bench):
    bench(Broken, seeds=2).assert_not_worse(percent=5)

def test_worse(bench):
    bench("inverse-depth", options={"measurement": "left"}).assert_not_worse(percent=1)

def test_few(bench):
    bench(Boastful, seeds=3).assert_not_worse(percent=5)

def test_better(bench):
    bench(Same).assert_better()
""",
    )
    result.assert_outcomes(failed=6)
    result.stdout.fnmatch_lines_random(
        [
            "*Boastful is overconfident: its mean pose NEES / 6 is *, the band of 10 runs is 0.67 to 1.39.",
            "*Slow takes * ms a frame, not less than 10 ms.",
            "*Broken diverged or failed in 2 of 2 runs (seed 0, frame 0: RuntimeError: no more).",
            "*inverse-depth is * inverse-depth*: its position error is at +*",
            "*Boastful is not shown to be at most 5 % worse than inverse-depth*3 paired runs are too few, 6 are *",
            "*Same is not shown to be better than inverse-depth: its position error is at 0.0 % (the same in all *).",
            "*position error, m*",
            "*pose NEES / 6 *",
        ]
    )


def test_the_printed_comparison_says_better_worse_or_not_shown():
    bench = Bench(seeds=7)
    tiny = Scenario("tiny", ReferenceSource("short_turn", {"landmarks": 15}), frames=6, gate=None)

    def line(measure, *filters, **how):
        (found,) = (row for row in str(bench(*filters, scenario=tiny, **how)).splitlines() if row.startswith(measure))
        return found

    overconfident = {"tested": Boastful, "against": "inverse-depth"}
    assert "worse: farther from its ideal (+" in line("NIS / dof", **overconfident)
    assert "7 paired runs" in line("NIS / dof", **overconfident)
    assert "better: nearer to its ideal (−" in line("NIS / dof", "inverse-depth", against=Boastful)
    assert "the same in all 7 runs" in line("position error, m", "inverse-depth")
    few = line("position error, m", Boastful, seeds=1)
    assert few.endswith("not significant (1 paired run is too few, 6 are needed)")
    assert line("diverged runs", **overconfident).endswith("not significant")


def test_the_number_of_recordings_is_an_option_or_a_setting(pytester):
    body = "def test_it(slam_bench):\n    assert slam_bench.seeds == {}\n"
    run_tests(pytester, body.format(10)).assert_outcomes(passed=1)
    run_tests(pytester, body.format(3), "--slam-seeds", "3").assert_outcomes(passed=1)
    run_tests(pytester, body.format(4), "-o", "slam_seeds=4").assert_outcomes(passed=1)
    refused = run_tests(pytester, body.format(0), "-o", "slam_seeds=many")
    refused.stdout.fnmatch_lines(["*slam_seeds must be a whole number >= 1, got 'many'*"])


def test_nothing_of_the_benchmark_is_imported_before_a_test_asks_for_it():
    code = (
        "import sys; import stereo_slam_env.pytest_plugin;"
        "late = ('scipy', 'cv2', 'pybullet', 'filters', 'stereo_slam_env.benchmark', 'stereo_slam_env.envs');"
        "print([name for name in sys.modules if name.startswith(late)])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_bench_refuses_what_cannot_be_run():
    with pytest.raises(ValueError, match="seeds must be >= 1, got 0"):
        Bench(0)
    with pytest.raises(ValueError, match="seeds must be at least one"):
        Bench()("inverse-depth", seeds=[])
    with pytest.raises(ValueError, match="preset must be one of"):
        Bench()("inverse-depth", scenario="no-such")
