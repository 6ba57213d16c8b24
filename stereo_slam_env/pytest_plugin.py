"""The pytest fixture `slam_bench`: unit tests of a filter in a few lines.

    def test_my_filter(slam_bench):
        result = slam_bench(MyFilter, against="inverse-depth")
        result.assert_not_worse(percent=5)
        result.assert_consistent()
        result.assert_faster_than(ms=10)

The benchmark is imported when a test asks for the fixture, not before. `--slam-seeds` on the command line, or
`slam_seeds` in the settings of pytest, says how many recordings each filter is run on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from stereo_slam_env.benchmark.head_to_head import Bench

DEFAULT_SEEDS = 10


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the number of recordings, as an option and as a setting."""
    words = "recordings that slam_bench runs each filter on"
    parser.addini("slam_seeds", f"{words} (default: {DEFAULT_SEEDS})", default=str(DEFAULT_SEEDS))
    parser.getgroup("stereo-slam").addoption(
        "--slam-seeds", type=int, metavar="N", help=f"{words} (default: slam_seeds)"
    )


@pytest.fixture(scope="session")
def slam_bench(request: pytest.FixtureRequest) -> Bench:
    """Run a filter against another one on the same recordings; see `stereo_slam_env.benchmark.head_to_head.Bench`.

    Recordings and runs are kept for the whole session.
    """
    from stereo_slam_env.benchmark.head_to_head import Bench

    seeds_option = request.config.getoption("--slam-seeds")
    text = str(request.config.getini("slam_seeds") if seeds_option is None else seeds_option)
    if not text.strip().isdecimal() or int(text) < 1:
        raise pytest.UsageError(f"slam_seeds must be a whole number >= 1, got {text!r}")
    return Bench(int(text))
