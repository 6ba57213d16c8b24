"""Times in files of others: their unit, by size where none is stated, and the stamps of messages of a log."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from filters.geometry.arrays import BoolArray, FloatArray, IntArray

UNITS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
"""Units of time by their names, s."""
BY_SIZE = ((1e17, 1e-9, "nanoseconds"), (1e14, 1e-6, "microseconds"), (1e11, 1e-3, "milliseconds"))
"""Times since 1970 from so many on are in that unit: in the next larger one they would be 3000 years away or more."""
SLOWEST, FASTEST = 0.1, 1000.0
"""Hz, of anything that moves with a camera: others are a mistaken unit."""
_NEIGHBOURS = 11
"""Messages whose median stamp says where that of the middle one should be ..."""
_ASTRAY_S, _ASTRAY_STEPS = 1.0, 20.0
"""... and by how much, the larger of the two, it may be away."""


def seconds_of(numbers: FloatArray | IntArray, what: str, unit: str = "") -> tuple[FloatArray, list[str]]:
    """Times (K,) in s of numbers in a stated unit of `UNITS`, or in the one that their size says; and notes.

    Raises
    ------
    ValueError
        Their rate is none of a camera's: one line that opens with `what` and says the likely unit.
    """
    stated = UNITS.get(unit)
    scale, notes = scale_of(numbers) if stated is None else (stated, [])
    times = np.asarray(numbers, dtype=np.float64) * scale
    require_rate(times, what)
    return times, notes


def scale_of(numbers: FloatArray | IntArray) -> tuple[float, list[str]]:
    """Unit of times (K,), s, by their size, and a note where it is another than the second."""
    middle = float(np.median(np.abs(numbers))) if len(numbers) else 0.0
    for least, scale, name in BY_SIZE:
        if middle >= least:
            return scale, [f"its times, of the size of {middle:.0e}, are read as {name}"]
    return 1.0, []


def require_rate(times: FloatArray, what: str) -> None:
    """Raise a `ValueError` where times (K,), s, in the usual case are closer or farther apart than a camera's can be.

    Times that repeat or descend are not looked at: who reads them says what is wrong.
    """
    steps = np.diff(times)
    steps = steps[steps > 0.0]
    if not steps.size:
        return
    step = float(np.median(steps))
    if 0.999 / FASTEST <= step <= 1.001 / SLOWEST:
        return
    likely = [
        f"as {name} they would be at {1.0 / (step * unit):.3g} Hz"
        for unit, name in (
            *((1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")),
            *((1e3, "times of a unit 1000 times as long"), (1e6, "times of a unit a million times as long")),
        )
        if 1.0 <= 1.0 / (step * unit) <= 500.0
    ]
    raise ValueError(
        f"{what}: its times are {step:.3g} s apart, at {1.0 / step:.3g} Hz, where {SLOWEST:g} to {FASTEST:g} Hz are "
        f"read: {likely[0] + ', so ' if likely else ''}write them in seconds"
    )


def message_times(stamps: IntArray, logged: IntArray) -> tuple[IntArray, BoolArray, list[str]]:
    """Times (K,) of messages in the order of their log, which of them are to be read, and notes.

    Parameters
    ----------
    stamps, logged : (K,) ints
        Stamps in the headers and times of the log, ns. Stamps that are all the same, or zero, are no clock, and the log
        takes their place; single ones far from those before and after are left out.
    """
    count = len(stamps)
    kept = np.ones(count, dtype=bool)
    if count > 1 and (2 * len(np.unique(stamps)) < count or 2 * np.count_nonzero(stamps == 0) > count):
        why = "zero" if 2 * np.count_nonzero(stamps == 0) > count else "repeated"
        return logged, kept, [f"its stamps are {why} in most messages: the times of the log are taken"]
    if count < _NEIGHBOURS:
        return stamps, kept, []
    seconds = 1e-9 * (stamps - np.median(stamps).astype(np.int64))
    away = np.abs(seconds - median_filter(seconds, size=_NEIGHBOURS, mode="mirror"))
    in_order = seconds >= np.maximum.accumulate(seconds)
    in_order &= seconds <= np.minimum.accumulate(seconds[::-1])[::-1]
    limit = max(_ASTRAY_S, _ASTRAY_STEPS * float(np.median(np.abs(np.diff(seconds)))))
    kept = in_order | (away <= limit)
    kept[[0, -1]] &= np.abs(seconds[[0, -1]] - seconds[[1, -2]]) <= limit  # one alone is in any order
    if (stamps == 0).any() and 1e-9 * float(stamps[stamps != 0].min()) > limit:
        kept &= stamps != 0  # no times, beside others that are
        away = np.where(stamps == 0, 1e-9 * np.median(stamps), away)
    if kept.all():
        return stamps, kept, []
    worst = float(away[~kept].max())
    return (
        stamps,
        kept,
        [f"{np.count_nonzero(~kept)} of {count} stamps are up to {worst:.3g} s from those before and after: left out"],
    )
