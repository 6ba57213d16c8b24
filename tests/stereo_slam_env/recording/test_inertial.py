"""Inertial samples that are cut out of a table: periods of the rows, gaps, joined steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from filters import InertialUnit
from stereo_slam_env.recording.inertial import joined, samples_of_steps

UNIT = InertialUnit(np.zeros(3), (0.0, 0.0, 0.0, 1.0), 1e-4, 1e-3, 1e-5, 1e-4)
TIMES = 0.013 * np.arange(60)
FRAMES = np.array([0.05, 0.151, 0.2505, 0.35])
FILE = Path("table.csv")


def ramp(t: np.ndarray) -> np.ndarray:
    """What changes linearly: its mean over an interval is that of the ends."""
    return np.outer(t, np.arange(1.0, 7.0)) + np.arange(6.0)


def test_a_row_stands_for_the_time_around_its_stamp() -> None:
    none, *steps = samples_of_steps(FILE, TIMES, ramp(TIMES), FRAMES, UNIT)
    assert none is None
    for begin, end, step in zip(FRAMES, FRAMES[1:], steps, strict=False):
        assert step is not None
        edges = begin + np.concatenate([[0.0], step.times])
        assert edges[-1] == pytest.approx(end, abs=1e-12)
        halves = TIMES + 0.0065
        np.testing.assert_array_equal(edges[1:-1].round(9), halves[(begin < halves) & (end > halves)].round(9))
        nearest = ramp(0.013 * np.round(0.5 * (edges[1:] + edges[:-1]) / 0.013))
        np.testing.assert_allclose(np.hstack([step.angular_rates, step.specific_forces]), nearest, atol=1e-12)
        step.check_step(end - begin)


def test_means_that_are_stamped_in_the_middle_of_their_periods_are_the_samples() -> None:
    stamps = np.round((np.arange(60) + 0.5) / 200.0, 9)  # of 20 periods a frame
    steps = samples_of_steps(FILE, stamps, ramp(stamps), np.round(0.1 * np.arange(4), 9), UNIT)[1:]
    for k, step in enumerate(steps):
        assert step is not None
        np.testing.assert_allclose(step.times, np.arange(1, 21) / 200.0, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(step.angular_rates, ramp(stamps)[20 * k : 20 * k + 20, :3])


def test_a_step_that_is_not_covered_has_no_samples() -> None:
    early, late = samples_of_steps(FILE, TIMES, ramp(TIMES), np.array([-0.05, 0.05, 0.15]), UNIT)[1:]
    assert early is None
    assert late is not None
    kept = (TIMES < 0.2) | (TIMES > 0.3)  # 8 samples are lost
    steps = samples_of_steps(FILE, TIMES[kept], ramp(TIMES[kept]), FRAMES, UNIT)
    assert [step is not None for step in steps] == [False, True, False, False]
    assert samples_of_steps(FILE, TIMES, ramp(TIMES), np.array([0.1, np.nan, 0.3]), UNIT) == [None, None, None]


def test_joined_steps_are_one_step() -> None:
    steps = samples_of_steps(FILE, TIMES, ramp(TIMES), FRAMES, UNIT)[1:]
    one = joined(steps, np.diff(FRAMES))
    assert one is not None
    (whole,) = samples_of_steps(FILE, TIMES, ramp(TIMES), FRAMES[[0, -1]], UNIT)[1:]
    assert whole is not None
    total = [np.diff(s.times, prepend=0.0) @ s.specific_forces for s in (one, whole)]
    np.testing.assert_allclose(*total, atol=1e-12)
    assert joined([steps[0], None, steps[2]], np.diff(FRAMES)) is None


def test_a_table_in_disorder_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"^table.csv must have two rows or more with increasing times: copy it again$"
    ):
        samples_of_steps(FILE, TIMES[::-1], ramp(TIMES), FRAMES, UNIT)


@pytest.mark.parametrize("scale", [100.0, 1e3, 1e6])
def test_rows_much_farther_apart_than_the_frames_are_of_another_unit(scale: float) -> None:
    with pytest.raises(ValueError, match=r"^table.csv: its rows are .* s apart, the frames 0.0995 s: are its times of"):
        samples_of_steps(FILE, scale * TIMES, ramp(TIMES), FRAMES, UNIT)
