"""The monitor of divergence, from reports alone (< 1 s)."""

import numpy as np
import pytest

from filters import Cause, DivergenceMonitor, PoseBelief, UpdateReport

DT = 0.1
POSE = PoseBelief(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1e-4 * np.eye(6))


def report(used=20, refused=0, new=0, dropped=0, nis=None):
    ids = np.arange(used + refused + new)
    parts = {"updated": ids[:used], "gated": ids[used : used + refused], "initialised": ids[used + refused :]}
    return UpdateReport(
        **parts, dropped=1000 + np.arange(dropped), nis=3.0 * used if nis is None else nis, nis_dof=3 * used
    )


def look(monitor, reports, pose=POSE):
    """The alarms raised."""
    raised = [monitor.look(DT, one, pose) for one in reports]
    return [alarm for alarm in raised if alarm is not None]


def consistent(rng, count, used=20):
    return [report(used, nis=nis) for nis in rng.chisquare(3 * used, count)]


def with_covariance(*variances):
    return PoseBelief(POSE.position, POSE.orientation, np.diag(np.array(variances)))


@pytest.mark.parametrize("used", [1, 3, 20, 90])
def test_a_consistent_filter_raises_no_alarm_in_ten_thousand_frames(used):
    assert look(DivergenceMonitor(), consistent(np.random.default_rng(0), 10_000, used), None) == []


@pytest.mark.parametrize(
    "reports",
    [
        [report(nis=1.35 * 60)] * 1000,  # a little too large, for ever
        [UpdateReport()] * 3 + [report(0, new=20)],  # dark before the first landmark
        [report(0, new=20), report(), report(0, new=20, dropped=19)],  # one that is kept is a link to the map
    ],
)
def test_what_is_tolerated(reports):
    assert look(DivergenceMonitor(), reports) == []


@pytest.mark.parametrize(
    ("bad", "pose", "cause"),
    [
        (report(), PoseBelief(np.array([np.nan, 0.0, 0.0]), POSE.orientation, POSE.covariance), Cause.NUMBERS),
        (report(), PoseBelief(POSE.position, POSE.orientation, np.full((6, 6), np.inf)), Cause.NUMBERS),
        (report(), with_covariance(1, 1, 1, 1, 1, -1e-9), Cause.NUMBERS),
        (report(nis=np.nan), POSE, Cause.NUMBERS),
        (report(), with_covariance(1, 1, 1, 0.1, 0.1, 0.3), Cause.VAGUE),
    ],
)
def test_what_is_told_at_once_and_does_not_last(bad, pose, cause):
    monitor = DivergenceMonitor()
    (alarm,) = look(monitor, [bad], pose)
    assert alarm.cause is cause
    look(monitor, [report()] * 10)
    assert monitor.standing is None


@pytest.mark.parametrize(("used", "within"), [(3, 25), (20, 5), (90, 2)])
def test_innovations_four_times_as_large_as_claimed_are_noticed_within_frames(used, within):
    rng = np.random.default_rng(1)
    monitor = DivergenceMonitor()
    look(monitor, consistent(rng, 100, used))
    (alarm,) = look(monitor, [report(used, nis=4.0 * nis) for nis in rng.chisquare(3 * used, within)])
    assert alarm.cause is Cause.INNOVATIONS
    assert "larger than claimed" in alarm.words
    assert monitor.alarm is alarm
    assert DT * 100 < alarm.time <= DT * (100 + within) + 1e-9


def test_an_alarm_ends_soon_after_recovery_however_bad_it_was():
    monitor = DivergenceMonitor()
    look(monitor, [report(nis=1e12)] * 100)
    assert monitor.standing is Cause.INNOVATIONS
    look(monitor, [report()] * 5)
    assert monitor.standing is None
    assert monitor.alarm is not None


def test_it_is_raised_again_when_it_is_true_again():
    bad, good = [report(nis=1e3)] * 3, [report()] * 10
    assert len(look(DivergenceMonitor(), [*bad, *good, *bad])) == 2


def test_half_of_the_landmarks_refused_is_blamed_on_outliers_and_nearly_all_on_the_pose():
    assert look(DivergenceMonitor(), [report(10, 10)] * 100) == []
    (alarm,) = look(DivergenceMonitor(), [report(1, 19)] * 5)
    assert alarm.cause is Cause.REFUSED
    assert "19 of 20" in alarm.words


@pytest.mark.parametrize(("sigma", "told"), [(0.26, True), (0.24, False), (np.nan, True)])
def test_a_filter_with_odometry_may_be_blind_for_as_long_as_its_position_is_still_known(sigma, told):
    monitor = DivergenceMonitor()
    look(
        monitor, [report()], with_covariance(4.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4)
    )  # what it did not know before counts not
    pose = with_covariance(1.0, (2.0 + sigma) ** 2, 1.0, 1e-4, 1e-4, 1e-4)
    assert bool(look(monitor, [UpdateReport()] * 50, pose)) is told


@pytest.mark.parametrize(("refused", "dropped"), [(13, 7), (13, 0)])
def test_a_frame_of_new_landmarks_only_is_a_new_start_where_the_known_ones_are_refused(refused, dropped):
    monitor = DivergenceMonitor()
    assert look(monitor, [report(0, new=20), report()]) == []  # the first frame can have none
    (alarm,) = look(monitor, [report(0, refused, new=20, dropped=dropped)])
    assert alarm.cause is Cause.CUT
    look(monitor, [report()])
    assert monitor.standing is None


def test_a_map_that_begins_anew_is_no_alarm_unless_that_goes_on_and_the_position_fades():
    """Tracks that break every second are bridged by a prediction as well as it claims."""
    anew = report(0, new=20, dropped=20)
    assert look(DivergenceMonitor(), [report(0, new=20), *[anew, anew, report()] * 50]) == []
    monitor = DivergenceMonitor()
    look(monitor, [report(0, new=20), report()])
    assert look(monitor, [anew] * 20) == []
    (alarm,) = look(monitor, [anew], with_covariance(0.09, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4))
    assert alarm.cause is Cause.BLIND


def test_reset_forgets():
    monitor = DivergenceMonitor()
    look(monitor, [report(nis=1e6)])
    monitor.reset()
    assert (monitor.time, monitor.alarm, monitor.standing) == (0.0, None, None)
    assert look(monitor, [report(nis=65.0)]) == []


def test_impossible_arguments_are_named():
    for name, value in {"threshold": 0.0, "inflation": 1.0, "longest_blind": -1.0, "vaguest": np.nan}.items():
        with pytest.raises(ValueError, match=name):
            DivergenceMonitor(**{name: value})
    monitor = DivergenceMonitor()
    with pytest.raises(ValueError, match="dt"):
        monitor.look(-0.1, report())
    assert monitor.time == 0.0


# --- the numbers of the manual: thresholds of an alarm ---


def looks_until_an_alarm(monitor, one, pose=POSE, most=500):
    return next(k for k in range(1, most) if monitor.look(DT, one, pose) is not None)


@pytest.mark.parametrize(("threshold", "inflation"), [(None, None), (20.0, 2.0), (5.0, 2.0), (20.0, 1.5)])
def test_innovations_are_told_when_their_likelihood_ratio_reaches_the_threshold(threshold, inflation):
    """NIS of twice its degrees of freedom n: n (2 (1 - 1 / inflation) - ln inflation) / 2 nats a frame (Page, 1954)."""
    options = {} if threshold is None else {"threshold": threshold, "inflation": inflation}
    threshold, inflation = threshold or 20.0, inflation or 2.0
    dof = 6
    a_frame = 0.5 * (2.0 * dof * (1.0 - 1.0 / inflation) - dof * np.log(inflation))
    found = looks_until_an_alarm(DivergenceMonitor(**options), report(used=dof // 3, nis=2.0 * dof))
    assert found == int(np.ceil(threshold / a_frame))


@pytest.mark.parametrize(("used", "refused"), [(2, 6), (0, 3), (1, 5)])
def test_refusals_are_told_when_nine_in_ten_is_by_20_nats_likelier_than_half(used, refused):
    a_frame = refused * np.log(0.9 / 0.5) + used * np.log(0.1 / 0.5)
    one = report(used, refused, nis=0.0)
    assert looks_until_an_alarm(DivergenceMonitor(), one) == int(np.ceil(20.0 / a_frame))


@pytest.mark.parametrize(("longest", "frames"), [(None, 11), (0.45, 5)])
def test_the_dark_may_last_a_second_unless_told_otherwise(longest, frames):
    monitor = DivergenceMonitor() if longest is None else DivergenceMonitor(longest_blind=longest)
    look(monitor, [report()])
    assert looks_until_an_alarm(monitor, UpdateReport(), None) == frames
    assert monitor.alarm.cause is Cause.BLIND
    assert monitor.alarm.time == pytest.approx(DT * (frames + 1))
    look(monitor, [report()])
    assert monitor.standing is None


def test_exactly_as_long_as_it_may_be_dark_is_no_alarm():
    monitor = DivergenceMonitor(longest_blind=1.0)
    monitor.look(0.5, report())
    assert [monitor.look(0.5, UpdateReport()) is not None for _ in range(3)] == [False, False, True]


@pytest.mark.parametrize("axis", [3, 4, 5])
@pytest.mark.parametrize(("sigma", "told"), [(0.499, False), (0.501, True)])
def test_half_a_radian_is_the_most_that_an_orientation_may_be_unknown(axis, sigma, told):
    variances = [4.0, 4.0, 4.0, 1e-4, 1e-4, 1e-4]
    variances[axis] = sigma**2
    assert bool(look(DivergenceMonitor(), [report()], with_covariance(*variances))) is told


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("sigma", "told"), [(0.249, False), (0.251, True)])
def test_a_quarter_of_a_metre_is_the_most_that_the_position_may_fade_in_the_dark(axis, sigma, told):
    variances = np.full(6, 1e-6)
    variances[:3] = 0.0
    monitor = DivergenceMonitor()
    look(monitor, [report()], with_covariance(*(variances + 1e-12)))
    variances[axis] = sigma**2
    variances[:3] += 1e-12
    assert bool(look(monitor, [UpdateReport()] * 20, with_covariance(*variances))) is told


def test_landmarks_behind_the_camera_and_without_a_factor_are_refused_ones_too():
    ids = np.arange(20)
    for name in ("gated", "behind_camera", "failed"):
        one = UpdateReport(updated=ids[:1], **{name: ids[1:]}, nis=3.0, nis_dof=3)
        assert looks_until_an_alarm(DivergenceMonitor(), one) <= 3
