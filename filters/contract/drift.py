"""Landmark drift: process noise of landmarks, for tracked points that walk on the surface they were found on.

A tracker follows a patch, and what it follows changes from frame to frame: its errors last. A filter with white noise
alone averages them away on paper and becomes too sure. Here every landmark that is measured moves a little before,
with a covariance given in the image, where it is known. It is carried back to the landmark's own numbers by the
Jacobian of (u, v, d).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from filters.contract.validation import positive
from filters.geometry.arrays import FloatArray


@dataclass(frozen=True)
class LandmarkDrift:
    """Random walk of a measured landmark in the image, a frame.

    Parameters
    ----------
    share : float
        Standard deviation of a step as a share of that of the measurement: Q = share^2 R. For measurements that bring
        their own R. A share of sqrt(2 (1 - r)) stands for errors with correlation r from frame to frame.
    pixels : (3,) floats, optional
        Standard deviations of a step in u, v and d, px, added to the share.
    gate_pixels : (3,) floats, optional
        The same for the gate and the joint test, at most `pixels`: most points take short steps, and a gate for the
        long ones lets outliers in. None: as `pixels`.

    Raises
    ------
    ValueError
        A number is negative or not finite, or a step of the gate is longer than that of the drift.
    """

    share: float = 0.0
    pixels: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gate_pixels: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        positive("share of drift", self.share, allow_zero=True)
        for name in ("pixels", "gate_pixels"):
            given = getattr(self, name)
            if given is None:
                continue
            steps = np.asarray(given, dtype=np.float64)
            if steps.shape != (3,) or not (np.isfinite(steps).all() and (steps >= 0.0).all()):
                raise ValueError(f"{name} of drift must be 3 finite numbers of px >= 0 (u, v, d), got {given!r}")
            object.__setattr__(self, name, tuple(steps.tolist()))
        if self.gate_pixels is not None and any(g > p for g, p in zip(self.gate_pixels, self.pixels, strict=True)):
            raise ValueError(f"gate_pixels of drift must be at most pixels {self.pixels}, got {self.gate_pixels}")

    @classmethod
    def of(cls, given: LandmarkDrift | Mapping[str, Any] | float | None) -> LandmarkDrift | None:
        """Drift from itself, a table of its numbers or a share; None stays None.

        Raises
        ------
        ValueError
            It is something else, or a number is impossible.
        """
        if given is None or isinstance(given, cls):
            return given
        if isinstance(given, Mapping):
            unknown = sorted(set(given) - {"share", "pixels", "gate_pixels"})
            if unknown:
                raise ValueError(f"drift must have no key but share, pixels and gate_pixels, got {', '.join(unknown)}")
            return cls(**given)
        if isinstance(given, bool) or not isinstance(given, int | float):
            raise ValueError(
                f"drift must be a share of the noise, a table of share, pixels and gate_pixels, or None, got {given!r}"
            )
        return cls(share=float(given))

    @property
    def parts(self) -> FloatArray:
        """Factor of R and variances in u, v, d: of the step for the gate, and of the rest of the step; (2, 4)."""
        whole = np.square(self.pixels)
        gate = whole if self.gate_pixels is None else np.square(self.gate_pixels)
        return np.array([[self.share**2, *gate], [0.0, *(whole - gate)]])
