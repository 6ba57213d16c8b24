"""States of an inertial odometry beside its pose: velocity and biases, with the covariance that is claimed for them.

Columns of text files that hold them, by name: `vx` to `vz`, `bgx` to `bgz`, `bax` to `baz`, or as EuRoC names them; the
standard deviations of each behind `sigma_`, as in `sigma_vx`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from filters.contract.validation import require_known
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray

UNITS_OF = {"velocity": "m/s", "gyro-bias": "rad/s", "accelerometer-bias": "m/s²"}
"""The states and their units: the velocity of the body in W; biases, measured less true, along the body's axes."""
_COLUMNS = {"velocity": "v", "gyro-bias": "bg", "accelerometer-bias": "ba"}
_PATTERNS = {
    "v": r"(v|vel|velocity)_?{0}|v_rs_r_{0}",
    "bg": r"(b_?g|b_?w|gyro_?bias)_?{0}|b_w_rs_s_{0}",
    "ba": r"(b_?a|acc(el|elerometer)?_?bias)_?{0}|b_a_rs_s_{0}",
}
STATE_NAMES = {f"{kind}{a}": how.format(a) for kind, how in _PATTERNS.items() for a in "xyz"}
STATE_NAMES |= {f"sigma_{name}": rf"(sigma|std)_?({how})" for name, how in STATE_NAMES.items()}
"""Names of columns of states, as patterns, in small letters and without units."""
STATE_COLUMNS = [f"{kind}{a}" for kind in _PATTERNS for a in "xyz"]
"""The nine columns in the order of EuRoC and OpenVINS."""


@dataclass(frozen=True, eq=False)
class StateBelief:
    """A state of three numbers over K poses."""

    values: FloatArray
    """(K, 3), in the units of `UNITS_OF`; NaN where it is not known."""
    covariances: FloatArray | None = None
    """(K, 3, 3), of the true value less this one. None: nothing is claimed."""

    def rows(self, index: BoolArray | IntArray | slice) -> StateBelief:
        """The belief at some poses, by number or mask."""
        return StateBelief(self.values[index], None if self.covariances is None else self.covariances[index])

    def turned(self, R: FloatArray) -> StateBelief:
        """The belief along other axes, or of another scale: R (3, 3) times each value."""
        P = self.covariances
        return StateBelief(rotations.turned(R, self.values), None if P is None else R @ P @ R.T)


def require_states(states: Mapping[str, StateBelief], count: int) -> None:
    """Raise a `ValueError` unless these are states of `count` poses."""
    require_known("states has no", list(states), UNITS_OF)
    for name, belief in states.items():
        if belief.values.shape != (count, 3):
            raise ValueError(f"states[{name!r}].values must have the shape ({count}, 3), got {belief.values.shape}")
        if belief.covariances is not None and belief.covariances.shape != (count, 3, 3):
            raise ValueError(
                f"states[{name!r}].covariances must have the shape ({count}, 3, 3), got {belief.covariances.shape}"
            )


def states_of(values: Mapping[str, FloatArray]) -> tuple[dict[str, StateBelief], list[str]]:
    """States of columns (K,) by the names of `STATE_NAMES`, and notes; zeros throughout fill a place and are none."""
    states: dict[str, StateBelief] = {}
    notes = []
    for name, kind in _COLUMNS.items():
        columns = [f"{kind}{a}" for a in "xyz"]
        if not all(column in values for column in columns):
            continue
        numbers = np.stack([values[column] for column in columns], axis=1)
        if not np.nan_to_num(numbers).any():
            notes.append(f"its {name} is zero throughout, which fills a place: not read")
            continue
        covariances = None
        if all(f"sigma_{column}" in values for column in columns):
            sigmas = np.stack([values[f"sigma_{column}"] for column in columns], axis=1)
            covariances = sigmas[:, :, None] ** 2 * np.eye(3)
        states[name] = StateBelief(numbers, covariances)
    return states, notes
