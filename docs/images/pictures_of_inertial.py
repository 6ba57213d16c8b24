"""Pictures of stereo-inertial runs: consistency over many runs, and what an inertial unit is worth.

`small` asks for a short run, to see that the picture can be drawn.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

import stereo_slam_env as sse
from stereo_slam_env.benchmark import preset_study, run_benchmark
from stereo_slam_env.benchmark.recordings.inertial_problem import PERIOD, inertial_drive, inertial_flight
from stereo_slam_env.report import BAND, INK, MUTED, filter_colours
from stereo_slam_env.sensing.imu import DATA_SHEETS
from stereo_slam_env.viewer import style_context

WIDTH_INCHES, DPI = 10.4, 100
BLUE, ORANGE, GREEN = filter_colours(("inverse-depth", "dual-bearing", "euclidean")).values()
INPUTS = {
    "images": ("right-invariant", False, MUTED),
    "images, wheels": ("right-invariant", True, ORANGE),
    "images, inertial unit": ("inertial", False, BLUE),
    "all three": ("inertial", True, GREEN),
}
"""Filter, whether it is given wheels, and colour of what a filter may be given."""


@style_context()
def nees(path: Path, work: Path, *, small: bool) -> None:
    """NEES of the pose over 50 drives and 50 flights of 8 s, by frame: each run, their mean, the band of the mean."""
    runs, frames = (4, 20) if small else (50, 80)
    exact = replace(DATA_SHEETS["adis16448"], scale=0.0, misalignment=0.0)  # the filter has no variable for them
    figure = Figure(figsize=(WIDTH_INCHES, 3.6))
    figure.subplots_adjust(left=0.06, right=0.985, bottom=0.14, top=0.9, wspace=0.12)
    low, high = chi2.ppf([0.025, 0.975], 6 * runs) / (6 * runs)
    for axes, label, problem in zip(
        figure.subplots(1, 2, sharey=True), ("drives", "flights"), (inertial_drive, inertial_flight), strict=True
    ):
        found = np.empty((runs, frames))
        for seed in range(runs):
            recording = problem(seed, frames=frames, landmarks=25, imu=exact)
            moments = sse.run("inertial", recording, gate=None, use_odometry=False)
            found[seed] = [moment.nees / 6.0 for moment in moments]
        time, mean = PERIOD * np.arange(frames), found.mean(axis=0)
        axes.plot(time, found.T, color=MUTED, linewidth=0.4, alpha=0.35)
        axes.axhspan(low, high, color=BAND, label="95 % of the means of consistent runs")
        axes.plot(time, mean, color=BLUE, label=f"mean of {runs}")
        axes.axhline(1.0, color=INK, linewidth=0.8)
        inside = 100.0 * np.mean((mean > low) & (mean < high))
        title = f"{runs} {label}: NEES / 6 {found.mean():.2f}, in the band at {inside:.0f} % of the frames"
        axes.set_title(title, fontsize=9.5, loc="left")
        axes.set(xlabel="time (s)", ylim=(0.0, 3.0), xlim=(0.0, time[-1]))
    axes.legend(loc="upper right")
    figure.savefig(path, dpi=DPI)


def worth(path: Path, work: Path, *, small: bool) -> None:
    """Position error by the number of landmarks, for what a filter may be given: the preset `inertial`, 4 seeds."""
    study = preset_study("inertial").with_scenarios(
        lambda one: one.replaced(seeds=(0, 1), frames=20) if small else one.replaced(seeds=range(4))
    )
    run_benchmark(study, work / "inertial", jobs=1)
    draw_worth(json.loads((work / "inertial" / "summary.json").read_text(encoding="utf-8")), path)


@style_context()
def draw_worth(summary: Mapping[str, Any], path: Path) -> None:
    """The same of a finished run."""
    cells = [(cell["factors"], cell["filters"]) for cell in summary["cells"].values()]
    figure = Figure(figsize=(WIDTH_INCHES, 3.8))
    panels = figure.subplots(1, len(DATA_SHEETS), sharey=True)
    figure.subplots_adjust(left=0.07, right=0.985, bottom=0.14, top=0.9, wspace=0.08)
    for axes, sheet in zip(panels, DATA_SHEETS, strict=True):
        for label, (name, wheels, colour) in INPUTS.items():
            points = sorted(
                (factors["options.landmarks"], filters[name]["position_rmse_m"])
                for factors, filters in cells
                if factors["options.imu"] == sheet and factors["use_odometry"] == wheels
            )
            axes.plot(*zip(*points, strict=True), "o-", color=colour, label=label)
        axes.set(xscale="log", yscale="log", title=f"unit: {sheet}", xlabel="landmarks in view")
        axes.set_xticks([8, 25, 100], ["8", "25", "100"])
        axes.set_yticks([0.1, 0.2, 0.4, 0.8], ["0.1", "0.2", "0.4", "0.8"])
        axes.minorticks_off()
    panels[0].set_ylabel("position error after 20 s and 160 m (m)")
    panels[-1].legend(loc="upper right")
    figure.savefig(path, dpi=DPI)
