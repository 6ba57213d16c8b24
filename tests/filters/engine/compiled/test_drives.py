"""Filters in machine code believe what filters by NumPy do, over whole drives; and what asks for machine code."""

from __future__ import annotations

import copy
import logging
import pickle
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from filters import (
    BodyVelocity,
    CalibratedPair,
    LeftThenRight,
    RightInvariant,
    Stacked,
    StereoEKF,
    StereoObservation,
    UpdateReport,
    VelocityDriven,
)
from filters.engine import machine_code

from ...drives import DT, SPEED, Frame, drive
from ...engine.beliefs import assert_same_belief, make

LANDMARKS = ("inverse-depth", "shared-anchor", "euclidean")
MEASUREMENTS = ("joint", "sequential", "stacked", "left")
ERRORS = ("quaternion", "so3", "first-estimates", "right-invariant", "left-invariant")
OTHERS: dict[str, dict[str, object]] = {
    "no gate": {"gate": None},
    "tight gate": {"gate": 0.5},
    "joint test": {"consensus": True},
    "heavy tails": {"tail_dof": 4.0},
    "iterated": {"iterations": 3},
    "kept map": {"drop_unseen": False},
    "near ones only": {"min_disparity": 20.0},
    "everything": {"consensus": True, "tail_dof": 4.0, "iterations": 2, "drop_unseen": False},
}
CALIBRATED = {
    "disparity offset": CalibratedPair(offset_sigma=0.25),
    "focal lengths and orientation": CalibratedPair(focal_sigma=3e-3, misalignment_sigma=5e-3),
    "all of it": CalibratedPair(0.25, 3e-3, 2e-3, 5e-3),
    "all of it, considered": CalibratedPair(0.25, 3e-3, 2e-3, 5e-3, considered=True),
    "nothing": CalibratedPair(),
}
ODOMETRY = BodyVelocity((0.0, 0.0, SPEED), (0.0, 0.2, 0.0), np.diag(np.repeat([0.3, 0.1], 3) ** 2))


NAMES = ("updated", "initialised", "dropped", "gated", "rejected", "behind_camera", "failed")


def reports_over(slam: StereoEKF, frames: list[Frame], odometry: BodyVelocity | None = None) -> list[UpdateReport]:
    reports = []
    for number, frame in enumerate(frames):
        if number:
            slam.predict(DT, odometry)
        reports.append(slam.update(frame.observation))
    return reports


def assert_both_agree(
    frames: list[Frame], odometry: BodyVelocity | None = None, tolerance: float = 1e-10, **options: object
) -> list[UpdateReport]:
    """Reports to the id, beliefs to the tolerance; gives the reports of NumPy."""
    options = {"gate": 0.99, **options}
    by_numpy, by_machine_code = make(**options, compiled=False), make(**options, compiled=True)
    expected, actual = (reports_over(slam, frames, odometry) for slam in (by_numpy, by_machine_code))
    for one, other in zip(actual, expected, strict=True):
        for name in NAMES:
            np.testing.assert_array_equal(np.sort(getattr(one, name)), np.sort(getattr(other, name)), err_msg=name)
        assert one.nis_dof == other.nis_dof
        assert one.nis == pytest.approx(other.nis, rel=1e-8, abs=1e-12)
    assert_same_belief(by_machine_code, by_numpy, tolerance)
    return expected


@pytest.mark.parametrize(("landmark", "measurement", "error"), list(product(LANDMARKS, MEASUREMENTS, ERRORS)))
@pytest.mark.parametrize("v_right", [False, True])
def test_every_combination_gives_the_same_beliefs(landmark: str, measurement: str, error: str, v_right: bool) -> None:
    frames = drive(1, 12, v_right=v_right, depths=(6.0, 30.0))
    reports = assert_both_agree(frames, landmark=landmark, measurement=measurement, error=error)
    assert sum(len(report.updated) for report in reports) > 80
    assert sum(len(report.dropped) for report in reports) > 10


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_what_lies_outside_the_upper_triangle_in_use_plays_no_part(landmark: str, error: str) -> None:
    frames = drive(1, 12, depths=(6.0, 30.0))
    clean, soiled = (make(landmark=landmark, error=error, gate=0.99, consensus=True, compiled=True) for _ in range(2))
    for frame in frames:
        assert soiled.compiled is not None
        engine = soiled.compiled.engine
        P = engine.storage.P[0]
        row, column = np.indices(P.shape)
        used = engine.recipe.leading + 3 * engine.storage.counts[0, 1]
        P[(column < row) | (column >= used)] = np.nan
        for slam in (clean, soiled):
            slam.predict(DT)
            slam.update(frame.observation)
    assert len(soiled.ids) > 10
    assert_same_belief(soiled, clean, 0.0)


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("options", OTHERS.values(), ids=OTHERS.keys())
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_every_other_option_gives_the_same_beliefs(landmark: str, options: dict[str, object], error: str) -> None:
    reports = assert_both_agree(drive(2, 12, depths=(6.0, 30.0)), landmark=landmark, error=error, **options)
    if options == OTHERS["tight gate"]:
        assert sum(len(report.gated) for report in reports) > 20


@pytest.mark.parametrize("measurement", MEASUREMENTS)
@pytest.mark.parametrize("v_right", [False, True])
def test_the_joint_test_of_wrong_measurements_goes_alike_in_every_stage(measurement: str, v_right: bool) -> None:
    """Errors of ten pixels in every third measurement, in either image; frames in which nothing agrees."""
    rng = np.random.default_rng(6)
    frames = []
    for number, frame in enumerate(drive(6, 14, v_right=v_right, depths=(6.0, 30.0))):
        seen = frame.observation
        wrong = (rng.random((len(seen), 3)) < (1.0 if number % 5 == 4 else 0.2)) & (number > 0)
        uvd = seen.uvd + wrong * rng.normal(0.0, 10.0, wrong.shape)
        frames.append(replace(frame, observation=StereoObservation(seen.ids, uvd, v_right=seen.v_right)))
    reports = assert_both_agree(frames, measurement=measurement, landmark="shared-anchor", consensus=True)
    assert sum(len(report.gated) for report in reports) > 30


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("motion", [None, VelocityDriven()], ids=["constant velocity", "velocity-driven"])
def test_odometry_gives_the_same_beliefs(motion: VelocityDriven | None, error: str) -> None:
    assert_both_agree(drive(3, 12), ODOMETRY, motion=motion, error=error)


@pytest.mark.parametrize("model", [LeftThenRight(2.0), Stacked(2.0)])
@pytest.mark.parametrize("v_right", [False, True])
def test_a_copied_row_counts_alike(model: object, v_right: bool) -> None:
    assert_both_agree(drive(5, 12, v_right=v_right), measurement=model)


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("model", CALIBRATED.values(), ids=CALIBRATED)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_calibration_in_the_state_gives_the_same_beliefs(landmark: str, model: CalibratedPair, error: str) -> None:
    frames = drive(4, 12, depths=(6.0, 30.0))
    assert_both_agree(frames, landmark=landmark, measurement=model, error=error)


@pytest.mark.parametrize("considered", [False, True])
@pytest.mark.parametrize("options", OTHERS.values(), ids=OTHERS.keys())
def test_every_other_option_goes_with_a_calibration(options: dict[str, object], considered: bool) -> None:
    model = CalibratedPair(0.25, 3e-3, 2e-3, 5e-3, considered=considered)
    assert_both_agree(drive(2, 12, depths=(6.0, 30.0)), landmark="shared-anchor", measurement=model, **options)


def test_right_invariant_errors_with_reset_agree_too() -> None:
    assert_both_agree(drive(1, 12, depths=(6.0, 30.0)), error=RightInvariant(reset=True), landmark="shared-anchor")


def test_compiled_filters_can_be_copied_and_sent_to_other_processes() -> None:
    frames = drive(7, 6)
    original = make(landmark="shared-anchor", compiled=True)
    reports_over(original, frames[:3])
    twins = [copy.deepcopy(original), pickle.loads(pickle.dumps(original))]
    reports_over(original, frames[3:])
    for twin in twins:
        reports_over(twin, frames[3:])
        assert_same_belief(twin, original, 1e-14)


def test_a_clone_of_the_pose_makes_a_filter_go_on_by_numpy() -> None:
    frames = drive(8, 8)
    plain, with_clone = make(compiled=None), make(compiled=None)
    for slam in (plain, with_clone):
        reports_over(slam, frames[:4])
    with_clone.clone_pose("then")
    for slam in (plain, with_clone):
        reports_over(slam, frames[4:])
    assert_same_belief(with_clone, plain, 1e-10)
    assert with_clone.belief("then").covariance.shape == (6, 6)


def test_a_filter_is_compiled_where_all_its_parts_are() -> None:
    assert make(compiled=None).compiled is not None
    assert make(compiled=None, landmark="hybrid").compiled is None
    assert make(compiled=None, update="unscented").compiled is None
    assert make(compiled=None, max_landmarks=9).compiled is None
    assert make(compiled=False).compiled is None


def test_a_subclass_of_a_part_has_no_kernel_of_its_own() -> None:
    class Own(LeftThenRight):
        """Perhaps it measures something else."""

    assert make(compiled=None, measurement=Own()).compiled is None


@pytest.mark.parametrize("options", [{"landmark": "hybrid"}, {"update": "unscented"}, {"max_landmarks": 9}])
def test_compiled_parts_can_be_demanded(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"^compiled must be False or None where .* has no compiled form$"):
        make(compiled=True, **options)


def test_where_numba_does_not_work_filters_run_by_numpy(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "filters.engine.compiled.stereo_ekf", None)
    machine_code.trouble.cache_clear()
    try:
        with caplog.at_level(logging.WARNING):
            assert make(compiled=None).compiled is None
            assert make(compiled=None).compiled is None
        assert caplog.text.count("Numba does not work here") == 1
        with pytest.raises(ValueError, match="Numba does not work here"):
            make(compiled=True)
    finally:
        machine_code.trouble.cache_clear()


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landmark", LANDMARKS)
@pytest.mark.parametrize(
    "drift",
    [0.4, {"pixels": (1.2, 1.0, 0.5), "gate_pixels": (0.4, 0.4, 0.2)}, {"share": 0.2, "pixels": (0.5, 0.5, 0.1)}],
)
@pytest.mark.parametrize("consensus", [False, True])
def test_landmarks_that_drift_have_the_same_beliefs(landmark: str, error: str, drift: object, consensus: bool) -> None:
    reports = assert_both_agree(
        drive(1, 12, depths=(6.0, 30.0)), landmark=landmark, error=error, drift=drift, consensus=consensus, tail_dof=6.0
    )
    assert sum(len(report.updated) for report in reports) > 80


@pytest.mark.parametrize("error", ["first-estimates", "right-invariant"])
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_walk_of_the_gauge_has_the_same_beliefs(landmark: str, error: str) -> None:
    walk = 0.01
    frames = drive(1, 12, depths=(6.0, 30.0))
    reports = assert_both_agree(frames, ODOMETRY, landmark=landmark, error=error, gauge_walk=walk)
    assert sum(len(report.updated) for report in reports) > 80
