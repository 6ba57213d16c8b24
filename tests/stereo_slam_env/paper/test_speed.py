"""The claims of speed: measured in turns, judged by the ratio; the algebra of two bearings (10 s)."""

import numpy as np
import pytest

from filters import make_filter
from stereo_slam_env.paper import speed
from stereo_slam_env.paper.paper_claims import DUAL, JOINT, ClaimVerdict


def results_of(ours, theirs, rounds=12, predict=lambda n: n):
    """Made-up times: a frame of each filter, the same at every size, and a prediction by the size."""
    rng = np.random.default_rng(0)
    results = {}
    for n in (50, 200, 800):
        noise = iter(1.0 + 0.01 * rng.standard_normal((20, rounds)))
        arrays = {}
        for name, _, _ in speed.contestants():
            arrays[f"{name}.both"] = (ours if name.endswith(JOINT) else theirs) * next(noise)
            arrays[f"{name}.predict"] = predict(n) * next(noise)
        results[f"speed-{n:04d}"] = arrays
    return results


def judged(results):
    return {claim.sentence.key: claim for claim in speed.judge(results)}


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict"),
    [
        (1.0, 1.3, ClaimVerdict.HOLDS),
        (1.0, 0.9, ClaimVerdict.DOES_NOT_HOLD),
        (1.0, 1.0, ClaimVerdict.DOES_NOT_HOLD),  # the same: not faster
        (1.0, 1.02, ClaimVerdict.NOT_SHOWN),
    ],
)
def test_faster_is_a_matter_of_the_ratio_in_small_maps_and_in_large_ones(ours, theirs, verdict):
    found = judged(results_of(ours, theirs))
    for key, sizes in (("faster", {"50", "200"}), ("faster-large", {"800"})):
        assert {one.condition["landmarks"] for one in found[key].findings} == sizes
        assert found[key].verdict is verdict


@pytest.mark.parametrize(
    ("power", "verdict"), [(1, ClaimVerdict.HOLDS), (1.2, ClaimVerdict.NOT_SHOWN), (3, ClaimVerdict.DOES_NOT_HOLD)]
)
def test_a_prediction_is_linear_if_its_time_grows_as_the_map(power, verdict):
    claim = judged(results_of(1.0, 1.0, predict=lambda n: n**power))["linear-prediction"]
    assert claim.verdict is verdict
    for finding in claim.findings:
        assert finding.condition["landmarks"] == "200 to 800"
        assert finding.measured.value == pytest.approx(power, abs=0.02)


def test_one_update_is_counted_in_the_filters():
    once = judged(results_of(1.0, 1.3))["one-update"]
    assert [finding.measured.value for finding in once.findings] == [1, 2]
    assert once.verdict is ClaimVerdict.HOLDS


def test_two_bearings_have_the_information_of_the_range_for_the_same_R():
    """So the range does contribute: equal to rounding, whatever the filter is asked for (refuted in algebra)."""
    gaps = speed.information_gaps()
    assert len(gaps) == 3
    assert max(gaps.values()) < 1e-12
    assert judged(results_of(1.0, 1.0))["no-range"].verdict is ClaimVerdict.DOES_NOT_HOLD


def test_an_update_with_both_bearings_is_that_with_the_range():
    """The same by the filters themselves, one update of the first frame's landmarks."""
    beliefs = []
    for measurement in ("joint", "stacked"):
        slam = make_filter(JOINT, camera=speed.CAMERA, noise=speed.NOISE, gate=None, measurement=measurement)
        drive = speed.SlowDrive(20, slam)
        drive.milliseconds(1)
        beliefs.append((slam.pose.position, slam.joint_covariance()))
    (ours, P), (theirs, P_bearings) = beliefs
    np.testing.assert_allclose(theirs, ours, atol=1e-12)
    np.testing.assert_allclose(P_bearings, P, atol=1e-12 * np.abs(P).max())


def test_every_form_and_filter_is_timed():
    times = speed.experiments([12], repeats=2)["speed-0012"]()
    assert set(times) == {f"{name}.{part}" for name, _, _ in speed.contestants() for part in ("predict", "both")}
    assert {f"{form}.{name}.both" for form in speed.FORMS for name in (JOINT, DUAL)} < set(times)
    for values in times.values():
        assert values.shape == (2,)
        assert (values > 0).all()


def test_a_large_map_is_kept_and_a_hundred_of_it_seen():
    _, kind, options = next(iter(speed.contestants()))
    slam = make_filter(kind, camera=speed.CAMERA, noise=speed.NOISE, gate=None, drop_unseen=False, **options)
    drive = speed.SlowDrive(250, slam)
    drive.milliseconds(1)
    assert len(slam.landmarks.ids) == 250
    assert len(drive._observe().ids) == speed.IN_VIEW
