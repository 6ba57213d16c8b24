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
