"""Errors of measurements against known noise (1 s)."""

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from filters import StereoObservation
from stereo_slam_env.benchmark.scenarios.streams import OUTLIER, measurement_errors, noise_by_range
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
    rows = noise_by_range(noisy_recording())
    everything = rows[-1]
    assert everything.count > 1000
    standard_error = SIGMA / np.sqrt(everything.count)
    assert (np.abs(everything.bias - BIAS) < 5 * standard_error).all()
    assert (np.abs(everything.sigma - SIGMA) < 5 * standard_error).all()
    np.testing.assert_allclose(everything.claimed, np.diag(CLAIMED))
    assert everything.outliers[:2] == (0.0, 0.0)


def test_outliers_are_counted_and_do_not_spoil_the_spread():
    everything = noise_by_range(noisy_recording(outliers=0.1))[-1]
    assert everything.outliers[0] == pytest.approx(0.1, abs=0.03)
    assert everything.outliers[1] == 0.0
    assert everything.sigma[0] == pytest.approx(SIGMA[0], rel=0.2)


def test_ranges_part_the_measurements():
    recording = noisy_recording()
    depths, errors, _ = measurement_errors(recording)
    *ranges, everything = noise_by_range(recording)
    assert [(row.low, row.high) for row in ranges] == sorted({(row.low, row.high) for row in ranges})
    assert sum(row.count for row in ranges) == everything.count == len(depths)
    for row in ranges:
        inside = (depths >= row.low) & (depths < row.high)
        assert row.count == inside.sum()
        np.testing.assert_allclose(row.bias, np.median(errors[inside], axis=0))


def test_only_what_is_known_is_judged():
    recording = noisy_recording()
    some = replace(recording.landmarks, ids=recording.landmarks.ids[:7], positions=recording.landmarks.positions[:7])
    depths, _, _ = measurement_errors(replace(recording, landmarks=some))
    expected = sum(np.isin(frame.observation.ids, some.ids).sum() for frame in recording.frames)
    assert len(depths) == expected > 0
    blind = replace(recording, frames=tuple(replace(frame, truth=None) for frame in recording.frames))
    assert noise_by_range(blind) == ()
    with pytest.raises(ValueError, match="recording 'small' has no true landmarks: its errors cannot be known"):
        measurement_errors(replace(recording, landmarks=None))


@pytest.mark.parametrize("width", [80, 120])
def test_the_table_is_readable_in_a_terminal(width, capsys):
    rows = noise_by_range(noisy_recording(outliers=0.1))
    show_noise(Console(width=width), "small", rows)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    first = [line.split() for line in lines if line.strip().startswith("all")]
    assert len(first) == 1
    assert first[0][1:4] == [str(rows[-1].count), "u", f"{rows[-1].bias[0]:+.3f}"]
    assert sum(f" {coordinate} " in line for line in lines for coordinate in "uvd") == 3 * len(rows)
    assert f"beyond {OUTLIER:g} px" in lines[2]


def test_a_table_of_nothing_says_so(capsys):
    show_noise(Console(width=80), "small", ())
    assert "none of them has a known truth" in capsys.readouterr().out
