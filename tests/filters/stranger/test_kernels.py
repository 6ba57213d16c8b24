"""Kernels of a stranger's parts: the filter believes what it does by the numbers of the same part, at machine speed."""

from __future__ import annotations

from dataclasses import dataclass

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


@pytest.mark.parametrize(
    "error", ["quaternion", "so3", "first-estimates", "right-invariant", RightInvariant(reset=True)], ids=str
)
@pytest.mark.parametrize(
    ("slot", "compiled", "by_numbers"),
    [
        ("motion", Strapdown(), InertialByNumbers()),
        ("landmark", OnS3(), SphereByNumbers()),
        ("measurement", DoubleSphere(), CameraByNumbers()),
    ],
    ids=["inertial motion", "S3", "double sphere"],
)
def test_kernels_lead_where_the_numbers_do(slot: str, compiled: object, by_numbers: object, error: object) -> None:
    options = {"error": error, "iterations": 2}
    np.testing.assert_allclose(
        beliefs(**{slot: compiled}, **options), beliefs(**{slot: by_numbers}, **options), rtol=1e-7, atol=1e-9
    )


@pytest.mark.parametrize("option", [{"drift": 0.3}, {"consensus": True}, {"tail_dof": 4.0}], ids=str)
def test_options_work_with_kernels_as_with_numbers(option: dict[str, object]) -> None:
    for compiled, by_numbers in (
        ({"measurement": DoubleSphere()}, {"measurement": CameraByNumbers()}),
        ({"landmark": OnS3()}, {"landmark": SphereByNumbers()}),
    ):
        np.testing.assert_allclose(beliefs(**compiled, **option), beliefs(**by_numbers, **option), rtol=1e-7, atol=1e-9)


def test_a_gauge_walk_turns_gravity_with_the_world() -> None:
    option = {"error": "right-invariant", "gauge_walk": 1e-3}
    compiled, by_numbers = beliefs(motion=Strapdown(), **option), beliefs(motion=InertialByNumbers(), **option)
    np.testing.assert_allclose(compiled, by_numbers, rtol=1e-7, atol=1e-9)


NEAR = {0: "near", 1: "far"}


@dataclass(frozen=True)
class ByTable(RangeBearing):
    """A sensor that Numba cannot compile: a dictionary, and an exception that it catches."""

    def project(self, camera, h):
        """Eq. 10."""
        try:
            assert NEAR[0] == "near"
        except KeyError:
            return h
        return _project(self, camera, h)


_project = RangeBearing.project


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_part_that_cannot_be_compiled_runs_in_python_and_check_part_says_so() -> None:
    assert "Python" in str(check_part(ByTable()))
    assert "machine code" in str(check_part(DoubleSphere()))
    np.testing.assert_allclose(beliefs(measurement=ByTable()), beliefs(measurement="joint"), rtol=1e-9, atol=1e-9)


@dataclass(frozen=True)
class ByTableOfMotion(Strapdown):
    """A motion that Numba cannot compile."""

    def step(self, x, dt, n):
        """That of `Strapdown`."""
        try:
            assert NEAR[0] == "near"
        except KeyError:
            return x
        return Strapdown.step(self, x, dt, n)


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_motion_that_cannot_be_compiled_runs_in_python_and_check_part_says_so() -> None:
    assert "Numba cannot compile ByTableOfMotion.step" in str(check_part(ByTableOfMotion()))
    assert "machine code" in str(check_part(Strapdown()))
    np.testing.assert_allclose(beliefs(motion=ByTableOfMotion()), beliefs(motion="strapdown"), rtol=1e-9, atol=1e-9)


@kernel
def squared(number: int) -> int:
    return number * number


def test_a_function_of_a_filter_becomes_machine_code() -> None:
    """Whose integers have 64 bits."""
    assert squared(3) == 9
    assert squared(2**40) == (2**80 if config.DISABLE_JIT else 0)
    assert squared.__name__ == "squared"
