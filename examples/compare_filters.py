"""Compare filters, one of them your own, on the same drives, with a test of significance.

Each seed is a drive; all filters get the same bits, and differences are taken drive by drive. The command
`stereo-slam bench` does this with more scenarios and a report. Run it: python examples/compare_filters.py --seeds 8
"""

import argparse

from filters import StereoEKF
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.benchmark.statistics.differences import paired_difference
from stereo_slam_env.evaluation import figures_of, run_filter, summarise_all


class Stacked(StereoEKF):
    """A filter of your own: any class that `make_filter` can make."""

    def __init__(self, camera, noise, **options):
        super().__init__(camera, noise, landmark="shared-anchor", measurement="stacked", error="so3", **options)


FILTERS = {  # label: name or class, options
    "inverse-depth": ("inverse-depth", {}),
    "euclidean": ("euclidean", {"min_disparity": 5.0}),
    "stacked": (Stacked, {}),
}
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument("--seeds", type=int, default=8)
parser.add_argument("--frames", type=int, default=30)
given = parser.parse_args()

runs = []
for seed in range(given.seeds):
    recording = short_turn(seed=seed, frames=given.frames)
    runs += [run_filter(recording, name, options, label=label, seed=seed) for label, (name, options) in FILTERS.items()]

figures = figures_of(runs, divergence_percent=10.0)
summaries = {summary.filter_name: summary for summary in summarise_all(runs, figures)}
low, high = summaries["inverse-depth"].pose_anees_band
print(f"filter          RMSE, m   pose NEES / 6 (95 %: {low / 6:.2f} to {high / 6:.2f})   ms a frame")
for name, found in summaries.items():
    print(f"{name:<14} {found.position_rmse_m:8.4f} {found.pose_anees / 6:15.2f} {found.ms_per_frame:29.2f}")
reference = summaries["inverse-depth"].position_rmse_by_run
for name in ("euclidean", "stacked"):
    found = paired_difference(summaries[name].position_rmse_by_run, reference, comparisons=2)
    print(f"{name} against inverse-depth: {found.percent:+.0f} % position error, {found.finding.value}")
