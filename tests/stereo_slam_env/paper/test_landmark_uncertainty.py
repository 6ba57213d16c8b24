"""Section 4.1 gives the known figures, and its claims follow from them (2 s)."""

import dataclasses

import numpy as np
import pytest

from stereo_slam_env.paper import landmark_uncertainty
from stereo_slam_env.paper.landmark_uncertainty import CAMERA, DEPTHS, fits, judge, places, points
from stereo_slam_env.paper.paper_claims import COUPLED, DIAGONAL, EUCLIDEAN, JOINT, PIXELS, UVD, ClaimVerdict

# Of an independent prototype: share of the cloud in the 95 % region, and distance of the depth marginal.
XYZ_COVERAGE = {5: 0.949, 15: 0.942, 30: 0.920, 45: 0.892, 70: 0.844, 150: 0.736}
XYZ_DISTANCE = {5: 0.007, 15: 0.021, 30: 0.042, 45: 0.063, 70: 0.096, 150: 0.185}


@pytest.fixture(scope="module")
def found():
    return fits(10_000)


@pytest.fixture(scope="module")
def judged():
    return {claim.sentence.key: claim for claim in judge(10_000)}


@pytest.mark.parametrize("depth", DEPTHS)
def test_figures_under_the_papers_noise(found, depth):
    ours, xyz = (found[UVD, DIAGONAL, depth, name] for name in (JOINT, EUCLIDEAN))
    assert ours.coverage.value == pytest.approx(0.951, abs=0.008)
    assert xyz.coverage.value == pytest.approx(XYZ_COVERAGE[depth], abs=0.01)
    assert ours.distance < 0.0136  # the 95 % point of 10,000 samples of the very distribution
    assert xyz.distance == pytest.approx(XYZ_DISTANCE[depth], abs=0.0136)


def test_the_full_R_describes_independent_pixels(found):
    for depth in DEPTHS:
        assert found[PIXELS, COUPLED, depth, JOINT].coverage.value == pytest.approx(0.95, abs=0.008)


def test_verdicts(judged):
    right_R = (
        "holds only if noise: as the paper assumes, R: the paper's; or noise: independent pixels, R: of independent"
    )
    assert judged["region-any-distance"].says.startswith(right_R)
    assert judged["region-70m-xyz"].verdict is ClaimVerdict.HOLDS
    assert judged["histogram"].verdict is ClaimVerdict.HOLDS
    assert judged["xyz-near"].verdict is ClaimVerdict.HOLDS


def test_with_few_points_nothing_is_shown():
    judged = {claim.sentence.key: claim for claim in judge(40)}
    assert judged["histogram"].verdict is ClaimVerdict.NOT_SHOWN
    by_noise = {f.verdict for f in judged["region-70m"].findings if "assumes" in f.condition["noise"]}
    assert ClaimVerdict.HOLDS not in by_noise


def test_a_region_that_is_no_better_than_that_of_xyz_does_not_hold(monkeypatch, found):
    """The verdict follows the numbers: with XYZ's figures in its place, ours does not hold."""
    swapped = {
        (noise, R, depth, name): found[noise, R, depth, EUCLIDEAN if name == JOINT else JOINT]
        for noise, R, depth, name in found
    }
    monkeypatch.setattr(landmark_uncertainty, "fits", lambda samples: swapped)
    judged = {claim.sentence.key: claim for claim in judge(10_000)}
    assert judged["region-70m"].verdict is ClaimVerdict.DOES_NOT_HOLD
    assert judged["histogram"].verdict is ClaimVerdict.DOES_NOT_HOLD
    assert judged["region-70m-xyz"].verdict is not ClaimVerdict.HOLDS


def test_fits_are_the_same_at_every_call(found):
    again = fits(10_000)
    assert {key: dataclasses.astuple(fit) for key, fit in again.items()} == {
        key: dataclasses.astuple(fit) for key, fit in found.items()
    }


def test_points_of_inverse_depths_are_where_the_camera_measured_them():
    uvd = CAMERA.project(np.array([[3.0, -1.0, 20.0], [-8.0, 2.0, 60.0]]))
    np.testing.assert_allclose(points(places(JOINT, uvd)), CAMERA.backproject(uvd), rtol=1e-12)
