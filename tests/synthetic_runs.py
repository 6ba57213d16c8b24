"""Made-up results with known properties, to test plots and report without a filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.landmark_statistics import AGES, LandmarkStatistics
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Bounds, RunFigures, figures_of, summarise_all
from stereo_slam_env.recording.recording import SIMULATION


@dataclass(frozen=True)
class Behaviour:
    """How a made-up filter behaves: its error, and how much of it the filter owns up to."""

    name: str
    error_m: float
    overconfidence: float = 1.0
    milliseconds: float = 4.0
    diverges: bool = False


THREE = (
    Behaviour("inverse-depth", 0.10),
    Behaviour("dual-bearing", 0.104, overconfidence=1.1, milliseconds=4.7),
    Behaviour("euclidean", 0.17, overconfidence=1.9, milliseconds=3.1),
)
THREE_ONE_DIVERGING = (*THREE[:2], replace(THREE[2], diverges=True))


def make_runs(
    behaviours: Sequence[Behaviour] = THREE,
    seeds: Sequence[int | None] = range(5),
    frames: int = 240,
    truth: str = "full",
) -> list[FilterRun]:
    """Make runs of every behaviour on every seed; `truth` is "full", "gaps" (every third frame) or "none"."""
    return [_run(behaviour, seed, frames, truth) for seed in seeds for behaviour in behaviours]


def scored(
    runs: Sequence[FilterRun], *, divergence_percent: float = 10.0, bounds: Bounds | None = None
) -> tuple[tuple[FilterSummary, ...], dict[str, RunFigures]]:
    """Summaries and figures of runs, as the benchmark makes them."""
    figures = figures_of(runs, divergence_percent=divergence_percent, bounds=bounds)
    return summarise_all(runs, figures), figures


def changed(summary: FilterSummary, **figures: float | None) -> FilterSummary:
    """The summary with other figures."""
    assert set(figures) <= set(summary.figures)
    return replace(summary, figures={**summary.figures, **figures})


def summary_of(runs: Sequence[FilterRun], **options: Any) -> FilterSummary:
    """Summary of runs of one filter; copies of one run count as of different seeds. Options as `scored`."""
    if len({run.seed for run in runs}) < len(runs):
        runs = [replace(run, seed=k) for k, run in enumerate(runs)]
    (summary,), _ = scored(runs, **options)
    return summary


def make_bounds(runs: Sequence[FilterRun], share: float = 0.9) -> dict[tuple[str, int | None], Bound]:
    """Make bounds of the recordings of runs: so much of the position error of the first run on each, in every frame."""
    bounds: dict[tuple[str, int | None], Bound] = {}
    for run in runs:
        squared = np.nanmean(np.sum((run.positions - run.true_positions)[1:] ** 2, axis=1))
        pose = np.tile(np.diag(np.repeat([share**2 * squared / 3, 1e-6], 3)), (len(run), 1, 1))
        bounds.setdefault((run.recording_name, run.seed), Bound(pose))
    return bounds


def _drive(frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Drive a street with two wide turns: times, positions, yaw and speed."""
    times = 0.1 * np.arange(frames)
    phase = np.linspace(0.0, 1.0, frames)
    rate = 0.6 * np.exp(-(((phase - 0.35) / 0.06) ** 2)) - 0.6 * np.exp(-(((phase - 0.7) / 0.06) ** 2))
    yaw = np.cumsum(rate) * 0.1 * 100 / frames * 2.4
    speed = 4.9 - 1.9 * np.abs(rate) / 0.6
    steps = 0.1 * speed[:, None] * np.stack([np.sin(yaw), np.zeros(frames), np.cos(yaw)], axis=-1)
    return times, np.cumsum(steps, axis=0) - steps[0], yaw, speed


def _run(behaviour: Behaviour, seed: int | None, frames: int, truth: str) -> FilterRun:
    label = sum(map(ord, behaviour.name))
    rng = np.random.default_rng([0 if seed is None else seed, label])
    difficulty = np.exp(0.35 * np.random.default_rng(0 if seed is None else seed).standard_normal())
    times, positions, yaw, speed = _drive(frames)
    orientations = Rotation.from_rotvec(yaw[:, None] * [0.0, 1.0, 0.0]).as_quat()
    velocities = speed[:, None] * np.stack([np.sin(yaw), 0 * yaw, np.cos(yaw)], axis=-1)
    rates = np.stack([0 * yaw, np.gradient(yaw, times), 0 * yaw], axis=-1)

    growth = np.sqrt(np.arange(frames) / frames)
    sigma = np.array([1.0, 0.6, 0.8, 0.004, 0.005, 0.003]) * behaviour.error_m * growth[:, None] + 1e-4
    walk = np.cumsum(rng.standard_normal((frames, 6)), axis=0) / np.sqrt(np.arange(1, frames + 1))[:, None]
    errors = walk * sigma * difficulty
    if behaviour.diverges:
        start = frames // 2
        errors[start:, :3] += (0.02 * np.arange(frames - start)[:, None]) ** 3 * rng.standard_normal(3)
    claimed = sigma * difficulty / behaviour.overconfidence
    covariances = claimed[:, :, None] ** 2 * np.eye(6)
    scored = np.arange(frames) % {"full": 1, "gaps": 3, "none": frames}[truth] == 0
    scored[0] &= truth != "none"
    nees = np.where(scored, (errors**2 / claimed**2).sum(axis=1), np.nan)
    dof = np.where(np.arange(frames) == 0, 0, 180)
    quiet = ("initialised", "dropped", "gated", "rejected", "behind_camera", "failed_factorisations", "negative_depth")
    counts = {name: np.zeros(frames, dtype=np.int64) for name in quiet}
    counts |= {"updated": dof // 3, "map_size": np.clip(rng.poisson(65, frames), 30, 95)}

    def known(values: np.ndarray) -> np.ndarray:
        return np.where(scored[:, None], values, np.nan)

    milliseconds = rng.gamma(40, behaviour.milliseconds / 40, frames)
    claimed_rotation_square = (errors[:, 3:] ** 2 / claimed[:, 3:] ** 2).sum(axis=1)
    return FilterRun(
        filter_name=behaviour.name,
        recording_name="drive" if seed is None else f"drive-{seed}",
        options={"gate": 0.99},
        seed=seed,
        timestamps=times,
        positions=positions - errors[:, :3],
        orientations=(Rotation.from_quat(orientations) * Rotation.from_rotvec(-errors[:, 3:])).as_quat(),
        pose_covariances=covariances,
        linear_velocities=velocities + 0.05 * rng.standard_normal((frames, 3)),
        angular_velocities=rates + 0.004 * rng.standard_normal((frames, 3)),
        velocity_covariances=np.tile(np.diag([0.05**2] * 3 + [0.004**2] * 3), (frames, 1, 1)),
        true_positions=known(positions),
        true_orientations=known(orientations),
        true_linear_velocities=known(velocities),
        true_angular_velocities=known(rates),
        pose_errors=known(errors),
        pose_nees=nees,
        landmark_nees=np.where(scored, rng.chisquare(180, frames) / 60, np.nan),
        landmark_rmse=np.where(scored, 0.9, np.nan),
        nis=np.where(dof > 0, rng.chisquare(180, frames) * behaviour.overconfidence, 0.0),
        nis_dof=dof,
        milliseconds=milliseconds,
        truth_from=SIMULATION,
        counts=counts,
        traces=tuple(
            _trace(number, label, depth, behaviour, rng, truth)
            for number, label, depth in ((7, "near", 20.0), (31, "far", 75.0))
        ),
        position_nees=nees - claimed_rotation_square,
        rotation_nees=np.where(np.isfinite(nees), claimed_rotation_square, np.nan),
        predict_milliseconds=0.1 * milliseconds,
        update_milliseconds=0.9 * milliseconds,
        state_size=12.0 + 3.0 * counts["map_size"],
        memory_mb=behaviour.milliseconds,
        landmark_statistics=LandmarkStatistics() if truth == "none" else _statistics(behaviour, seed, frames),
    )


def _statistics(behaviour: Behaviour, seed: int | None, frames: int) -> LandmarkStatistics:
    """Make errors that grow with the square of the distance; the overconfident owns up to less, and sees too near."""
    difficulty = 1.0 + 0.1 * np.random.default_rng(seed).standard_normal()
    count = frames * np.array([2.0, 10.0, 20.0, 15.0, 5.0])
    sigma = difficulty * np.array([6.0, 15.0, 30.0, 60.0, 100.0]) ** 2 / 4000.0
    age_count = np.stack([np.linspace(400.0, 20.0, AGES), np.linspace(300.0, 200.0, AGES)])
    square = np.array([[20.0], [75.0]]) ** 4 / 412.0**2 / np.arange(1, AGES + 1)
    return LandmarkStatistics(
        nees_count=count,
        nees=3.0 * count,
        position_count=count,
        squared_error=sigma**2 * count,
        depth_error=-0.1 * (behaviour.overconfidence - 1.0) * sigma * count,
        age_count=age_count,
        depth_variance=square * age_count / behaviour.overconfidence**2,
        squared_depth_error=square * difficulty**2 * age_count,
    )


def _trace(
    landmark_id: int, label: str, start: float, behaviour: Behaviour, rng: np.random.Generator, truth: str
) -> LandmarkTrace:
    updates = np.arange(12)
    depth = start - 0.45 * updates
    raw = depth**2 / 412.0 * 1.4
    sigma = raw / np.sqrt(updates + 1) / behaviour.overconfidence
    measured = depth + raw * np.random.default_rng(landmark_id).standard_normal(12)
    measured[5] = np.nan
    return LandmarkTrace(
        landmark_id=landmark_id,
        label=label,
        frames=10 + updates,
        depth=depth + sigma * rng.standard_normal() * 0.8,
        sigma=sigma,
        true_depth=np.full(12, np.nan) if truth == "none" else depth,
        measured_depth=measured,
    )
