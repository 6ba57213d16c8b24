"""A run in a batch is the run by itself, to the bit, but for what is timed (8 s)."""

import dataclasses

import numpy as np
import pytest

from filters import ColouredNoise, LandmarkDrift, StereoEKF, StereoNoise
from stereo_slam_env.evaluation.batch_run import run_batch
from stereo_slam_env.evaluation.filter_run import AT_ONCE, run_filter
from stereo_slam_env.evaluation.results import ContractBroken
from stereo_slam_env.evaluation.run_figures import score_of
from stereo_slam_env.recording.recording import Reference

from ..benchmark.small_recordings import small_recording

TIMED = {"milliseconds", "predict_milliseconds", "update_milliseconds", "memory_mb"}
TIMED_FIGURES = {"ms_per_frame", "ms_predict", "ms_update", "ms_95", "memory_mb"}
MOTION = {"motion": {"sigma_acceleration": 3.0, "sigma_angular_acceleration": 0.6}, "gate": None}


def in_a_batch(recordings, name, options=None, *, odometry=True, score_map=True, noises=None, common=MOTION):
    return run_batch(
        recordings,
        name,
        options or {},
        label=name,
        common_options=common,
        noises=noises or [one.noise for one in recordings],
        use_odometry=odometry,
        score_map=score_map,
        seeds=range(len(recordings)),
        progress=lambda done, of: None,
    )


def alone(recordings, name, options=None, *, odometry=True, score_map=True, noises=None, common=MOTION):
    return [
        run_filter(
            one,
            name,
            options,
            common_options=common,
            noise=None if noises is None else noises[seed],
            use_odometry=odometry,
            score_map=score_map,
            seed=seed,
        )
        for seed, one in enumerate(recordings)
    ]


def plain(value):
    """What can be compared: numbers to the bit, NaN included."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if dataclasses.is_dataclass(value):
        own = (f.name for f in dataclasses.fields(value) if f.name not in {*TIMED, "final_map"})
        return {name: plain(getattr(value, name)) for name in own}
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    return {key: plain(item) for key, item in value.items()} if isinstance(value, dict) else repr(value)


def assert_same(batch, single):
    assert len(batch) == len(single)
    for run, other in zip(batch, single, strict=True):
        assert np.isnan(run.milliseconds).all()
        assert plain(run) == plain(other)
        scores = [score_of(each, divergence_percent=5.0).figures for each in (run, other)]
        figures = [{name: value for name, value in of.items() if name not in TIMED_FIGURES} for of in scores]
        assert plain(figures[0]) == plain(figures[1])


@pytest.mark.parametrize("odometry", [True, False])
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("inverse-depth", {}),
        ("dual-bearing", {}),
        ("euclidean", {"min_disparity": 4.0}),
        ("shared-anchor", {"gate": 0.99, "consensus": True}),
        ("inverse-depth", {"error": "right-invariant", "iterations": 2}),
    ],
)
def test_a_batch_has_the_bits_of_single_runs(name, options, odometry):
    """Drives of different lengths, longer and shorter than what is scored at once."""
    recordings = [small_recording(seed, frames) for seed, frames in enumerate((AT_ONCE + 7, 15, AT_ONCE + 1))]
    settings = {"odometry": odometry, "noises": [StereoNoise.independent_pixels(s) for s in (1.0, 1.5, 0.8)]}
    assert_same(in_a_batch(recordings, name, options, **settings), alone(recordings, name, options, **settings))


def test_without_a_truth_that_counts_and_without_the_map():
    from_images = dataclasses.replace(small_recording(), truth_from=Reference("odometry", "By hand."))
    recordings = [small_recording(0, truth=False), from_images]
    settings = {"score_map": False}
    found = in_a_batch(recordings, "inverse-depth", **settings)
    assert_same(found, alone(recordings, "inverse-depth", **settings))


def test_a_run_that_breaks_the_contract_ends_as_alone_and_the_others_go_on(monkeypatch):
    """The second filter is told that its pixels are poor; so large a covariance is taken here for none."""
    limit = 2e-3  # m^2: the others stay below .0008

    def refuse_large(first, beliefs):
        large = np.flatnonzero(beliefs.pose[:, 0, 0] > limit)
        if len(large):
            raise ContractBroken(first + int(large[0]), "its covariance is large")

    monkeypatch.setattr("stereo_slam_env.evaluation.filter_run.check_beliefs", refuse_large)
    recordings = [small_recording(seed, 2 * AT_ONCE) for seed in range(3)]
    noises = [StereoNoise.independent_pixels(s) for s in (1.0, 30.0, 1.0)]
    batch, single = (f(recordings, "inverse-depth", noises=noises) for f in (in_a_batch, alone))
    assert [run.failure is None for run in single] == [True, False, True]
    assert "its covariance is large" in single[1].failure
    assert_same(batch, single)


def test_what_does_not_go_in_a_batch_is_left_to_others():
    recordings = [small_recording(seed) for seed in range(2)]
    assert in_a_batch(recordings, "dead-reckoning") is None
    uncertain = dataclasses.replace(
        recordings[1], truth_from=Reference("surveyed", "a tachymeter", position_jitter=0.01)
    )
    assert in_a_batch([recordings[0], uncertain], "inverse-depth") is None
    smaller = dataclasses.replace(recordings[1].camera, baseline=0.3)
    other_rig = dataclasses.replace(recordings[1], camera=smaller)
    assert in_a_batch([recordings[0], other_rig], "inverse-depth") is None

    class Louder(StereoEKF):
        def update(self, observation):
            return super().update(observation)

    assert in_a_batch(recordings, Louder) is None


def test_filters_that_take_other_drifts_from_their_noise_cannot_run_together():
    recordings = [small_recording(seed, 15) for seed in range(2)]
    R = recordings[0].noise.R
    noises = [ColouredNoise(R, 0.5 * R, LandmarkDrift(share=share)) for share in (0.1, 0.1, 0.2)]
    assert in_a_batch(recordings, "coloured-noise", noises=noises[1:]) is None
    together, each = (run(recordings, "coloured-noise", noises=noises[:2]) for run in (in_a_batch, alone))
    assert_same(together, each)
