"""How far off every filter is on the real tracks, with one set of settings.

    python benchmarks/real_tracks.py DATA                      # 10 min on two cores
    python benchmarks/real_tracks.py DATA --only shared-anchor batch
    python benchmarks/real_tracks.py DATA --options '{"tail_dof": 4}' --sigma-px 1

DATA is the folder that holds the recordings; those of a known layout are run, and the example of the gtsam wheel where
that is installed. Settings are those of `stereo-slam replay`: 2 px, gate 0.99, the joint test over the frame. Rigidly
aligned ATE in m (target on KITTI 07 with odometry: 6 for every inverse-depth filter, 4 for the best), and in brackets
pose NEES/6, which no filter that believes in independent noise can keep at 1 on tracks that drift.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from filters import StereoNoise
from filters.catalogue.registry import usual_options
from harness import arguments, show
from stereo_slam_env.datasets import layout_of, load, track_layouts
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
    "euclidean": ("euclidean", usual_options("euclidean")),
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
        if layout_of(folder) in [layout.NAME for layout in track_layouts()]:
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


def cell(summary: FilterSummary) -> str:
    """ATE, NEES and cost, or why there are none."""
    if summary.failures:
        return summary.failures[0]
    nees = np.nan if summary.pose_anees is None else summary.pose_anees / 6
    return f"{summary.ate_rigid_m:.2f} ({nees:.1f}) {summary.ms_per_frame:.1f}"


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, "data", data=Path, only=list(FILTERS), recordings="", sigma_px=2.0, options={}, jobs=2)
    streams = []
    for name, recording in recordings(given.data).items():
        if given.recordings in name:
            if any(frame.odometry is not None for frame in recording.frames):
                streams.append((f"{name}, odometry", recording, True))
            streams.append((f"{name}, vision only", recording, False))
    jobs = [(recording, label, odometry) for _, recording, odometry in streams for label in given.only]
    ran = Parallel(given.jobs)(delayed(run)(*job, given.sigma_px, given.options) for job in jobs)
    columns = np.array([cell(summary) for summary in ran], dtype=object).reshape(len(streams), len(given.only))
    rows = [(label, *cells) for label, cells in zip(given.only, columns.T, strict=True)]
    title = f"rigid ATE m (pose NEES/6) ms; {given.sigma_px:g} px, {SETTINGS | given.options}"
    show(title, ("filter", *(name for name, _, _ in streams)), rows)


if __name__ == "__main__":
    main()
