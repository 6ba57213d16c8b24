"""Errors of the map by distance and by age: sums that a run collects, and the figures of many runs.

By distance: error, NEES and depth bias of landmarks (Sibley et al., 2005). By age: convergence of depth since a
landmark entered the map (the paper's section 4.3, over all landmarks instead of two). Sums, not means, so that runs are
combined with their true weights.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from stereo_slam_env.evaluation.map_scoring import MapScore

RANGE_EDGES = (0.0, 10.0, 20.0, 40.0, 80.0, np.inf)  # m, true distance from the camera
DEPTH_CLASSES = {"near": (15.0, 25.0), "far": (60.0, 90.0)}  # m, true depth at first sight; the paper's 20 m and 75 m
AGES = 31  # frames since a landmark entered the map: 0 to 30
AT_INFINITY = 3.0  # times the true distance: an estimate beyond it has lost its metric position, see `position_count`

_RANGES, _CLASSES = len(RANGE_EDGES) - 1, len(DEPTH_CLASSES)


def _by_range() -> FloatArray:
    return np.zeros(_RANGES)


def _by_age() -> FloatArray:
    return np.zeros((_CLASSES, AGES))


@dataclass(frozen=True, eq=False)
class LandmarkStatistics:
    """Sums over the landmarks truly in both images, over the frames of a run. All float64."""

    # (5,): by the ranges of `RANGE_EDGES`: landmarks x frames with a NEES in (u, v, d), and its sum.
    nees_count: FloatArray = field(default_factory=_by_range)
    nees: FloatArray = field(default_factory=_by_range)
    # (5,): those of them with a metric position: 0 < d, and not farther than `AT_INFINITY` times the truth. Disparity
    # is nearly Gaussian and depth is its inverse, whose square has no mean: one estimate at d = 0 would be all there is
    # to see.
    position_count: FloatArray = field(default_factory=_by_range)
    # (5,): sums over them of the squared position error relative to the camera, m^2, and of estimated minus true depth,
    # m.
    squared_error: FloatArray = field(default_factory=_by_range)
    depth_error: FloatArray = field(default_factory=_by_range)
    # (2, 31): by the classes of `DEPTH_CLASSES` and the frames since the landmark entered the map: how many.
    age_count: FloatArray = field(default_factory=_by_age)
    # (2, 31): sums of the claimed variance of depth and of its squared error, m^2, both to first order at the true
    # depth, z^2 / (f b) times those of the disparity: defined for d <= 0, too, so nobody is left out.
    depth_variance: FloatArray = field(default_factory=_by_age)
    squared_depth_error: FloatArray = field(default_factory=_by_age)

    @classmethod
    def total(cls, parts: Iterable[LandmarkStatistics]) -> LandmarkStatistics:
        """Sum of several runs."""
        summed = cls()
        for part in parts:
            for name in SERIES:
                getattr(summed, name)[...] += getattr(part, name)
        return summed


SERIES = tuple(f.name for f in dataclasses.fields(LandmarkStatistics))


class LandmarkScorer:
    """Collects the statistics of a run, some frames at a time."""

    def __init__(self, camera: StereoCamera) -> None:
        self.statistics = LandmarkStatistics()
        self._camera = camera
        self._edges = np.array(RANGE_EDGES[1:-1])
        # Landmarks of the last frame, with age and class.
        self._last: tuple[IntArray, IntArray, IntArray] = (np.zeros(0, dtype=np.int64),) * 3

    def add(self, score: MapScore, frames: range) -> None:
        """Note the errors of the maps in the next frames."""
        ages, classes = self._grow_older(score, frames)
        self._add_by_range(score)
        finite = np.isfinite(score.disparity_error) & np.isfinite(score.disparity_variance)
        self._add_by_age(score, ages, classes, finite & (classes >= 0) & (ages < AGES))

    def _add_by_range(self, score: MapScore) -> None:
        sums, bins = self.statistics, np.searchsorted(self._edges, score.distance, side="right")
        finite = np.isfinite(score.nees)
        _add(sums.nees_count, bins[finite])
        _add(sums.nees, bins[finite], score.nees[finite])
        with np.errstate(invalid="ignore"):
            located = score.in_view & (np.linalg.norm(score.points, axis=1) <= AT_INFINITY * score.distance)
        error = score.points[located] - score.true_points[located]
        _add(sums.position_count, bins[located])
        _add(sums.squared_error, bins[located], np.einsum("ij,ij->i", error, error))
        _add(sums.depth_error, bins[located], error[:, 2])

    def _add_by_age(self, score: MapScore, ages: IntArray, classes: IntArray, scored: BoolArray) -> None:
        sums, cell = self.statistics, classes[scored] * AGES + ages[scored]
        square = (score.true_points[scored, 2] ** 2 / self._camera.disparity_constant) ** 2
        _add(sums.age_count.ravel(), cell)
        _add(sums.depth_variance.ravel(), cell, square * score.disparity_variance[scored])
        _add(sums.squared_depth_error.ravel(), cell, square * score.disparity_error[scored] ** 2)

    def _grow_older(self, score: MapScore, frames: range) -> tuple[IntArray, IntArray]:
        """Age of each landmark, (N,), and the class that it has from the depth at which it entered the map."""
        ids_before, ages_before, classes_before = self._last
        depth, before = score.true_points[:, 2], len(ids_before)
        entered = np.full(len(score.ids), -1)
        for number, (low, high) in enumerate(DEPTH_CLASSES.values()):
            entered[(depth >= low) & (depth < high)] = number
        ids = np.concatenate([ids_before, score.ids])
        at = np.concatenate([np.full(before, frames.start - 1), score.frames])
        order = np.lexsort((at, ids))
        begins = np.ones(len(ids), dtype=bool)  # not in the map in the frame before
        begins[1:] = (np.diff(ids[order]) != 0) | (np.diff(at[order]) != 1)
        first = np.flatnonzero(begins)[np.cumsum(begins) - 1]
        ages, classes = np.concatenate([ages_before, np.zeros(len(entered), int)]), np.append(classes_before, entered)
        ages[order] = ages[order][first] + np.arange(len(ids)) - first
        classes[order] = classes[order][first]
        last = at == frames.stop - 1
        self._last = ids[last], ages[last], classes[last]
        return ages[before:], classes[before:]


def _add(sums: FloatArray, cells: IntArray, values: FloatArray | None = None) -> None:
    """Add the values, or ones, to their cells of a view of an array."""
    sums += np.bincount(cells, weights=values, minlength=len(sums))


@dataclass(frozen=True)
class RangeError:
    """Landmarks of one range of true distance from the camera, over frames and runs."""

    # The range; high_m is infinity for the last one.
    low_m: float
    high_m: float
    count: int  # landmarks x frames
    # Position error relative to the camera; estimates at d <= 0, or far beyond the truth, have no metric position and
    # are left out, see `LandmarkStatistics`. NaN where nothing is left.
    rmse_m: float
    # Mean of estimated minus true depth of the same ones (Sibley's bias), and its standard error over runs; that is NaN
    # for a single run.
    depth_bias_m: float
    depth_bias_sigma_m: float
    anees: float  # mean NEES in (u, v, d), 3 is ideal


@dataclass(frozen=True)
class DepthConvergence:
    """Depth of the landmarks that began near or far, by number of frames since they entered the map."""

    label: str  # "near" or "far"
    # True depth at first sight.
    low_m: float
    high_m: float
    frames: tuple[int, ...]  # frames since then, 0 at first sight
    count: tuple[int, ...]  # landmarks still there
    # Root mean square of the claimed standard deviation of depth, and of its true error, both to first order at the
    # true depth, so that estimates at d <= 0 have theirs, too.
    sigma_m: tuple[float, ...]
    rmse_m: tuple[float, ...]


def range_errors(runs: Sequence[LandmarkStatistics]) -> tuple[RangeError, ...]:
    """One figure for each range in which there was a landmark, ascending; NaN for what nothing is known of."""
    total = LandmarkStatistics.total(runs)
    with np.errstate(divide="ignore", invalid="ignore"):
        rmse = np.sqrt(total.squared_error / total.position_count)
        bias = total.depth_error / total.position_count
        anees = total.nees / total.nees_count
    sigma = _standard_error([run.depth_error for run in runs], [run.position_count for run in runs], bias)
    columns = zip(*(values.tolist() for values in (rmse, bias, sigma, anees)), strict=True)
    rows = zip(pairwise(RANGE_EDGES), total.nees_count.astype(int).tolist(), columns, strict=True)
    return tuple(RangeError(*ends, count, *figures) for ends, count, figures in rows if count)


def depth_convergence(runs: Sequence[LandmarkStatistics]) -> tuple[DepthConvergence, ...]:
    """The curves of the classes of which landmarks were seen: near, then far."""
    total = LandmarkStatistics.total(runs)
    curves = []
    for (label, ends), count, *sums in zip(
        DEPTH_CLASSES.items(), total.age_count, total.depth_variance, total.squared_depth_error, strict=True
    ):
        ages = np.flatnonzero(count > 0)
        if len(ages):
            roots = (tuple(np.sqrt(values[ages] / count[ages]).tolist()) for values in sums)
            counted = tuple(count[ages].astype(int).tolist())
            curves.append(DepthConvergence(label, *ends, tuple(ages.tolist()), counted, *roots))
    return tuple(curves)


def _standard_error(sums: Sequence[FloatArray], counts: Sequence[FloatArray], mean: FloatArray) -> FloatArray:
    """Standard error of a mean (B,) over all runs, sum of sums over sum of counts: only runs are independent.

    Source: ratio estimator, Cochran, Sampling Techniques, 1977, section 6.4. NaN for a single run.
    """
    n = np.reshape(counts, (-1, len(mean)))
    runs = (n > 0).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        scatter = np.sum(np.square(np.reshape(sums, n.shape) - mean * n), axis=0)
        error: FloatArray = np.sqrt(scatter * runs / (runs - 1)) / n.sum(axis=0)
    return np.where(runs > 1, error, np.nan)
