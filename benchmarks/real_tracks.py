"""How far off every filter is on the real tracks, with one set of settings.

    python benchmarks/real_tracks.py DATA                      # 10 min on two cores
    python benchmarks/real_tracks.py DATA --only shared-anchor,batch
    python benchmarks/real_tracks.py DATA --options '{"tail_dof": 4}' --sigma-px 1

DATA is the folder that holds the recordings; those of a known layout are run, and the example of the gtsam wheel where
that is installed. Settings are those of `stereo-slam replay`: 2 px, gate 0.99, the joint test over the frame. Rigidly
aligned ATE in m (target on KITTI 07 with odometry: 6 for every inverse-depth filter, 4 for the best), and in brackets
pose NEES/6, which no filter that believes in independent noise can keep at 1 on tracks that drift.
"""

from __future__ import annotations

import argparse
import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table

from filters import StereoNoise
from stereo_slam_env.datasets import TRACK_LAYOUTS, layout_of, load
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all
from stereo_slam_env.recording.recording import Recording

SETTINGS = {"gate": 0.99, "consensus": True}
# Label -> filter and what it has of its own.
FILTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "inverse-depth": ("inverse-depth", {}),
    "dual-bearing": ("dual-bearing", {}),
    "shared-anchor": ("shared-anchor", {}),
    "right-invariant": ("right-invariant", {}),
    "unscented": ("unscented", {}),
    "so3": ("shared-anchor", {"error": "so3"}),
    "first-estimates": ("shared-anchor", {"error": "first-estimates"}),
    "iterated": ("shared-anchor", {"iterations": 2}),
    "stacked": ("shared-anchor", {"measurement": "stacked"}),
    "euclidean-5px": ("euclidean", {"min_disparity": 5.0}),
    "monocular": ("monocular", {}),
    "dead-reckoning": ("dead-reckoning", {}),
    "frame-to-frame": ("frame-to-frame", {}),
    "batch": ("batch", {}),
}


def recordings(data: Path) -> dict[str, Recording]:
    """What there is to run."""
    folders = [folder for folder in sorted(data.iterdir()) if folder.is_dir()]
    found: dict[str, Recording] = {}
    for folder in folders:
        if layout_of(folder) in [layout.NAME for layout in TRACK_LAYOUTS]:
            found[folder.name] = load(folder)
    with contextlib.suppress(ImportError):
        found["gtsam (against its odometry)"] = load("gtsam")
    return found


def run(recording: Recording, label: str, odometry: bool, sigma_px: float, options: dict[str, Any]) -> FilterSummary:
    """One filter on one recording."""
    name, own = FILTERS[label]
    noise = StereoNoise.independent_pixels(sigma_px)
    ran = [run_filter(recording, name, own, common_options=SETTINGS | options, noise=noise, use_odometry=odometry)]
    return summarise_all(ran, figures_of(ran, divergence_percent=10.0))[0]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", help="labels, separated by commas")
    parser.add_argument("--recordings", help="part of their names", default="")
    parser.add_argument("--sigma-px", type=float, default=2.0)
    parser.add_argument("--options", type=json.loads, default={}, help="JSON, for every filter that knows them")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    labels = arguments.only.split(",") if arguments.only else list(FILTERS)
    unknown = [label for label in labels if label not in FILTERS]
    if unknown:
        parser.error(f"--only must name some of {', '.join(FILTERS)}, got {', '.join(unknown)}")
    streams = []
    for name, recording in recordings(arguments.data).items():
        if arguments.recordings in name:
            if any(frame.odometry is not None for frame in recording.frames):
                streams.append((f"{name}, odometry", recording, True))
            streams.append((f"{name}, vision only", recording, False))
    jobs = [(stream, label) for stream in streams for label in labels]
    results = Parallel(arguments.jobs)(
        delayed(run)(recording, label, odometry, arguments.sigma_px, arguments.options)
        for (_, recording, odometry), label in jobs
    )
    title = f"rigid ATE m (pose NEES/6) ms; {arguments.sigma_px:g} px, {SETTINGS | arguments.options}"
    table = Table(title=title)
    table.add_column("filter")
    for name, _, _ in streams:
        table.add_column(name)
    by_job = dict(zip([(stream[0], label) for stream, label in jobs], results, strict=True))
    for label in labels:
        table.add_row(label, *(cell(by_job[name, label]) for name, _, _ in streams))
    Console(width=200).print(table)


def cell(summary: FilterSummary) -> str:
    """ATE, NEES and cost, or why there are none."""
    if summary.failures:
        return summary.failures[0]
    nees = np.nan if summary.pose_anees is None else summary.pose_anees / 6
    return f"{summary.ate_rigid_m:.2f} ({nees:.1f}) {summary.ms_per_frame:.1f}"


if __name__ == "__main__":
    main()
