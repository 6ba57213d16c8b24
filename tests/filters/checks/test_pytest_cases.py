"""`parametrize_with_checks`: the checks of `check_filter`, one pytest case each (about 5 s)."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from filters import StereoEKF, parametrize_with_checks
from filters.checks.conformance import CHECKS

pytest_plugins = ["pytester"]

ALONE = [
    f"-pno:{name}"
    for name in ("hypothesispytest", "benchmark", "xdist", "randomly", "timeout", "cacheprovider", "stereo_slam")
]
"""Without the plug-ins that are installed."""

TESTS = """
from filters import InverseDepthStereoEKF, parametrize_with_checks


class Good(InverseDepthStereoEKF):
    pass


class AcceptsAnyTimeStep(InverseDepthStereoEKF):
    def predict(self, dt, odometry=None):
        super().predict(dt if dt > 0 else 0.1, odometry)


@parametrize_with_checks([Good, AcceptsAnyTimeStep, "shared-anchor"])
def test_contract(filter, check):
    check(filter)
"""


def test_a_good_filter_passes_and_a_bad_one_fails_where_it_is_bad(pytester: pytest.Pytester) -> None:
    """Each case is named by filter and check."""
    pytester.makepyfile(TESTS)
    result = pytester.runpytest_inprocess(*ALONE, "-v")
    result.assert_outcomes(passed=3 * len(CHECKS) - 1, failed=1)
    failed = "*::test_contract[[]AcceptsAnyTimeStep-check_bad_input[]]*"
    result.stdout.fnmatch_lines(["*AssertionError: predict(0) raised nothing", f"FAILED {failed}"])
    names = [line.partition("[")[2].partition("]")[0] for line in result.outlines if "::test_contract[" in line]
    expected = [
        f"{name}-{check.__name__}" for name in ("Good", "AcceptsAnyTimeStep", "shared-anchor") for check in CHECKS
    ]
    assert names[: len(expected)] == expected


@pytest.mark.parametrize(
    ("filters", "message"),
    [
        *(
            (given, r"^filters must be a list of filter classes and names,")
            for given in ("inverse-depth", [], StereoEKF)
        ),
        (["inverse-dept"], "did you mean 'inverse-depth'"),
    ],
    ids=repr,
)
def test_anything_but_a_list_of_filters_is_refused(filters: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parametrize_with_checks(filters)


def test_pytest_is_imported_only_for_a_test() -> None:
    code = "from filters import check_filter, parametrize_with_checks; import sys; sys.exit('pytest' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
