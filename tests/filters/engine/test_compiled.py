"""Compiled filters believe what NumPy's do, over whole drives.

Where nothing is in Numba's cache yet, it takes half a minute to compile first.
"""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

pytest.importorskip("numba", reason="needs the extra fast")

from filters.engine.kernels import camera, gating, inverse_depth, stage
from filters.engine.kernels import kalman as kernel_kalman
from filters.engine.kernels import linearisation as kernel_linearisation

from filters import BodyVelocity, StereoEKF, UpdateReport, VelocityDriven
from filters.engine import compiled, kalman, linearisation, symmetric
from filters.engine.options import LANDMARKS, MEASUREMENTS
from filters.measurements.model import Stage

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, Frame, drive
from .beliefs import assert_same_belief, make

ERRORS = ("quaternion", "so3", "first-estimates", "right-invariant")
TOLERANCE = 1e-10
OTHERS: dict[str, dict[str, object]] = {
    "no gate": {"gate": None},
    "tight gate": {"gate": 0.5},
    "joint test": {"consensus": True},
    "heavy tails": {"tail_dof": 4.0},
    "iterated": {"iterations": 3},
    "unscented": {"update": "unscented"},
    "kept map": {"drop_unseen": False},
}


def reports_over(stereo_filter: StereoEKF, frames: list[Frame], odometry: BodyVelocity | None) -> list[UpdateReport]:
    made = []
    for number, frame in enumerate(frames):
        if number:
            stereo_filter.predict(DT, odometry)
        made.append(stereo_filter.update(frame.observation))
    return made


def assert_both_ways_agree(
    frames: list[Frame], odometry: BodyVelocity | None = None, **options: object
) -> list[UpdateReport]:
    """Beliefs to 1e-10, reports to the id; gives the reports."""
    options = {"gate": 0.99, **options}
    by_numpy, by_machine_code = make(**options), make(**options, compiled=True)
    expected, actual = (reports_over(f, frames, odometry) for f in (by_numpy, by_machine_code))
    for one, other in zip(actual, expected, strict=True):
        for name in ("updated", "initialised", "dropped", "gated", "rejected", "behind_camera", "failed"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert one.nis_dof == other.nis_dof
        assert one.nis == pytest.approx(other.nis, rel=1e-8)
    assert_same_belief(by_machine_code, by_numpy, TOLERANCE)
    return expected


@pytest.mark.parametrize(("landmark", "measurement", "error"), list(product(LANDMARKS, MEASUREMENTS, ERRORS)))
def test_every_combination_gives_the_same_beliefs(landmark: str, measurement: str, error: str) -> None:
    reports = assert_both_ways_agree(
        drive(1, 12, v_right=True, depths=(6.0, 30.0)), landmark=landmark, measurement=measurement, error=error
    )
    assert sum(len(report.updated) for report in reports) > 80
    assert sum(len(report.dropped) for report in reports) > 10


@pytest.mark.parametrize("options", OTHERS.values(), ids=OTHERS.keys())
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_every_other_option_gives_the_same_beliefs(landmark: str, options: dict[str, object]) -> None:
    reports = assert_both_ways_agree(drive(2, 12, depths=(6.0, 30.0)), landmark=landmark, **options)
    if options == OTHERS["tight gate"]:
        assert sum(len(report.gated) for report in reports) > 20


@pytest.mark.parametrize("motion", [None, VelocityDriven()], ids=["constant velocity", "velocity-driven"])
def test_odometry_gives_the_same_beliefs(motion: VelocityDriven | None) -> None:
    odometry = BodyVelocity((0.0, 0.0, SPEED), (0.0, 0.2, 0.0), np.diag(np.repeat([0.3, 0.1], 3) ** 2))
    assert_both_ways_agree(drive(3, 12), odometry, motion=motion)


def test_landmarks_behind_the_camera_are_reported_alike() -> None:
    frames = drive(4, 3, missed=0.0, depths=(6.0, 12.0))
    by_numpy, by_machine_code = make(drop_unseen=False), make(drop_unseen=False, compiled=True)
    for stereo_filter in (by_numpy, by_machine_code):
        stereo_filter.update(frames[0].observation)
        for _ in range(20):
            stereo_filter.predict(DT)
    reports = [f.update(frames[0].observation) for f in (by_numpy, by_machine_code)]
    assert len(reports[0].behind_camera) > 0
    np.testing.assert_array_equal(reports[0].behind_camera, reports[1].behind_camera)
    assert_same_belief(by_machine_code, by_numpy, 1e-8)  # 2 s without a measurement: badly conditioned


def linearised() -> tuple[StereoEKF, kalman.LinearisedMeasurements]:
    frames = drive(5, 3, missed=0.0)
    stereo_filter = make(landmark="shared-anchor")
    reports_over(stereo_filter, frames, None)
    index = np.arange(len(stereo_filter._state))
    uvd, _ = linearisation.project(CAMERA, stereo_filter._state, index)
    stage = Stage(uvd + 0.5, np.eye(3), INDEPENDENT_PIXELS.R[None].repeat(len(index), axis=0))
    return stereo_filter, linearisation.linearise(CAMERA, stereo_filter._state, index, stage)


def test_a_measurement_without_a_cholesky_factor_is_left_out_alone() -> None:
    stereo_filter, measurements = linearised()
    broken = replace(measurements, R=measurements.R.copy())
    broken.R[4] = -1e6 * np.eye(3)
    one, other = stereo_filter._state.P.copy(order="F"), stereo_filter._state.P.copy(order="F")
    actual, expected = compiled.update(one, broken), kalman.update(other, broken)
    np.testing.assert_array_equal(actual.used, np.arange(len(measurements)) != 4)
    np.testing.assert_array_equal(actual.used, expected.used)
    assert actual.dof == expected.dof
    np.testing.assert_allclose(actual.delta, expected.delta, rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(symmetric.full(one), symmetric.full(other), rtol=0, atol=TOLERANCE)


def test_nothing_to_correct_with_changes_nothing() -> None:
    stereo_filter, measurements = linearised()
    P = stereo_filter._state.P.copy(order="F")
    correction = compiled.update(P, measurements[:0])
    assert not correction.delta.any()
    assert correction.nis == correction.dof == 0
    np.testing.assert_array_equal(P, stereo_filter._state.P)


def test_compiled_filters_can_be_copied_and_sent_to_other_processes() -> None:
    frames = drive(7, 6)
    original = make(landmark="shared-anchor", compiled=True)
    reports_over(original, frames[:3], None)
    twins = [copy.deepcopy(original), pickle.loads(pickle.dumps(original))]
    reports_over(original, frames[3:], None)
    for twin in twins:
        reports_over(twin, frames[3:], None)
        assert_same_belief(twin, original, 1e-14)


def test_a_filter_that_exists_never_compiles() -> None:
    modules = (camera, gating, inverse_depth, stage, kernel_kalman, kernel_linearisation)
    functions = [f for module in modules for f in vars(module).values() if hasattr(f, "nopython_signatures")]
    before = [len(f.nopython_signatures) for f in functions]
    assert sum(before) >= 8
    assert_both_ways_agree(drive(6, 6, v_right=True), measurement="sequential", error="right-invariant", tail_dof=4.0)
    assert_both_ways_agree(drive(6, 6), landmark="euclidean", consensus=True)
    assert [len(f.nopython_signatures) for f in functions] == before
