"""Errors of stereo measurements (u, v, d): their covariance, what of them lasts, and the drift of tracked landmarks.

A tracker follows a patch, and what it follows changes from frame to frame: its errors last. A filter with white noise
alone averages them away on paper and becomes too sure. With a `LandmarkDrift` every landmark that is measured moves a
little before, with a covariance given in the image, where it is known, which the Jacobian of (u, v, d) carries back to
the landmark's own numbers.

Derivation: docs/derivations/camera.md, docs/derivations/drift.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from filters.contract.validation import at_most, covariance_matrix, positive
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
            value = getattr(self, name)
            if value is None:
                continue
            steps = np.asarray(value, dtype=np.float64)
            if steps.shape != (3,) or not (np.isfinite(steps).all() and (steps >= 0.0).all()):
                raise ValueError(f"{name} of drift must be 3 finite numbers of px >= 0 (u, v, d), got {value!r}")
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
        total_variance = np.square(self.pixels)
        gate = total_variance if self.gate_pixels is None else np.square(self.gate_pixels)
        return np.array([[self.share**2, *gate], [0.0, *(total_variance - gate)]])


LARGEST_VARIANCE = 1e18
"""Of a measurement, px^2: up to it filters are tested."""


@dataclass(frozen=True, eq=False)
class StereoNoise:
    """Covariance R of (u, v, d), px^2.

    Parameters
    ----------
    R : (3, 3) array_like
        Symmetric positive definite.

    Raises
    ------
    ValueError
        R is not a finite symmetric positive definite 3x3 matrix, or above 1e18 px^2.
    """

    R: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "R", covariance_matrix("R", self.R, 3, definite=True))
        at_most("R", self.R, LARGEST_VARIANCE, "px^2")

    @classmethod
    def diagonal(cls, sigma_u: float, sigma_v: float, sigma_d: float) -> StereoNoise:
        """The paper's R: u, v and d independent (page of Eq. 25); standard deviations in px."""
        sigmas = [
            positive(n, s) for n, s in zip(("sigma_u", "sigma_v", "sigma_d"), (sigma_u, sigma_v, sigma_d), strict=True)
        ]
        return cls(np.diag(np.square(sigmas)))

    @classmethod
    def independent_pixels(cls, sigma: float) -> StereoNoise:
        """R of independent errors `sigma` px in u_left, v and u_right.

        d = u_left - u_right shares the error of u_left: R = sigma^2 [[1, 0, 1], [0, 1, 0], [1, 0, 2]].
        """
        return cls(positive("sigma", sigma) ** 2 * np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 2.0]]))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StereoNoise) and bool(np.array_equal(self.R, other.R))

    def __hash__(self) -> int:
        return hash(self.R.tobytes())


RIG_ERRORS = ("misalignment", "disparity_offset", "right_yaw", "right_roll", "scale")
"""What a `ColouredNoise` states of the rig."""
_ERRORS_IN_COMMON = ("gauge_walk", *RIG_ERRORS)


@dataclass(frozen=True, eq=False)
class ColouredNoise(StereoNoise):
    """R of (u, v, d), and the part of the errors that lasts, as tracks of real images have it.

    Filters take R for white noise. Those that know better, such as the preset "coloured-noise", use the parts.

    Parameters
    ----------
    R : (3, 3) array_like
        For filters that know white noise only: large enough for the errors that last, px^2.
    white : (3, 3) array_like, optional
        Covariance of the part that is independent from frame to frame, px^2. None: R. Measurements that bring a
        covariance of their own have that.
    drift : LandmarkDrift, optional
        Random walk of each tracked point on its surface. None: points stay where they are.
    lasting_time : float, optional
        Time constant of a Gauss-Markov process of each landmark, s, where the errors beside the white ones are one. The
        drift is what stands for it in a filter that does not keep such errors.
    lasting : (3, 3) array_like, optional
        Covariance of that process, px^2. None: R - white.
    gauge_walk : float
        Of the part that all tracks of a frame have in common, rad per root of a radian of image motion (`StereoEKF`).
    misalignment : float
        Standard deviation of the rotation between the camera and the frame of odometry and reference, rad per axis.
    disparity_offset : float
        Standard deviation of what the rectification has left in all disparities, px.
    right_yaw, right_roll : float
        Standard deviations of what it has left of the rotation of the right camera, about its vertical and its optical
        axis, rad.
    scale : float
        Standard deviation of the share by which the rig makes the world larger than it is, as a baseline does that is
        stated too long. No measurement of the rig shows it.

    Raises
    ------
    ValueError
        A matrix is not symmetric positive definite, or a number is negative or not finite.
    """

    white: FloatArray | None = None
    drift: LandmarkDrift | None = None
    gauge_walk: float = 0.0
    misalignment: float = 0.0
    disparity_offset: float = 0.0
    right_yaw: float = 0.0
    right_roll: float = 0.0
    scale: float = 0.0
    lasting_time: float | None = None
    lasting: FloatArray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.white is not None:
            object.__setattr__(self, "white", covariance_matrix("white", self.white, 3, definite=True))
        if self.lasting is not None:
            object.__setattr__(self, "lasting", covariance_matrix("lasting", self.lasting, 3))
            if self.lasting_time is None:
                raise ValueError("lasting_time must be given with lasting, got None: how long do the errors last?")
        if self.lasting_time is not None:
            object.__setattr__(self, "lasting_time", positive("lasting_time", self.lasting_time))
            if self.lasting is None:
                if self.white is None:
                    raise ValueError("white or lasting must be given with lasting_time: R - white is what lasts")
                covariance_matrix("R - white", self.R - self.white, 3)
        object.__setattr__(self, "drift", LandmarkDrift.of(self.drift))
        for name in _ERRORS_IN_COMMON:
            object.__setattr__(self, name, positive(name, getattr(self, name), allow_zero=True))

    @property
    def white_part(self) -> StereoNoise:
        """Noise that is independent from frame to frame."""
        return StereoNoise(self.R if self.white is None else self.white)

    @property
    def lasting_covariance(self) -> FloatArray | None:
        """Covariance of the errors that last, px^2; None without `lasting_time`."""
        if self.lasting_time is None or self.lasting is not None:
            return self.lasting
        return None if self.white is None else self.R - self.white

    @property
    def parts(self) -> dict[str, Any]:
        """Parts of the noise besides R, JSON-able, as the constructor takes it."""
        white = None if self.white is None else self.white.tolist()
        drift = None if self.drift is None else dataclasses.asdict(self.drift)
        lasting: dict[str, Any] = {} if self.lasting_time is None else {"lasting_time": self.lasting_time}
        lasting |= {} if self.lasting is None else {"lasting": self.lasting.tolist()}
        return {"white": white, "drift": drift, **lasting, **{name: getattr(self, name) for name in _ERRORS_IN_COMMON}}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ColouredNoise) and np.array_equal(self.R, other.R) and self.parts == other.parts

    __hash__ = StereoNoise.__hash__


@lru_cache
def gate_limit(probability: float, degrees_of_freedom: int) -> float:
    """Squared Mahalanobis distance that a consistent innovation stays below with `probability`."""
    from scipy.special import chdtri  # SciPy takes longer to import than all that is here

    return float(chdtri(degrees_of_freedom, 1.0 - probability))
