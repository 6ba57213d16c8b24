"""Named variables: their places, their belief, random walks, and those that are only considered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filters import BodyVelocity, StereoEKF
from filters.geometry import symmetric
from filters.geometry.poses import RotationVector
from filters.joint_state import StateLayout

from ..dense import constrained, gamma_of_variables
from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, drive, run, start
from ..engine.linear_problems import assert_covariances_equal, random_covariance
from ..third_party import BIAS, DISPARITY_ERRORS, MOUNTING, BiasedOdometry, ShearedPair

ODOMETRY = BodyVelocity([0.1, 0.05, SPEED], [0.01, 0.2, -0.02], np.diag(np.repeat([0.05, 0.01], 3) ** 2))


def make(**options) -> StereoEKF:
    parts = {"gate": None, "measurement": ShearedPair(), **options}
    return start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **parts))


def with_variable(**changes) -> ShearedPair:
    return ShearedPair((replace(DISPARITY_ERRORS, **changes),))


# --- places ---


def test_what_a_measurement_depends_on_stands_together_after_the_pose() -> None:
    layout = StateLayout.of((DISPARITY_ERRORS,), (BIAS, MOUNTING))
    assert list(layout.places) == ["pose", "disparity-errors", "velocity", "bias", "mounting"]
    assert [place.stop - place.start for place in layout.places.values()] == [6, 2, 6, 6, 3]
    assert layout.places["pose"] == slice(0, 6)
    assert (layout.measured, layout.errors, layout.size) == (8, 23, 24)  # rows come in threes
    placed = np.concatenate([layout.rows[place] for place in layout.places.values()])
    np.testing.assert_array_equal(placed, np.arange(23))
    assert layout.rows_of(("mounting", "disparity-errors")).tolist() == [20, 21, 22, 6, 7]
    assert (layout.linear_velocity, layout.angular_velocity) == (slice(8, 11), slice(11, 14))


def test_a_name_cannot_stand_for_two_variables() -> None:
    other = replace(DISPARITY_ERRORS, value=[1.0, 0.0])
    assert list(StateLayout.of((DISPARITY_ERRORS,), (BIAS, DISPARITY_ERRORS)).places)[1::2] == [
        "disparity-errors",
        "bias",
    ]
    with pytest.raises(ValueError, match="'disparity-errors' is asked for by measurement and motion with different"):
        StateLayout.of((DISPARITY_ERRORS,), (other,))
    with pytest.raises(ValueError, match="variables must have different names, got bias, bias"):
        StateLayout.of((), (BIAS, BIAS))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "pose"}, 'name must be that of a new variable, not "pose" or "velocity", got \'pose\''),
        ({"name": ""}, "name must be that of a new variable"),
        ({"value": [np.nan, 0.0]}, "value of variable 'disparity-errors' must be finite"),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance of variable 'disparity-errors' must be"),
        ({"covariance": np.eye(3)}, "variable 'disparity-errors' must have 2 numbers and 2 errors, got 2, 3"),
        ({"retraction": RotationVector()}, "variable 'disparity-errors' must have 4 numbers and 3 errors, got 2, 2"),
        ({"retraction": "addition"}, "retraction of variable 'disparity-errors' must be addition or RotationVector"),
        ({"in_world": True}, r"value of variable 'disparity-errors' must have shape \(3,\), got \(2,\)$"),
        ({"random_walk": [0.1]}, "random_walk of variable 'disparity-errors' must have shape"),
        ({"random_walk": [0.1, -0.1]}, "random_walk of variable 'disparity-errors' must be standard deviations >= 0"),
    ],
)
def test_an_impossible_variable_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(DISPARITY_ERRORS, **changes)


# --- belief ---


def test_every_variable_has_a_belief_which_is_its_start_at_first() -> None:
    slam = make(motion=BiasedOdometry())
    for variable in (DISPARITY_ERRORS, BIAS, MOUNTING):
        belief = slam.belief(variable.name)
        np.testing.assert_array_equal(belief.value, variable.value)
        np.testing.assert_array_equal(belief.covariance, variable.covariance)
    pose, velocity = slam.belief("pose"), slam.belief("velocity")
    np.testing.assert_array_equal(pose.value, np.concatenate([slam.pose.position, slam.pose.orientation]))
    np.testing.assert_array_equal(pose.covariance, slam.pose.covariance)
    np.testing.assert_array_equal(velocity.value, np.concatenate([slam.velocity.linear, slam.velocity.angular]))
    np.testing.assert_array_equal(velocity.covariance, slam.velocity.covariance)
    with pytest.raises(ValueError, match="there is no variable 'mountin', did you mean 'mounting'"):
        slam.belief("mountin")


def test_a_prediction_is_the_dense_one_of_all_variables() -> None:
    """F P F^T + G Q G^T, in the order in which the motion model names what it moves, and the random walks."""
    slam = make(motion=BiasedOdometry())
    slam.predict(DT, ODOMETRY)  # correlates them
    layout, motion, P = slam.options.layout, slam.options.motion, symmetric.full(slam.state.P)
    predicted = motion.predict(slam.state.camera, 0.4, ODOMETRY)
    rows = layout.rows_of(motion.moves)
    others = layout.rows_of(("disparity-errors",))
    F = np.eye(layout.size)
    F[np.ix_(rows, rows)] = predicted.F
    added = np.zeros_like(F)
    added[np.ix_(rows, rows)] = predicted.G @ predicted.Q @ predicted.G.T
    bias = layout.rows[layout.places["bias"]]
    added[bias, bias] += 0.4 * 0.01**2
    slam.predict(0.4, ODOMETRY)
    assert_covariances_equal(symmetric.full(slam.state.P), F @ P @ F.T + added, 1e-12)
    np.testing.assert_array_equal(symmetric.full(slam.state.P)[np.ix_(others, others)], DISPARITY_ERRORS.covariance)


@pytest.mark.parametrize("dt", [0.1, 2.0])
def test_a_random_walk_adds_its_variance_for_every_second(dt: float) -> None:
    slam = make(measurement=with_variable(random_walk=[0.2, 0.03]))
    slam.predict(dt)
    added = slam.belief("disparity-errors").covariance - DISPARITY_ERRORS.covariance
    np.testing.assert_allclose(added, dt * np.diag([0.2, 0.03]) ** 2, rtol=0, atol=1e-15)


def test_sigma_points_know_no_variables() -> None:
    with pytest.raises(ValueError, match="measurement must have no variables with update=Unscented"):
        make(update="unscented")


# --- considered ---


@pytest.mark.parametrize("rows", [1, 5, 40])
def test_a_correction_with_considered_rows_is_the_schmidt_kalman_filter(rows: int) -> None:
    """No gain for the considered rows, and the covariance that this gain really has."""
    rng = np.random.default_rng([33, rows])
    slam = make(measurement=with_variable(considered=True), error="first-estimates")
    list(run(slam, drive(33, 4, visible=15, depths=(6.0, 30.0))))
    state, layout, P = slam.state, slam.options.layout, symmetric.full(slam.state.P)
    names = ("velocity", "disparity-errors", "pose")
    H_of = {name: rng.standard_normal((rows, layout.rows_of((name,)).size)) for name in names}
    nu, R = 1e-3 * rng.standard_normal(rows), random_covariance(rng, rows) + 1e-3 * np.eye(rows)
    H, considered = np.zeros((rows, len(P))), layout.considered
    H[:, layout.rows_of(names)] = np.hstack(list(H_of.values()))
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    K[considered] = 0.0
    I_KH = np.eye(len(P)) - K @ H
    expected, before = I_KH @ P @ I_KH.T + K @ R @ K.T, slam.velocity.linear
    assert slam.correct(nu, H_of, R).used
    along = np.eye(len(P))  # the first estimate moves: P is carried to the effect of a turned world there
    turned = gamma_of_variables(layout, slam.state.camera)
    along[layout.rows[:, None], layout.rows] = constrained(np.eye(layout.size), turned, state.predicted, layout)
    expected = along @ expected @ along.T
    actual, regular = symmetric.full(slam.state.P), np.flatnonzero(np.diag(P) > 0.0)
    assert_covariances_equal(actual[np.ix_(regular, regular)], expected[np.ix_(regular, regular)], 1e-8)
    np.testing.assert_allclose(slam.velocity.linear - before, (K @ nu)[layout.linear_velocity], rtol=1e-8, atol=1e-12)
    np.testing.assert_array_equal(slam.belief("disparity-errors").value, DISPARITY_ERRORS.value)
    np.testing.assert_array_equal(slam.belief("disparity-errors").covariance, DISPARITY_ERRORS.covariance)


@pytest.mark.parametrize("error", ["quaternion", "right-invariant", "first-estimates"])
@pytest.mark.parametrize("iterations", [1, 3])
def test_a_considered_variable_never_changes_and_is_correlated_with_the_rest(error: str, iterations: int) -> None:
    slam = make(measurement=with_variable(considered=True), error=error, iterations=iterations)
    for k, frame in enumerate(drive(32, 12, visible=15, depths=(6.0, 30.0))):
        if k:
            slam.predict(DT, ODOMETRY if k % 2 else None)
        slam.update(frame.observation)
    belief = slam.belief("disparity-errors")
    np.testing.assert_array_equal(belief.value, DISPARITY_ERRORS.value)
    np.testing.assert_array_equal(belief.covariance, DISPARITY_ERRORS.covariance)
    rows = slam.options.layout.rows_of(("disparity-errors",))
    assert np.abs(symmetric.full(slam.state.P)[rows][:, :6]).max() > 1e-6
