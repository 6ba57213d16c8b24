"""Errors of measurements against known noise (1 s)."""

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from filters import StereoObservation
from stereo_slam_env.benchmark.scenarios.recording_description import (
    OUTLIER,
    error_correlation,
    measurement_errors,
    noise_by_range,
    noise_remarks,
)
from stereo_slam_env.report.console import show_noise

from ..small_recordings import small_recording

BIAS, SIGMA = np.array([0.1, -0.2, 0.3]), np.array([0.2, 0.1, 0.4])
CLAIMED = np.diag([0.25, 0.15, 0.5])


def noisy_recording(outliers=0.0):
    """Exact measurements of 40 points, but for a bias, Gaussian noise, and a share of outliers of 5 px in u."""
    rng = np.random.default_rng(4)
    exact = small_recording(frames=120, sigma=1e-9)
    frames = []
    for frame in exact.frames:
        seen = frame.observation
        error = BIAS + SIGMA * rng.standard_normal((len(seen), 3))
        error[rng.random(len(seen)) < outliers, 0] += 5.0
        R = np.tile(CLAIMED**2, (len(seen), 1, 1))
        frames.append(replace(frame, observation=StereoObservation(seen.ids, seen.uvd + error, R=R)))
    return replace(exact, frames=tuple(frames))


def test_bias_spread_and_claim_are_found():
    rows = noise_by_range(measurement_errors(noisy_recording()))
    everything = rows[-1]
    assert everything.count > 1000
    standard_error = SIGMA / np.sqrt(everything.count)
    assert (np.abs(everything.bias - BIAS) < 5 * standard_error).all()
    assert (np.abs(everything.sigma - SIGMA) < 5 * standard_error).all()
    np.testing.assert_allclose(everything.claimed, np.diag(CLAIMED))
    assert everything.outliers[:2] == (0.0, 0.0)


def test_claims_are_compared_with_errors():
    """Of errors without a bias: over claim is the ratio of deviations, NEES that of a mixture of chi2."""
    recording = noisy_recording()
    errors = measurement_errors(recording)
    centred = replace(errors, errors=errors.errors - BIAS)
    everything = noise_by_range(centred)[-1]
    np.testing.assert_allclose(everything.over_claim, SIGMA / np.sqrt(np.diag(CLAIMED**2)), rtol=0.1)
    true = replace(centred, R=np.tile(np.diag(SIGMA**2), (len(errors), 1, 1)))
    assert noise_by_range(true)[-1].nees == pytest.approx(1.0, abs=0.08)
    sure = replace(centred, R=true.R / 4.0)
    assert noise_by_range(sure)[-1].nees == pytest.approx(4.0 * noise_by_range(true)[-1].nees)
    nothing = noise_by_range(replace(centred, R=None))[-1]
    assert np.isnan([*nothing.claimed, *nothing.over_claim, nothing.nees]).all()
    assert nothing.sigma == everything.sigma


def test_pixels_that_define_the_truth_are_no_small_errors():
    """Half of the measurements have no error of u and v: the spread is that of the others, d is of all."""
    errors = measurement_errors(noisy_recording())
    defining = np.arange(len(errors)) % 2 == 0
    some = np.where(defining[:, None], errors.errors * [0.0, 0.0, 1.0], errors.errors)
    with_some = replace(errors, errors=some)
    np.testing.assert_array_equal(with_some.defines_truth, defining)
    without = replace(
        errors, **{name: getattr(errors, name)[~defining] for name in ("ids", "frames", "depths", "errors", "R")}
    )
    mixed, pure, before = (noise_by_range(one)[-1] for one in (with_some, without, errors))
    assert (mixed.bias[:2], mixed.sigma[:2], mixed.outliers[:2]) == (pure.bias[:2], pure.sigma[:2], pure.outliers[:2])
    assert (mixed.count, mixed.sigma[2]) == (before.count, before.sigma[2])
    assert any(
        f"{defining.sum()} of {len(errors)} are the first of their landmark" in line
        for line in noise_remarks(with_some)
    )
    matches = replace(errors, errors=errors.errors * [0.0, 0.0, 1.0])
    assert np.isnan(noise_by_range(matches)[-1].sigma[:2]).all()
    assert np.isnan(error_correlation(matches, 1)[:2]).all()
    assert np.isfinite(error_correlation(matches, 1)[2])


def test_a_gross_disparity_asks_for_the_scene():
    errors = measurement_errors(noisy_recording())
    assert noise_remarks(errors) == ()
    (remark,) = noise_remarks(replace(errors, errors=errors.errors + np.array([0.0, 0.0, 4.0])))
    assert remark.startswith("are these tracks of this scene and seed? the median error of d is 4.")
    unknown, doubt = noise_remarks(replace(measurement_errors(small_recording(frames=0)), measured=7))
    assert unknown.startswith("7 of 7 measurements have no known truth")
    assert doubt.endswith("no left pixel hits a surface")


def test_outliers_are_counted_and_do_not_spoil_the_spread():
    everything = noise_by_range(measurement_errors(noisy_recording(outliers=0.1)))[-1]
    assert everything.outliers[0] == pytest.approx(0.1, abs=0.03)
    assert everything.outliers[1] == 0.0
    assert everything.sigma[0] == pytest.approx(SIGMA[0], rel=0.2)


def test_ranges_part_the_measurements():
    recording = noisy_recording()
    found = measurement_errors(recording)
    *ranges, everything = noise_by_range(found)
    assert [(row.low, row.high) for row in ranges] == sorted({(row.low, row.high) for row in ranges})
    assert sum(row.count for row in ranges) == everything.count == len(found)
    for row in ranges:
        inside = (found.depths >= row.low) & (found.depths < row.high)
        assert row.count == inside.sum()
        np.testing.assert_allclose(row.bias, np.median(found.errors[inside], axis=0))


def test_only_what_is_known_is_judged():
    recording = noisy_recording()
    some = replace(recording.landmarks, ids=recording.landmarks.ids[:7], positions=recording.landmarks.positions[:7])
    found = measurement_errors(replace(recording, landmarks=some))
    expected = sum(np.isin(frame.observation.ids, some.ids).sum() for frame in recording.frames)
    assert len(found) == expected > 0
    blind = replace(recording, frames=tuple(replace(frame, truth=None) for frame in recording.frames))
    assert noise_by_range(measurement_errors(blind)) == ()
    assert np.isnan(error_correlation(measurement_errors(blind), 1)).all()
    with pytest.raises(ValueError, match="recording 'small' has no true landmarks: its errors cannot be known"):
        measurement_errors(replace(recording, landmarks=None))


def test_errors_that_last_are_told_from_white_ones():
    """First-order autoregressive errors in u, white ones in v, constant ones in d."""
    rng = np.random.default_rng(5)
    exact = small_recording(frames=200, sigma=1e-9)
    count = len(exact.landmarks.ids)
    lasting, constant = 0.2 * rng.standard_normal((2, count))
    frames = []
    for frame in exact.frames:
        lasting = 0.9 * lasting + 0.2 * np.sqrt(1.0 - 0.9**2) * rng.standard_normal(count)
        error = np.column_stack([lasting, 0.2 * rng.standard_normal(count), constant])
        seen = frame.observation
        known = error[np.searchsorted(exact.landmarks.ids, seen.ids)]
        frames.append(replace(frame, observation=StereoObservation(seen.ids, seen.uvd + known)))
    found = measurement_errors(replace(exact, frames=tuple(frames)))
    for lag in (1, 5):
        np.testing.assert_allclose(error_correlation(found, lag), [0.9**lag, 0.0, 1.0], atol=0.06)


@pytest.mark.parametrize("width", [80, 120])
def test_the_table_is_readable_in_a_terminal(width, capsys):
    found = measurement_errors(noisy_recording(outliers=0.1))
    rows = noise_by_range(found)
    show_noise(Console(width=width), "small", found)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    first = [line.split() for line in lines if line.strip().startswith("all")]
    assert len(first) == 1
    assert first[0][1:4] == [str(rows[-1].count), "u", f"{rows[-1].bias[0]:+.3f}"]
    assert sum(f" {coordinate} " in line for line in lines for coordinate in "uvd") == 3 * len(rows)
    assert f"beyond {OUTLIER:g} px" in lines[1]


def test_a_table_of_nothing_says_so(capsys):
    none = measurement_errors(small_recording(frames=0))
    show_noise(Console(width=80), "small", none)
    assert "none of them has a known truth" in capsys.readouterr().out
