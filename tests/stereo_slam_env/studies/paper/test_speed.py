"""The claim of speed: measured in turns, judged by the ratio (2 s)."""

import numpy as np
import pytest

from stereo_slam_env.studies.paper import speed
from stereo_slam_env.studies.paper.claims import DUAL, JOINT, ClaimVerdict


def results_of(ours, theirs, rounds=12):
    rng = np.random.default_rng(0)
    noise = 1.0 + 0.01 * rng.standard_normal((2, rounds))
    arrays = {}
    for form in speed.FORMS:
        arrays |= {f"{form}.{JOINT}": ours * noise[0], f"{form}.{DUAL}": theirs * noise[1]}
    return {"speed-0025": arrays, "speed-0100": arrays}


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict"),
    [
        (1.0, 1.3, ClaimVerdict.HOLDS),
        (1.0, 0.9, ClaimVerdict.DOES_NOT_HOLD),
        (1.0, 1.0, ClaimVerdict.DOES_NOT_HOLD),  # the same: not faster
        (1.0, 1.02, ClaimVerdict.NOT_SHOWN),
    ],
)
def test_faster_is_a_matter_of_the_ratio(ours, theirs, verdict):
    faster, _ = speed.judge(results_of(ours, theirs))
    assert faster.verdict is verdict


def test_one_update_is_counted_in_the_filters():
    _, once = speed.judge(results_of(1.0, 1.3))
    assert [finding.measured.value for finding in once.findings] == [1, 2]
    assert once.verdict is ClaimVerdict.HOLDS


def test_every_form_and_filter_is_timed():
    times = speed.experiments([12], repeats=2)["speed-0012"]()
    assert set(times) == {f"{form}.{name}" for form in speed.FORMS for name in (JOINT, DUAL)}
    for values in times.values():
        assert values.shape == (2,)
        assert (values > 0).all()
