"""The compiled engine believes what the NumPy engine does, over whole drives."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from filters import BodyVelocity, LeftThenRight, Stacked, VelocityDriven

from ..drives import SPEED, drive
from .reference import assert_both_agree

LANDMARKS = ("inverse-depth", "shared-anchor", "euclidean")
MEASUREMENTS = ("joint", "sequential", "stacked", "left")
ERRORS = ("quaternion", "so3", "first-estimates", "right-invariant")
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
ODOMETRY = BodyVelocity((0.0, 0.0, SPEED), (0.0, 0.2, 0.0), np.diag(np.repeat([0.3, 0.1], 3) ** 2))


@pytest.mark.parametrize(("landmark", "measurement", "error"), list(product(LANDMARKS, MEASUREMENTS, ERRORS)))
@pytest.mark.parametrize("v_right", [False, True])
def test_every_combination_gives_the_same_beliefs(landmark: str, measurement: str, error: str, v_right: bool) -> None:
    frames = drive(1, 12, v_right=v_right, depths=(6.0, 30.0))
    reports = assert_both_agree(frames, landmark=landmark, measurement=measurement, error=error)
    assert sum(len(report.updated) for report in reports) > 80
    assert sum(len(report.dropped) for report in reports) > 10


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("options", OTHERS.values(), ids=OTHERS.keys())
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_every_other_option_gives_the_same_beliefs(landmark: str, options: dict[str, object], error: str) -> None:
    reports = assert_both_agree(drive(2, 12, depths=(6.0, 30.0)), landmark=landmark, error=error, **options)
    if options == OTHERS["tight gate"]:
        assert sum(len(report.gated) for report in reports) > 20


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("motion", [None, VelocityDriven()], ids=["constant velocity", "velocity-driven"])
def test_odometry_gives_the_same_beliefs(motion: VelocityDriven | None, error: str) -> None:
    assert_both_agree(drive(3, 12), ODOMETRY, motion=motion, error=error)


@pytest.mark.parametrize("model", [LeftThenRight(2.0), Stacked(2.0)])
@pytest.mark.parametrize("v_right", [False, True])
def test_a_copied_row_counts_alike(model: object, v_right: bool) -> None:
    assert_both_agree(drive(5, 12, v_right=v_right), measurement=model)
