"""Whole sequences in groups: the same numbers as one filter after the other (2 s)."""

from __future__ import annotations

import numpy as np
import pytest

from filters import run_trials

from ..drives import DT
from .drives_together import EQUAL, drives, ekf, noisy_odometry, starts

FRAMES, TRIALS = 12, 5
TIMES = DT * np.arange(FRAMES)


@pytest.mark.parametrize("together", [1, 2, 64])
def test_the_series_are_those_of_one_filter_after_the_other(together):
    trials, odometry = drives(TRIALS, FRAMES), noisy_odometry(TRIALS, FRAMES)
    series = run_trials(ekf(), trials, TIMES, odometry=odometry, starts=starts(TRIALS), together=together)
    for b, start in enumerate(starts(TRIALS)):
        slam = ekf()
        slam.reset(**start)
        for k in range(FRAMES):
            if k:
                slam.predict(TIMES[k] - TIMES[k - 1], odometry[b][k])
            report, pose = slam.update(trials[b][k]), slam.pose
            for got, wanted in (
                (series.positions, pose.position),
                (series.orientations, pose.orientation),
                (series.pose_covariances, pose.covariance),
                (series.nis, report.nis),
                (series.nis_dof, report.nis_dof),
            ):
                np.testing.assert_allclose(got[b, k], wanted, rtol=EQUAL, atol=EQUAL)


def test_the_filter_itself_is_left_as_it_is():
    slam = ekf()
    slam.update(drives(1, 1)[0][0])
    run_trials(slam, drives(2, 3), TIMES[:3])
    assert len(slam.landmarks.ids) > 0
    np.testing.assert_array_equal(slam.pose.position, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"timestamps": TIMES[:-1]}, "sequences must have one entry per timestamp: 11, not so in trial 0"),
        ({"timestamps": -TIMES}, "dt must be"),
        ({"starts": [{}]}, "starts must be one for each of 2 sequences, got 1"),
        ({"odometry": [[None] * FRAMES]}, "odometry must be one for each of 2 sequences, got 1"),
        ({"odometry": [[None] * FRAMES, []]}, "odometry must have one entry per timestamp: 12, not so in trial 1"),
        ({"together": 0}, "together must be an integer >= 1"),
    ],
)
def test_what_does_not_fit_together_is_refused(change, message):
    arguments = {"sequences": drives(2, FRAMES), "timestamps": TIMES, **change}
    with pytest.raises(ValueError, match=message):
        run_trials(ekf(), **arguments)
