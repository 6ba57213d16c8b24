"""What makes a covariance believable on real tracks, part by part.

    python benchmarks/real_covariances.py DATA        # two minutes

DATA is the folder that holds the recordings `kitti07_tracks`, `kitti00_stereo_tracks` and `kitti06_stereo51`; those
that are there are run. Filter: shared anchors, gate 0.99, the joint test over the frame. Each row adds one part to the
row above. Tracks without a noise of their own have 2 px as `stereo-slam replay` assumes it, then 0.4 px with steps of
(1.14, 1.0, 0.55) px a frame; the others keep their R and take steps of 0.37 of it. NEES/6 should be 1, of the pose and
of the motion over windows; frames in the two-sided 95 % band, %; rigid ATE, m.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from filters import StereoNoise
from stereo_slam_env.datasets import load
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all
from stereo_slam_env.recording.recording import Recording

RECORDINGS = ("kitti07_tracks", "kitti00_stereo_tracks", "kitti06_stereo51")
SHORT = {"gate_pixels": (0.4, 0.4, 0.2)}
STEPS = {"pixels": (1.14, 1.0, 0.55)}
WALK = {"rotation": 2e-3, "translation": 0.03}
MISALIGNED = {"name": "calibrated", "misalignment_sigma": 5e-3}
FIRST, RIGHT = {"error": "first-estimates"}, {"error": "right-invariant"}
OFFERED: Mapping[str, dict[str, Any]] = {
    "plain": {},
    "landmark drift": {"drift": STEPS},
    "gate for short steps": {"drift": {**STEPS, **SHORT}},
    "first estimates": {"drift": {**STEPS, **SHORT}, **FIRST},
    "gauge walk": {"drift": {**STEPS, **SHORT}, **FIRST, "gauge_walk": WALK},
    "right-invariant instead": {"drift": {**STEPS, **SHORT}, **RIGHT, "gauge_walk": WALK},
    "misalignment too": {"drift": {**STEPS, **SHORT}, **RIGHT, "gauge_walk": WALK, "measurement": MISALIGNED},
}
OWN_NOISE: Mapping[str, dict[str, Any]] = {
    "plain": {},
    "landmark drift": {"drift": 0.37},
    "first estimates": {"drift": 0.37, **FIRST},
    "gauge walk": {"drift": 0.37, **FIRST, "gauge_walk": WALK},
    "right-invariant instead": {"drift": 0.37, **RIGHT, "gauge_walk": WALK},
    "misalignment too": {"drift": 0.37, **RIGHT, "gauge_walk": WALK, "measurement": MISALIGNED},
}


def judged(recording: Recording, options: dict[str, Any], odometry: bool) -> FilterSummary:
    """Shared anchors on a recording."""
    own = recording.frames[0].observation.R is not None
    noise = None if own or not options else StereoNoise.independent_pixels(0.4)
    settings = {"gate": 0.99, "consensus": True, **options}
    run = run_filter(recording, "shared-anchor", settings, noise=noise, use_odometry=odometry, windows=True)
    return summarise_all([run], figures_of([run], divergence_percent=10.0))[0]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--frames", type=int, help="of each recording; all if not given")
    arguments = parser.parse_args()
    found = [name for name in RECORDINGS if (arguments.data / name).is_dir()]
    if not found:
        parser.error(f"data must hold one of {', '.join(RECORDINGS)}, {arguments.data} has none")
    for name in found:
        recording = load(arguments.data / name)[: arguments.frames]
        for odometry in (True, False) if recording.frames[-1].odometry is not None else (False,):
            table = Table(title=f"{name}, {'odometry' if odometry else 'vision only'}")
            for head in ("added", "NEES/6", "in band", "1 s", "10 s", "ATE"):
                table.add_column(head, justify="left" if head == "added" else "right")
            own = recording.frames[0].observation.R is not None
            for label, options in (OWN_NOISE if own else OFFERED).items():
                s = judged(recording, options, odometry)
                nees = [s.pose_anees, s.window_nees_1s, s.window_nees_10s]
                one, short, long = ("-" if value is None else f"{value / 6:.2f}" for value in nees)
                band = "-" if s.frames_in_band_percent is None else f"{s.frames_in_band_percent:.0f}"
                table.add_row(label, one, band, short, long, f"{s.ate_rigid_m:.2f}")
            Console(width=100).print(table)


if __name__ == "__main__":
    main()
