"""The reward is what was learnt: telescoping, discovery, and the guard against over-confidence (4 s)."""

import numpy as np
import pytest

from filters import ConstantVelocity
from stereo_slam_env.envs import BeliefObservation, InformationCriterion, InformationGain
from stereo_slam_env.envs.information import CRITERIA
from stereo_slam_env.evaluation.cramer_rao import cramer_rao_bound

from ..benchmark.small_recordings import small_recording
from .replayed import ReplayEnv, episode


def gained(recording=None, loop=None, **arguments):
    """Rewards and infos of an episode with the filter `loop` (arguments of `BeliefObservation`)."""
    env = InformationGain(BeliefObservation(ReplayEnv(recording), **(loop or {})), **arguments)
    _, rewards, infos = episode(env)
    return env, np.array(rewards[1:]), infos


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize(
    "arguments",
    [{}, {"of": "pose"}, {"belief": "reference"}, {"nees_gate": 0.5}, {"weight": 0.3}, {"report_both": True}],
    ids=str,
)
def test_the_return_telescopes_to_the_total_gain(criterion, arguments):
    _, rewards, infos = gained(criterion=criterion, **arguments)
    potentials = [info["information_potential"] for info in infos]
    total = arguments.get("weight", 1.0) * (potentials[0] - potentials[-1])
    assert rewards.sum() == pytest.approx(total, rel=1e-9, abs=1e-9 * np.abs(potentials).max())


def test_the_potential_is_that_of_the_filters_joint_covariance():
    env, _, infos = gained()
    wanted = InformationCriterion().potential(env.get_wrapper_attr("slam").joint_covariance())
    assert infos[-1]["information_potential"] == pytest.approx(wanted, rel=1e-12)
    env, _, infos = gained(criterion="a-optimality", of="pose", prior_sigma=5.0)
    P = env.get_wrapper_attr("slam").pose.covariance
    assert infos[-1]["information_potential"] == pytest.approx(np.trace(P[:3, :3]) / 3 + 25 * np.trace(P[3:, 3:]) / 3)


def test_rewards_are_plain_numbers_and_can_be_added_to_those_of_the_environment():
    alone = gained(weight=2.0)[1]
    env, both, infos = gained(weight=2.0, keep_reward=True)
    np.testing.assert_allclose(both, alone + 1.0, rtol=1e-12)
    assert [info["reward_information"] for info in infos] == pytest.approx([0.0, *alone])
    env.reset(seed=0)
    assert type(env.step(env.action_space.sample())[1]) is float


def test_landmarks_that_leave_cost_what_they_had_earned():
    """The same drive: the paper's policy drops what is not seen, the other keeps it."""
    _, dropping, _ = gained(loop={"options": {"drop_unseen": True}})
    _, keeping, _ = gained(loop={"options": {"drop_unseen": False}})
    assert keeping.sum() > dropping.sum() + 10.0


def test_the_reference_is_the_recursion_of_the_bound():
    recording = small_recording(frames=25)
    for max_age, tolerance in ((None, 1e-7), (0, 1e-7)):  # every landmark here is seen until it is lost for good
        env = InformationGain(ReplayEnv(recording), belief="reference", max_age=max_age)
        episode(env)
        bound = cramer_rao_bound(recording, ConstantVelocity(), use_odometry=True)
        np.testing.assert_allclose(env.reference.pose_covariance, bound.pose[-1], rtol=tolerance, atol=1e-12)
    assert set(env.reference.ids) == set(recording.frames[-1].observation.ids)


def test_the_reference_forgets_by_age():
    recording = small_recording(frames=25)
    ids = [frame.observation.ids for frame in recording.frames]
    for max_age in (0, 2, 7, None):
        env = InformationGain(ReplayEnv(recording), belief="reference", max_age=max_age)
        episode(env)
        recent = ids if max_age is None else ids[-max_age - 1 :]
        np.testing.assert_array_equal(env.reference.ids, np.unique(np.concatenate(recent)))


def test_the_reference_needs_no_filter_and_is_the_same_for_all():
    alone = episode(InformationGain(ReplayEnv(), belief="reference"))[1]
    for name in ("shared-anchor", "euclidean", "dead-reckoning"):
        env = InformationGain(BeliefObservation(ReplayEnv(), name), belief="reference")
        assert episode(env)[1] == alone


# --- over-confidence -------------------------------------------------------------------------------------------------

SEEDS = range(6)
TOO_SURE = {"noise": 1.0 / 3.0, "options": {"gate": None}}
HONEST = {"noise": 1.0, "options": {"gate": None}}


def returns(loop, **arguments):
    return np.array([gained(small_recording(seed, frames=25), loop, **arguments)[1].sum() for seed in SEEDS])


def test_an_over_confident_filter_earns_more_by_its_own_account():
    """From the second frame on: what it says at reset is too sure as well, and is not paid for."""
    arguments = {"of": "pose"}
    assert (returns(TOO_SURE, **arguments) > returns(HONEST, **arguments) + 1.0).all()


def test_with_the_reference_belief_it_earns_the_same():
    arguments = {"of": "pose", "belief": "reference"}
    np.testing.assert_array_equal(returns(TOO_SURE, **arguments), returns(HONEST, **arguments))


def test_with_the_gate_it_earns_nothing_while_it_is_wrong():
    for seed in SEEDS:
        recording = small_recording(seed, frames=25)
        _, claimed, _ = gained(recording, TOO_SURE, of="pose")
        env, credited, _ = gained(recording, TOO_SURE, of="pose", nees_gate=0.95)
        assert credited.sum() <= claimed.sum() + 1e-9
    env.reset(seed=0)
    shut = 0
    for _ in range(24):
        _, reward, _, _, info = env.step(env.action_space.sample())
        slam, truth = env.get_wrapper_attr("slam"), env.get_wrapper_attr("frame").truth
        error, covariance = slam.pose_error(truth.position, truth.orientation)
        if error @ np.linalg.solve(covariance, error) > 14.449:  # chi-square, 6 degrees of freedom, 97.5 %
            shut += 1
            assert reward <= 0.0
        else:
            wanted = InformationCriterion(of="pose").potential(slam.pose.covariance)
            assert info["information_potential"] == pytest.approx(wanted, rel=1e-12)
    assert shut > 5


def test_a_consistent_filter_is_credited_by_the_gate_nearly_always():
    shares = []
    for seed in SEEDS:
        recording = small_recording(seed, frames=25)
        claimed, credited = gained(recording, HONEST)[1], gained(recording, HONEST, nees_gate=0.95)[1]
        shares.append(np.mean(np.isclose(claimed, credited, rtol=1e-9)))
    assert np.mean(shares) > 0.8


def test_claims_and_reference_can_be_told_side_by_side():
    recording = small_recording(frames=25)
    _, by_filter, infos = gained(recording, of="pose", report_both=True)
    _, by_reference, same = gained(recording, of="pose", belief="reference", report_both=True)
    for told in (infos, same):
        np.testing.assert_allclose([i["reward_information_claimed"] for i in told[1:]], by_filter, rtol=1e-9)
        np.testing.assert_allclose([i["reward_information_reference"] for i in told[1:]], by_reference, rtol=1e-9)
    assert {*infos[0]} == {*infos[1]}
    assert "reward_information_claimed" not in gained()[2][0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"criterion": "t"}, "criterion must be one of 'log-det'"),
        ({"of": "car"}, "of must be one of 'map', 'pose', got 'car'"),
        ({"belief": "truth"}, "belief must be one of 'filter', 'reference', got 'truth'"),
        ({"prior_sigma": -1.0}, "prior_sigma must be a finite number > 0"),
        ({"belief": "reference", "nees_gate": 0.95}, "nees_gate must be None with belief='reference'"),
        ({"nees_gate": 1.0}, "probability must be between 0 and 1"),
        ({"weight": np.nan}, "weight must be a finite number"),
        ({"max_age": -1}, "max_age must be a whole number >= 0, got -1"),
    ],
)
def test_arguments_are_checked_when_it_is_made(arguments, message):
    with pytest.raises(ValueError, match=message):
        InformationGain(BeliefObservation(ReplayEnv()), **arguments)


@pytest.mark.parametrize("arguments", [{}, {"belief": "reference", "report_both": True}])
def test_without_a_filter_in_the_loop_there_are_no_claims(arguments):
    with pytest.raises(ValueError, match="InformationGain needs 'slam': wrap BeliefObservation with it"):
        InformationGain(ReplayEnv(), **arguments)
