"""Measurements of the stereo camera in one frame, as filters take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.noise import LARGEST_VARIANCE, StereoNoise
from filters.contract.validation import at_most, covariance_matrix, finite_array, unique_ids
from filters.geometry.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class StereoObservation:
    """Measurements of the stereo camera in one frame.

    Parameters
    ----------
    ids : (M,) array_like of int
        Landmark identities, unique.
    uvd : (M, 3) array_like
        Left pixel and disparity, px. d <= 0 is legal: noise on a far point.
    v_right : (M,) array_like, optional
        Row measured in the right image, px, where the sensor measures it on its own.
    R : (M, 3, 3) array_like, optional
        Covariance of each measurement, px^2; where None, the filter's `noise` holds. One whose last variance is 1e18
        has no disparity: `of_left` makes such ones.

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, repeated ids, an R that is not symmetric positive definite or above 1e18 px^2.
    """

    ids: IntArray
    uvd: FloatArray
    v_right: FloatArray | None = None
    R: FloatArray | None = None

    def __post_init__(self) -> None:
        ids = unique_ids("ids", self.ids)
        uvd = finite_array("uvd", self.uvd, ("M", 3))
        if len(uvd) != len(ids):
            raise ValueError(f"uvd must have one row per id: {len(ids)} ids, {len(uvd)} rows")
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "uvd", uvd)
        if self.v_right is not None:
            v_right = finite_array("v_right", self.v_right, ("M",))
            if len(v_right) != len(ids):
                raise ValueError(f"v_right must have one entry per id: {len(ids)} ids, {len(v_right)} entries")
            object.__setattr__(self, "v_right", v_right)
        if self.R is not None:
            R = np.zeros((0, 3, 3)) if len(ids) == 0 else self.R
            object.__setattr__(self, "R", covariance_matrix("R", R, 3, batch=len(ids), definite=True))
            at_most("R", self.R, LARGEST_VARIANCE, "px^2")

    @classmethod
    def of_left(cls, ids: ArrayLike, uv: ArrayLike, R: ArrayLike) -> StereoObservation:
        """Measurements of one camera alone: pixels uv (M, 2) with covariance R, (2, 2) or (M, 2, 2), no disparity."""
        uv = finite_array("uv", uv, ("M", 2))
        every = np.zeros((len(uv), 3, 3))
        every[:, :2, :2], every[:, 2, 2] = R, LARGEST_VARIANCE
        return cls(np.asarray(ids), np.column_stack([uv, np.zeros(len(uv))]), R=every)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def with_disparity(self) -> BoolArray:
        """(M,): which measurements have a disparity, however bad."""
        return np.ones(len(self), dtype=np.bool_) if self.R is None else self.R[:, 2, 2] < LARGEST_VARIANCE

    @property
    def has_disparity(self) -> bool:
        """Whether all measurements have one."""
        return bool(self.with_disparity.all())

    def select(self, index: ArrayLike) -> StereoObservation:
        """The measurements at `index` (positions or a mask), in that order."""
        i = np.asarray(index)
        # Every measurement has been checked when this observation was made; only positions can repeat one.
        part = object.__new__(StereoObservation)
        fields = {name: None if value is None else value[i] for name, value in vars(self).items()}
        vars(part).update(fields)
        if i.dtype != np.bool_:
            unique_ids("ids", part.ids)
        return part

    def covariances(self, noise: StereoNoise) -> FloatArray:
        """R of each measurement: its own, or that of `noise`; (M, 3, 3) px^2."""
        return noise.R[None].repeat(len(self), axis=0) if self.R is None else self.R

    def ordered(self) -> StereoObservation:
        """The measurements in ascending order of ids."""
        return self if (self.ids[1:] > self.ids[:-1]).all() else self.select(np.argsort(self.ids))
