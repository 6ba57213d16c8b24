"""What a reader has to know besides the figures: the reference, and innovations far from the claim (1 s)."""

import re
from dataclasses import replace

import numpy as np
import pytest

from filters import StereoNoise
from stereo_slam_env.benchmark.statistics.remarks import innovation_remarks, motion_remarks, reference_remarks
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.recording.recording import SIMULATION, Reference

from ....synthetic_runs import THREE, make_runs, scored, summary_of
from ..small_recordings import small_recording

FROM_IMAGES = Reference("odometry", "Stereo odometry of the maker.")


def with_nis(ratio, dof=180):
    """The summary of a run of 20 frames whose NIS by its degrees of freedom is `ratio`."""
    (run,) = make_runs(THREE[:1], (0,), frames=20)
    dofs = np.where(run.nis_dof > 0, dof, 0)
    return summary_of([replace(run, nis=ratio * dofs, nis_dof=dofs)])


def test_a_reference_is_called_what_it_is():
    for truth, words in (
        (SIMULATION, "Reference: independent truth (simulation). Exact poses of the simulation."),
        (FROM_IMAGES, "Reference: odometry from the same images. Stereo odometry of the maker. .*there is no NEES.*"),
    ):
        runs = [replace(run, truth_from=truth) for run in make_runs(THREE, (0, 1), frames=20)]
        (said,) = reference_remarks(runs).values()
        assert re.fullmatch(words.replace("(", r"\(").replace(")", r"\)"), said)
    (said,) = reference_remarks(make_runs(frames=20, truth="none")).values()
    assert said.startswith("Reference: none.")


def test_of_several_references_each_names_its_recordings():
    runs = make_runs(THREE, (0, 1), frames=20)
    runs = [replace(run, truth_from=FROM_IMAGES if run.seed else SIMULATION) for run in runs]
    said = reference_remarks(runs)
    assert said[SIMULATION].startswith("Reference of drive-0: independent truth (simulation).")
    assert said[FROM_IMAGES].startswith("Reference of drive-1: odometry from the same images.")


def test_an_nis_within_a_factor_of_two_of_its_dof_gets_no_remark():
    assert innovation_remarks([with_nis(ratio) for ratio in (0.51, 0.9, 1.0, 1.2, 1.99)]) == []


@pytest.mark.parametrize(
    ("ratio", "size"),
    [
        (0.04, "5.0 times smaller"),
        (0.49, "1.4 times smaller"),
        (2.01, "1.4 times larger"),
        (14400.0, "120 times larger"),
    ],
)
def test_an_nis_far_from_its_dof_is_told_in_sigmas_with_its_cause(ratio, size):
    (said,) = innovation_remarks([with_nis(ratio)])
    cause = "normal where errors that last" if ratio < 1.0 else "perhaps too little noise is assumed"
    assert f"the innovations of inverse-depth are {size} than claimed: {cause}" in said


def test_an_nis_that_chance_explains_gets_no_remark():
    """One degree of freedom a frame, 19 frames: 95 % of consistent filters are between 0.47 and 1.73."""
    one = with_nis(0.48, dof=1)
    low, _ = one.consistency["nis"].band
    assert low < 0.48 < 0.5
    assert innovation_remarks([one]) == []
    assert innovation_remarks([with_nis(0.2, dof=1)])


def test_filters_are_named_together_and_the_farthest_is_told():
    ratios = {"a": 1.0, "b": 0.04, "c": 0.25, "d": 4.0, "e": 0.2}
    summaries = [replace(with_nis(ratio), filter_name=name) for name, ratio in ratios.items()]
    smaller, larger = innovation_remarks(summaries)
    assert "of b, c and e are up to 5.0 times smaller" in smaller
    assert "of d are 2.0 times larger" in larger


def test_a_real_filter_is_remarked_on_for_the_noise_it_assumes_wrongly_only():
    def said(sigma):
        noise = StereoNoise.independent_pixels(sigma)  # the true one is 1 px
        runs = [run_filter(small_recording(seed), "inverse-depth", noise=noise, seed=seed) for seed in range(5)]
        return " ".join(innovation_remarks(scored(runs)[0]))

    assert said(1.0) == ""
    assert "smaller than claimed: normal where errors that last" in said(8.0)
    assert "larger than claimed: perhaps too little noise" in said(0.1)


def moving(ratio, acceleration, name="one", motion=(3.0, 0.6)):
    """A run with this NIS, whose true velocities change by +- the acceleration, 10 Hz, and what it was told."""
    (run,) = make_runs(THREE[:1], (0,), frames=20)
    dofs = np.where(run.nis_dof > 0, 1800, 0)
    change = np.tile(np.where(np.arange(20) % 2, 0.5, -0.5), (3, 1)).T
    return replace(
        run,
        filter_name=name,
        nis=ratio * dofs,
        nis_dof=dofs,
        timestamps=0.1 * np.arange(20.0),
        true_linear_velocities=0.1 * acceleration * change,
        true_angular_velocities=0.01 * change,
        options={"motion": dict(zip(("sigma_acceleration", "sigma_angular_acceleration"), motion, strict=True))},
    )


def told(*runs):
    return motion_remarks(runs, [summary_of([run]) for run in runs])


def test_a_low_nis_is_explained_by_motion_that_is_gentler_than_assumed():
    (said,) = told(moving(0.95, 0.5), moving(0.97, 0.5, "two"))
    assert "gentler than the filters assume: 0.5 m/s² and 0.1" in said


@pytest.mark.parametrize(
    "runs",
    [
        [moving(0.95, 4.0)],  # the motion is as hard as assumed
        [moving(1.0, 0.5)],  # inside its band
        [moving(0.95, 0.5), moving(1.05, 0.5, "two")],  # not all filters of that motion
        [moving(0.95, 0.5, motion=(0.4, 0.6))],
        [replace(moving(0.95, 0.5), true_linear_velocities=np.full((20, 3), np.nan))],  # who knows
    ],
)
def test_a_low_nis_is_not_explained_by_what_is_not_so(runs):
    assert told(*runs) == []
