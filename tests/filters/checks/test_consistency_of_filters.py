"""`check_filter` and filters that are not what they were handed, or claim too much or too little (60 s)."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from filters import InverseDepthStereoEKF, LandmarkBelief, StereoEKF, StereoNoise
from filters.checks.conformance import as_benchmarks_make_it, check_filter

from ..false_claims import liar


def _another_noise(change: Callable[[np.ndarray], np.ndarray]) -> Any:
    def make(camera: Any, noise: Any, **options: Any) -> StereoEKF:
        return StereoEKF(camera, StereoNoise(change(noise.R)), landmark="shared-anchor", **options)

    return make


def _another_camera(**factors: float) -> Any:
    def make(camera: Any, noise: Any, **options: Any) -> StereoEKF:
        other = dataclasses.replace(
            camera, **{name: factor * getattr(camera, name) for name, factor in factors.items()}
        )
        return StereoEKF(other, noise, landmark="shared-anchor", **options)

    return make


def _square_root(R: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(R)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)


class _IgnoresTime(InverseDepthStereoEKF):
    def predict(self, dt: float, odometry: Any = None, inertial: Any = None) -> None:
        super().predict(0.1 if 0.0 < dt < np.inf else dt, odometry)


class _SwapsAxes(InverseDepthStereoEKF):
    @property
    def landmarks(self) -> LandmarkBelief:
        landmarks = super().landmarks
        return dataclasses.replace(landmarks, positions=landmarks.positions[:, [1, 0, 2]])


OVER, UNDER = "overconfident (mean pose NEES", "underconfident ("
WRONG: dict[str, tuple[Any, str]] = {
    "R / 100": (_another_noise(lambda R: 0.01 * R), OVER),
    "R / 4": (_another_noise(lambda R: 0.25 * R), OVER),
    "R x 4": (_another_noise(lambda R: 4.0 * R), UNDER),
    "R x 100": (_another_noise(lambda R: 100.0 * R), UNDER),
    "a standard deviation for a variance": (_another_noise(_square_root), UNDER),
    "a variance for a standard deviation": (_another_noise(lambda R: R @ R), OVER),
    "one pixel, whatever it is told": (_another_noise(lambda R: StereoNoise.independent_pixels(1.0).R), UNDER),
    "focal length": (_another_camera(fx=1.05, fy=1.05), OVER),
    "twice the baseline": (_another_camera(baseline=2.0), OVER),
    "half the baseline": (_another_camera(baseline=0.5), OVER),
    "no dt": (_IgnoresTime, "in 0.03 s, not to"),
    "swapped axes": (_SwapsAxes, "overconfident (median landmark NEES"),
    **{
        f"P of {what} x {factor}": (liar(what, partial(np.multiply, factor), 0), side)
        for what in ("pose", "velocity", "landmarks", "forecast")
        for factor, side in ((0.01, f" {what.removesuffix('s')} NEES"), (100.0, UNDER))
    },
}


@pytest.mark.parametrize("case", WRONG)
def test_what_a_filter_makes_of_its_rig_and_its_covariances_is_seen(case: str) -> None:
    wrong, said = WRONG[case]
    failed = check_filter(wrong, raise_on_failure=False).failed
    assert any(said in line for line in failed), failed


@pytest.mark.parametrize("share", [0.8, 1.0, 2.0])
def test_a_little_caution_is_none_of_its_faults(share: float) -> None:
    assert not check_filter(_another_noise(lambda R: share * R)).failed


def test_a_filter_that_brings_its_rig_is_driven_with_it() -> None:
    made = as_benchmarks_make_it(lambda: InverseDepthStereoEKF(*_RIG))
    assert made.driven_rig == _RIG


_RIG = (
    _another_camera(baseline=1.5)(*as_benchmarks_make_it("inverse-depth").driven_rig).camera,
    StereoNoise.diagonal(0.5, 0.5, 0.7),
)


@pytest.mark.parametrize("flags", [[], ["-O"], ["-OO"]])
def test_checks_do_not_hang_on_assert_statements(flags: list[str]) -> None:
    program = (
        "from filters import Euclidean, check_filter, check_part\n"
        "from tests.filters.false_claims import liar\n"
        "from tests.filters.checks.test_part_checks import NoCrossTerm, UsesNothing\n"
        "print(len(check_filter(liar('pose', 'negative'), raise_on_failure=False).failed) > 0)\n"
        "parts = NoCrossTerm(), UsesNothing(), Euclidean()\n"
        "print(*(len(check_part(part, raise_on_failure=False).failed) for part in parts))\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, *flags, "-c", program], capture_output=True, text=True, timeout=240, env=environment
    )
    assert done.stdout.splitlines() == ["True", "1 1 0"], done.stderr[-2000:]
