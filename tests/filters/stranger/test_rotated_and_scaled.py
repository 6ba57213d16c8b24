"""Landmarks of SOT(3) at a clone with its orientation, as the equivariant filters have them, with an inertial unit."""

from __future__ import annotations

import numpy as np
import pytest

from filters import LandmarkModel, StereoEKF, Strapdown, check_part

from ..drives import CAMERA, INDEPENDENT_PIXELS
from ..inertial_drives import Journey, Path, driven, flown
from .rotated_and_scaled import RotatedAndScaled

RUNS, SECONDS = 8, 3.0


def test_the_part_is_right() -> None:
    check_part(RotatedAndScaled())


def test_a_correction_turns_the_bearing_and_scales_the_distance() -> None:
    """exp of the group at the landmark: 10 % farther, and round by .2 rad, wherever the bearing points."""
    model = RotatedAndScaled()
    x = np.array([[0.0, 0.0, 1.0, np.log(5.0)], [0.6, -0.8, 0.0, 0.0]])
    moved = model.retract(x, np.array([[0.2, 0.0, np.log(1.1)], [0.0, 0.2, np.log(1.1)]]))
    np.testing.assert_allclose(np.arccos(np.sum(moved[:, :3] * x[:, :3], axis=1)), 0.2)
    np.testing.assert_allclose(np.exp(moved[:, 3]) / np.exp(x[:, 3]), 1.1)


def flown_with(landmark: LandmarkModel | str, path: Path, seed: int) -> tuple[float, StereoEKF]:
    options = {"motion": Strapdown(), "error": "right-invariant", "gate": None}
    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark=landmark, **options)
    return float(np.mean(Journey.along(path, seed, SECONDS).run(slam))) / 6.0, slam


@pytest.mark.parametrize("path", [driven, flown], ids=["drives", "flights"])
def test_with_an_inertial_unit_it_is_consistent_and_nearly_the_same_about_anchors_that_are_points(path: Path) -> None:
    nees, apart, sigmas = [], [], []
    for seed in range(RUNS):
        share, mine = flown_with(RotatedAndScaled(), path, seed)
        _, other = flown_with("polar", path, seed)
        nees.append(share)
        apart.append(np.linalg.norm(mine.pose.position - other.pose.position))
        sigmas.append(np.sqrt(np.trace(other.pose.covariance[:3, :3])))
    assert 0.7 < np.mean(nees) < 1.4
    assert np.max(np.array(apart) / sigmas) < 0.02
