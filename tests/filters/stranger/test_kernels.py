"""Kernels of a stranger's parts: the filter believes what it does by the numbers of the same part, at machine speed."""

from __future__ import annotations

import numpy as np
import pytest
from numba import config

from filters import RangeBearing, RightInvariant, StereoEKF, Strapdown, check_part, kernel

from ..drives import CAMERA, INDEPENDENT_PIXELS, drive
from .parts import DoubleSphere, OnS3
from .test_stranger import DT, START, imu_drive, seen_by


class InertialByNumbers(Strapdown):
    """The plain functions in Python."""

    in_machine_code = False


class SphereByNumbers(OnS3):
    """Likewise, on columns."""

    in_machine_code = False


class CameraByNumbers(DoubleSphere):
    """Likewise."""

    in_machine_code = False


def beliefs(**options: object) -> np.ndarray:
    """Poses and covariances of a drive, with the options of a filter."""
    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, **{"landmark": "shared-anchor", "drop_unseen": False, **options})
    slam.reset(START)
    inertial = isinstance(slam.options.motion, Strapdown)
    frames, steps = imu_drive(2, 8) if inertial else (drive(2, 8, depths=(6.0, 40.0)), None)
    rng, told = np.random.default_rng(2), []
    for k, frame in enumerate(frames):
        if k:
            slam.predict(DT, inertial=steps[k] if steps else None)
        sensor = slam.options.measurement
        slam.update(seen_by(sensor, frame, rng) if isinstance(sensor, DoubleSphere) else frame.observation)
        told += [slam.pose.position, slam.pose.orientation, np.linalg.cholesky(slam.pose.covariance).ravel()]
    return np.concatenate([*told, slam.landmarks.inverse_distance])


@kernel
def squared(number: int) -> int:
    return number * number


def test_a_function_of_a_filter_becomes_machine_code() -> None:
    """Whose integers have 64 bits."""
    assert squared(3) == 9
    assert squared(2**40) == (2**80 if config.DISABLE_JIT else 0)
    assert squared.__name__ == "squared"


PAIRS = {
    "motion": (Strapdown(), InertialByNumbers()),
    "landmark": (OnS3(), SphereByNumbers()),
    "measurement": (DoubleSphere(), CameraByNumbers()),
}
ERRORS = ("quaternion", "so3", "first-estimates", "right-invariant", RightInvariant(reset=True))
CASES = [(slot, {"error": error, "iterations": 2}) for slot in PAIRS for error in ERRORS]
CASES += [(slot, {"consensus": True, "tail_dof": 4.0, "drift": 0.3}) for slot in ("landmark", "measurement")]
CASES += [("motion", {"error": "right-invariant", "gauge_walk": 1e-3})]  # which turns gravity with the world


@pytest.mark.parametrize(("slot", "options"), CASES, ids=str)
def test_kernels_lead_where_the_numbers_do(slot: str, options: dict[str, object]) -> None:
    compiled, by_numbers = (beliefs(**{slot: part}, **options) for part in PAIRS[slot])
    np.testing.assert_allclose(compiled, by_numbers, rtol=1e-7, atol=1e-9)


NEAR = {0: "near", 1: "far"}


def uncompilable(base: type, name: str) -> object:
    """A part that Numba cannot compile: a dictionary, and an exception that it catches."""

    def function(self, *arguments):
        try:
            assert NEAR[0] == "near"
        except KeyError:
            return arguments
        return getattr(base, name)(self, *arguments)

    return type("ByTable", (base,), {name: function})()


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize(
    ("slot", "base", "name", "usual"),
    [("measurement", RangeBearing, "project", "joint"), ("motion", Strapdown, "step", "strapdown")],
)
def test_a_part_that_cannot_be_compiled_runs_in_python_and_check_part_says_so(
    slot: str, base: type, name: str, usual: str
) -> None:
    part = uncompilable(base, name)
    assert "Numba cannot compile" in str(check_part(part))
    assert "machine code" in str(check_part(base()))
    np.testing.assert_allclose(beliefs(**{slot: part}), beliefs(**{slot: usual}), rtol=1e-9, atol=1e-9)
