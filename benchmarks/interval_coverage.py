"""Do the intervals keep their promise, and do the tests say no more than they may? Monte Carlo on made-up log ratios.

    python benchmarks/interval_coverage.py                   # 2000 experiments a cell, two to three minutes on one core
    python benchmarks/interval_coverage.py --experiments 300 # 30 s

Coverage of a 95 % interval of the mean, by kind of interval (`stereo_slam_env.evaluation.bands` has the
the symmetric studentised bootstrap), number of recordings, and distribution of the log ratios; in brackets the width
by that of Student's t of a normal distribution. Then how often a difference is said to be shown where there is none,
and where the errors differ by 10 %; and the same of the comparison of consistency, whose values are not logarithms of
single runs. Last, systems that are run three times on each recording: means of each recording, all runs as if they were
recordings, and a bootstrap of recordings and, within them, of runs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.stats import norm, t

from harness import arguments, show
from stereo_slam_env.benchmark.statistics.differences import difference_of, level
from stereo_slam_env.benchmark.statistics.measures import POSE_NEES, difference_by
from stereo_slam_env.evaluation.bands import studentised_interval

RESAMPLES = 1999
DISTRIBUTIONS: dict[str, Callable[[np.random.Generator, tuple[int, int]], np.ndarray]] = {
    "normal": lambda rng, shape: rng.standard_normal(shape),
    "Student, 3 dof": lambda rng, shape: rng.standard_t(3, shape),
    "10 % ten times as wide": lambda rng, shape: (
        rng.standard_normal(shape) * np.where(rng.random(shape) < 0.1, 10.0, 1.0)
    ),
    "skewed (exponential)": lambda rng, shape: rng.exponential(size=shape) - 1.0,
}
Interval = tuple[np.ndarray, np.ndarray]


def student(values: np.ndarray, confidence: float) -> Interval:
    """Student's t."""
    half = t.ppf(0.5 + 0.5 * confidence, len(values) - 1) * values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return values.mean(axis=0) - half, values.mean(axis=0) + half


def _resampled(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    count = len(values)
    weights = np.random.default_rng(1).multinomial(count, np.full(count, 1 / count), RESAMPLES).astype(float)
    centred = values - values.mean(axis=0)
    shift = weights @ centred / count
    spread = np.sqrt(np.maximum(weights @ centred**2 / count - shift**2, 0.0) / (count - 1))
    return shift, spread


def percentile(values: np.ndarray, confidence: float) -> Interval:
    """Quantiles of the resampled means."""
    low, high = np.quantile(_resampled(values)[0], [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], axis=0)
    return values.mean(axis=0) + low, values.mean(axis=0) + high


def accelerated(values: np.ndarray, confidence: float) -> Interval:
    """BCa: bias-corrected and accelerated."""
    shift, _ = _resampled(values)
    centred = values - values.mean(axis=0)
    bias = norm.ppf(np.clip((shift < 0).mean(axis=0), 1 / RESAMPLES, 1 - 1 / RESAMPLES))
    acceleration = (centred**3).sum(axis=0) / (6 * (centred**2).sum(axis=0) ** 1.5)
    ordered = np.sort(shift, axis=0)

    def end(probability: float) -> np.ndarray:
        z = bias + norm.ppf(probability)
        places = norm.cdf(bias + z / (1 - acceleration * z)) * RESAMPLES
        return np.take_along_axis(ordered, np.clip(places.astype(int), 0, RESAMPLES - 1)[None], axis=0)[0]

    return values.mean(axis=0) + end(0.5 - 0.5 * confidence), values.mean(axis=0) + end(0.5 + 0.5 * confidence)


def studentised(values: np.ndarray, confidence: float) -> Interval:
    """Bootstrap-t with two tails."""
    shift, spread = _resampled(values)
    ratio = np.divide(shift, spread, out=np.zeros_like(shift), where=spread > 1e-9 * spread.max(axis=0))
    low, high = np.quantile(ratio, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], axis=0)
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return values.mean(axis=0) - high * error, values.mean(axis=0) - low * error


KINDS: dict[str, Callable[[np.ndarray, float], Interval]] = {
    "percentile": percentile,
    "BCa": accelerated,
    "Student's t": student,
    "studentised": studentised,
    "symmetric studentised": studentised_interval,
}


def coverage(counts: list[int], experiments: int, comparisons: int) -> None:
    """Share of the intervals that hold the truth."""
    confidence = level(comparisons)
    rows = []
    for name, draw in DISTRIBUTIONS.items():
        for count in counts:
            values = draw(np.random.default_rng(count), (count, experiments))
            cells = []
            for interval in KINDS.values():
                low, high = interval(values, confidence)
                width = np.median(high - low) * np.sqrt(count) / 2 / t.ppf(0.5 + 0.5 * confidence, count - 1)
                cells.append(f"{100 * np.mean((low <= 0) & (high >= 0)):.1f} ({width:.2f})")
            rows.append((name, str(count), *cells))
    title = f"coverage of {100 * confidence:.3g} % intervals, % ({experiments} experiments; relative width)"
    show(title, ("log ratios", "n", *KINDS), rows)


def findings(counts: list[int], experiments: int) -> None:
    """How often a difference is said to be shown."""
    rows = []
    for name, draw in DISTRIBUTIONS.items():
        for count in counts:
            gaps = 0.1 * draw(np.random.default_rng(count), (experiments, count))
            shares = [100 * np.mean([difference_of(row + gap).shown for row in gaps]) for gap in (0.0, np.log(1.1))]
            rows.append((name, str(count), *(f"{share:.1f}" for share in shares)))
    title = f"a difference is shown, % of {experiments} experiments; scatter of a log ratio 0.1"
    show(title, ("log ratios", "n", "equal errors", "10 % larger errors"), rows)


def consistency(counts: list[int], experiments: int) -> None:
    """The comparison of two filters' mean NEES: by the distance of the mean from its ideal, or of each single run."""
    rows = []
    for a, b in ((1.0, 1.0), (1.3, 1.3), (1.2, 1 / 1.2), (1.35, 1.0), (0.7, 1.0)):
        truth = abs(np.log(a)) - abs(np.log(b))
        for count in counts:
            rng = np.random.default_rng(count)
            cells = {"mean": np.zeros(2), "single": np.zeros(2)}
            for _ in range(experiments):
                common, own = rng.standard_normal((count, 24)), rng.standard_normal((2, count, 24))
                ours, theirs = (
                    f * ((0.9 * common + np.sqrt(0.19) * x) ** 2).mean(1) for f, x in zip((a, b), own, strict=True)
                )
                by_run = difference_of(np.abs(np.log(ours)) - np.abs(np.log(theirs)))
                for kind, found in (("mean", difference_by(POSE_NEES, ours, theirs)), ("single", by_run)):
                    low, high = found.interval or (np.nan, np.nan)
                    cells[kind] += (low <= truth <= high, found.shown)
            shares = (f"{held:.0f}, {shown:.0f}" for held, shown in (100 * c / experiments for c in cells.values()))
            rows.append((f"{a:.2f}, {b:.2f}", str(count), *shares))
    title = f"comparison of consistency, {experiments} experiments: interval holds the truth %, shown %"
    show(title, ("NEES / 6 of both", "n", "mean over runs", "each single run"), rows)


def repeated(counts: list[int], experiments: int, runs: int = 3) -> None:
    """Coverage where each recording has several runs, by how much of the scatter is that of the runs."""
    rows = []
    for between, within in ((1.0, 0.3), (1.0, 1.0), (0.3, 1.0)):
        for count in counts:
            rng = np.random.default_rng(count)
            values = between * rng.standard_normal((count, 1, experiments))
            values = values + within * rng.standard_normal((count, runs, experiments))
            means, pooled = values.mean(axis=1), values.reshape(-1, experiments)
            resampled = np.empty((RESAMPLES // 10, experiments))
            for k in range(len(resampled)):
                recordings = rng.integers(count, size=(count, 1))
                resampled[k] = values[recordings, rng.integers(runs, size=(count, runs))].mean(axis=(0, 1))
            ends = [studentised_interval(means, 0.95), studentised_interval(pooled, 0.95)]
            ends.append(tuple(np.quantile(resampled, [0.025, 0.975], axis=0)))
            held = (f"{100 * np.mean((low <= 0) & (high >= 0)):.1f}" for low, high in ends)
            rows.append((f"{between:g}, {within:g}", str(count), *held))
    title = f"coverage of 95 % intervals, {runs} runs of each recording, % of {experiments} experiments"
    show(title, ("scatter of recordings, of runs", "n", "means, symmetric", "all runs", "both resampled"), rows)


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, experiments=2000, runs=[8, 10, 20, 50])
    for comparisons in (1, 12):
        coverage(given.runs, given.experiments, comparisons)
    findings(given.runs, max(given.experiments // 4, 50))
    consistency(given.runs, max(given.experiments // 4, 50))
    repeated(given.runs, given.experiments)


if __name__ == "__main__":
    main()
