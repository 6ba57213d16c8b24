"""Measurements of an inertial unit, cut into the steps between frames, and samples of adjacent steps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from filters import InertialSamples, InertialUnit
from filters.geometry.arrays import FloatArray

_GAP = 5.0
"""Times the usual distance of two samples: a longer one is a gap."""
_ONE_G = (0.8, 1.2)
"""Mean specific forces that say that their unit is g."""
FASTEST_TURN = 20.0
"""No camera turns faster and sees anything, rad/s."""
_MOSTLY = 99.0
"""Percentile of the rates: a single one may be a fault."""
_SAME = 5e-9
"""Of two times, s: as far apart as rounding to nanoseconds moves them."""


def samples_of_steps(
    path: Path, times: FloatArray, numbers: FloatArray, frames: FloatArray, unit: InertialUnit
) -> list[InertialSamples | None]:
    """Samples of the step to each frame from the one before; None for the first, and where a step is not covered.

    A row stands for the time around its stamp, to half way to its neighbours, the first and the last for a period: what
    a unit has averaged over a period is stamped in its middle, and what it has not is as well taken so as by straight
    lines. Noise of the samples is then independent, as filters take it, which that of means between two rows is not.

    Parameters
    ----------
    path : Path
        Of the table, for messages.
    times : (N,) ndarray
        Of the rows, s, ascending.
    numbers : (N, 6) ndarray
        Angular rates, rad/s, and specific forces, m/s^2, in the frame of the unit.
    frames : (K,) ndarray
        Times of the frames, s, on the same clock; NaN where one is not known.
    unit : InertialUnit
        That measured them.

    Raises
    ------
    ValueError
        There are less than two rows, their times do not ascend, or the numbers are those of other units.
    """
    if len(times) < 2 or not (np.diff(times) > 0.0).all():
        raise ValueError(f"{path} must have two rows or more with increasing times: copy it again")
    _require_units(path, numbers)
    apart, of_frames = float(np.median(np.diff(times))), np.diff(frames[np.isfinite(frames)])
    if of_frames.size and apart > _GAP * (step := float(np.median(of_frames))):
        message = f"its rows are {apart:.3g} s apart, the frames {step:.3g} s: are its times of another unit?"
        raise ValueError(f"{path}: {message} Write those of both in one")
    steps: list[InertialSamples | None] = [None]
    middles = 0.5 * (times[1:] + times[:-1])
    ends = np.concatenate([[times[0] - apart], middles, [times[-1] + apart]])
    longest = _GAP * apart
    for begin, end in pairwise(frames.tolist()):
        before, after = np.searchsorted(times, [begin + _SAME, end - _SAME])
        covered = ends[0] - _SAME <= begin < end <= ends[-1] + _SAME
        if not covered or np.diff(times[max(before - 1, 0) : after + 1]).max(initial=0.0) > longest:
            steps.append(None)
            continue
        first, last = np.searchsorted(ends, [begin + _SAME, end - _SAME])
        rows = numbers[first - 1 : last]
        steps.append(InertialSamples(np.append(ends[first:last], end) - begin, rows[:, :3], rows[:, 3:], unit))
    return steps


class InertialRows:
    """Rows of a table that `samples_of_steps` reads as the samples of steps, which come one by one.

    A sample stands for a period, a row for the time half way to its neighbours: so the stamps of two rows lie as far
    before as behind the end of the period between them. A period that a frame has cut in two is one row.
    """

    def __init__(self) -> None:
        self._values: list[FloatArray] = []  # of periods that have no row yet
        self._ends: list[int] = []  # their begins and ends, ns
        self._stamp: int | None = None  # of the last row

    def of_step(self, begin: int, samples: InertialSamples | None) -> list[tuple[int, FloatArray]]:
        """Stamps, ns, and numbers (6,) of the rows that are known once the step from `begin`, ns, has come."""
        if samples is None:
            return self.rest()
        ends = begin + np.round(1e9 * samples.times).astype(np.int64)
        values = list(np.hstack([samples.angular_rates, samples.specific_forces]))
        rows = [] if self._ends and abs(self._ends[-1] - begin) <= 1 else self.rest()
        if not self._ends:
            self._ends = [begin]
        usual = int(np.median(np.diff(ends, prepend=begin)))
        if self._values and (self._values[-1] == values[0]).all() and ends[0] - self._ends[-2] < 1.5 * usual:
            self._values.pop()
            self._ends.pop()
        self._values += values
        self._ends += ends.tolist()
        return [*rows, *self._rows(keep=1)]

    def rest(self) -> list[tuple[int, FloatArray]]:
        """The rows that are left; the next one begins anew, as after a gap."""
        rows = self._rows(keep=0)
        self._values, self._ends, self._stamp = [], [], None
        return rows

    def _rows(self, keep: int) -> list[tuple[int, FloatArray]]:
        """The rows of all periods but the last ones, which may go on in the next step."""
        rows = []
        while len(self._values) > keep:
            begin, end = self._ends[:2]
            if self._stamp is not None:
                self._stamp = 2 * begin - self._stamp
            elif len(self._values) > 1:  # the first may be cut by the frame, the second is whole
                self._stamp = 2 * end - (end + self._ends[2]) // 2
            else:
                self._stamp = (begin + end) // 2
            if not begin < self._stamp < end:  # periods that no rows have
                self._stamp = (begin + end) // 2
            rows.append((self._stamp, self._values.pop(0)))
            self._ends.pop(0)
        return rows


def _require_units(path: Path, numbers: FloatArray) -> None:
    """Refuse rates and forces (N, 6) whose sizes are those of degrees per second and of g."""
    rates, forces = np.linalg.norm(numbers[:, :3], axis=1), np.linalg.norm(numbers[:, 3:], axis=1)
    mean, fast = float(np.mean(forces)), float(np.percentile(rates, _MOSTLY))
    for scale, unit in ((1.0, "g"), (1e3, "mg")):
        if _ONE_G[0] <= mean / scale <= _ONE_G[1]:
            raise ValueError(
                f"{path}: the mean specific force is {mean:.4g} where m/s^2 are expected, is it in {unit}? "
                f"Multiply it by {9.80665 / scale:.5g}"
            )
    if fast > FASTEST_TURN:
        raise ValueError(
            f"{path}: angular rates reach {fast:.4g} where rad/s are expected, are they in degrees per second? "
            "Multiply them by 0.0174533"
        )


def joined(steps: Sequence[InertialSamples | None], durations: FloatArray) -> InertialSamples | None:
    """Samples of adjacent steps of these lengths (N,), s, as those of one step; None where a step has none."""
    one, elapsed = steps[0], 0.0
    for step, before in zip(steps[1:], durations.tolist(), strict=False):
        elapsed += before
        one = None if one is None or step is None else one.followed_by(step, elapsed)
    return one
