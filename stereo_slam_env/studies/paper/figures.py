"""The paper's figures, in its layout, from what was measured here. Pure: results in, Figure out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2, norm

from filters.landmarks.inverse_depth import ray_direction
from filters.validation import FloatArray
from stereo_slam_env.benchmark.statistics.differences import CONFIDENCE
from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.report.charts.style import (
    BAND,
    INK,
    MUTED,
    WIDTH_INCHES,
    EndLabel,
    colour_key,
    filter_colours,
    label_ends,
    plain_log_axis,
    styled,
)
from stereo_slam_env.studies.paper import convergence, long_drive, speed
from stereo_slam_env.studies.paper.intervals import ratio_interval
from stereo_slam_env.studies.paper.landmark_uncertainty import (
    ASSUMED,
    CAMERA,
    FIGURE_1,
    FIGURE_2,
    landmark,
    measurements,
    places,
)
from stereo_slam_env.studies.paper.parts import Arrays
from stereo_slam_env.studies.paper.settings import COUPLED, DIAGONAL, DUAL, EUCLIDEAN, JOINT, NOISES, RIGHT, UVD

COLOURS = filter_colours((JOINT, DUAL, EUCLIDEAN))
NAMES = {JOINT: "inverse depth, (u, v, d)", DUAL: "two bearing updates", EUCLIDEAN: "XYZ"}
SHOWN = 1000
"""Points of a cloud that are drawn: all of them would make the picture heavy, not clearer."""


@styled
def figure_1(samples: int) -> Figure:
    """Cloud and regions of a point at 70 m, and the histogram of its depth; one row a noise, each with its right R."""
    figure = Figure(figsize=(WIDTH_INCHES, 5.6))
    figure.subplots_adjust(left=0.06, right=0.985, top=0.95, bottom=0.085, hspace=0.34, wspace=0.16)
    for (left, right), (noise, name) in zip(figure.subplots(2, 2), NOISES.items(), strict=True):
        uvd, R = measurements(FIGURE_1, noise, samples), ASSUMED[RIGHT[noise]].R
        _draw_cloud(left, FIGURE_1, uvd, R, (JOINT, EUCLIDEAN))
        left.set(xlim=(0, 260), ylabel="X, right (m)")
        left.set_title(f"Points measured at {FIGURE_1:g} m, noise: {name}")
        _draw_histogram(right, FIGURE_1, uvd, R)
        right.set(xlim=(0, 260), title="Depth (m): share of the points for 5 m each")
    return figure


@styled
def figure_2(samples: int) -> Figure:
    """Cloud and our region at 15, 30 and 45 m, under the paper's noise."""
    figure = Figure(figsize=(WIDTH_INCHES, 3.1))
    figure.subplots_adjust(left=0.05, right=0.985, top=0.9, bottom=0.155, wspace=0.2)
    for ax, depth, letter in zip(figure.subplots(1, 3), FIGURE_2, "abc", strict=True):
        _draw_cloud(ax, depth, measurements(depth, UVD, samples), ASSUMED[RIGHT[UVD]].R, (JOINT,))
        ax.set_title(f"({letter}) {depth:g} m: X, right, over Z (m)")
    return figure


@styled
def figure_4(results: Mapping[str, Arrays]) -> Figure:
    """Claimed sigma of the depth against the number of updates, and the true error; left near, right far."""

    def draw(ax: Axes, depths: convergence.Depths, label: str) -> None:
        used = depths.label == label
        updates = np.arange(depths.true.shape[1])
        labels = []
        for (name, R), history in depths.filters.items():
            z, sigma = (values[used] for values in depths.depth(history))
            claimed = np.sqrt(np.nanmean(sigma**2, axis=0))
            error = np.sqrt(np.nanmean((z - depths.true[used]) ** 2, axis=0))
            ax.plot(updates[1:], claimed[1:], _style(R), color=COLOURS[name], label=f"{NAMES[name]}, R = {R} (m)")
            ax.plot(
                updates[1:],
                error[1:],
                marker="o" if R == DIAGONAL else "D",
                markerfacecolor=COLOURS[name] if R == DIAGONAL else "white",
                linestyle="none",
                color=COLOURS[name],
                markersize=4,
                label=f"_{NAMES[name]}, R = {R}",
            )
            labels.append(EndLabel(_called(name, R), claimed[-1], COLOURS[name]))
        ax.set_yscale("log")
        plain_log_axis(ax)
        label_ends(ax, labels)

    return _near_and_far(results, draw, "claimed σ of the depth, lines, and true RMS error, markers (m)")


@styled
def figure_5(results: Mapping[str, Arrays]) -> Figure:
    """Depth of one landmark against the number of updates, beside the raw measurements; left near, right far."""

    def draw(ax: Axes, depths: convergence.Depths, label: str) -> None:
        at = convergence.example(depths, label)
        _draw_landmark(ax, depths, at, depths.true[at], "truth")

    return _near_and_far(results, draw, "estimated minus true depth of one landmark (m)")


@styled
def figure_karlsruhe(depths: convergence.Depths) -> Figure:
    """As figures 4 and 5, on real images: claimed sigma, and the depth of one landmark; left near, right far."""
    figure = Figure(figsize=(WIDTH_INCHES, 6.0))
    figure.subplots_adjust(left=0.05, right=0.86, top=0.95, bottom=0.075, hspace=0.25, wspace=0.45)
    for (upper, lower), label in zip(figure.subplots(2, 2).T, convergence.RANGES, strict=True):
        used = np.flatnonzero(depths.label == label)
        upper.set_title(f"{label.capitalize()}: claimed σ of the depth (m), median of {len(used)} landmarks")
        lower.set_title("Depth of one of them against where ours sees it in the end (m)")
        lower.set_xlabel("update")
        if not len(used):
            continue
        labels = []
        for (name, R), history in depths.filters.items():
            sigma = np.nanmedian(depths.depth(history)[1][used], axis=0)
            upper.plot(np.arange(len(sigma)), sigma, _style(R), color=COLOURS[name], label=_called(name, R))
            labels.append(EndLabel(_called(name, R), float(sigma[-1]), COLOURS[name]))
        upper.set_yscale("log")
        plain_log_axis(upper)
        label_ends(upper, labels)
        ours = next(history for (name, R), history in depths.filters.items() if name == JOINT and R != DIAGONAL)
        _draw_landmark(lower, depths, used[0], ours.hindsight[used[0]], "in the end")
    return figure


@styled
def figure_6(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> Figure:
    """Trajectory on the left; yaw, Vx and Vz over the frames on the right: what a filter says of a drive, and truth."""
    figure = Figure(figsize=(WIDTH_INCHES, 4.6))
    track = figure.add_axes((0.055, 0.105, 0.36, 0.83))
    rows = [figure.add_axes((0.5, 0.105 + 0.295 * (2 - row), 0.37, 0.225)) for row in range(3)]
    for series, colour, width, name in ((true, INK, 5.0, "truth"), (said, COLOURS[JOINT], 1.2, NAMES[JOINT])):
        alpha = 0.18 if name == "truth" else 1.0
        drawn: dict[str, Any] = {"color": colour, "linewidth": width, "alpha": alpha, "label": name}
        x, _, z = series["positions"].T
        track.plot(x, z, **drawn)
        frames = np.arange(len(x))
        for ax, values in zip(
            rows, (np.rad2deg(series["yaw"]), series["velocities"][:, 0], series["velocities"][:, 2]), strict=True
        ):
            ax.plot(frames, values, **drawn)
    track.set_aspect("equal", adjustable="datalim")
    track.set(xlabel="x, right (m)", ylabel="z, forward (m)", title="Trajectory, seen from above")
    for ax, title in zip(rows, ("Yaw (°)", "Vx (m/s)", "Vz (m/s)"), strict=True):
        ax.set(title=title, xlim=(0, len(said["yaw"]) - 1))
        ax.tick_params(labelbottom=ax is rows[-1])
    rows[-1].set_xlabel("frame")
    colour_key(rows[0], {"truth": MUTED, "inverse depth": COLOURS[JOINT]})
    return figure


@styled
def figure_nees(results: Mapping[str, Arrays]) -> Figure:
    """Pose NEES of all filters, mean over the drives, with the band of a consistent one."""
    figure = Figure(figsize=(WIDTH_INCHES, 5.4))
    figure.subplots_adjust(left=0.05, right=0.845, top=0.95, bottom=0.085, hspace=0.3)
    panels = figure.subplots(2, 1, sharex=True)
    for ax, (noise, name) in zip(panels, NOISES.items(), strict=True):
        drives = long_drive.drives(results, noise)
        low, high = mean_band(6, len(drives))
        ax.axhspan(low / 6, high / 6, color=BAND, linewidth=0, zorder=0)
        labels = [EndLabel("95 % band", float(np.sqrt(low * high)) / 6, MUTED)]
        for filter_name, R in long_drive.cases(noise):
            nees = np.array([long_drive.one(arrays, f"{filter_name}.{R}")["pose_nees"] for arrays in drives])
            mean = _smoothed(nees.mean(axis=0)[1:]) / 6
            style = "--" if filter_name == JOINT and R == COUPLED else "-"
            text = {JOINT: f"ours, R = {R}", DUAL: "rival, 1 px an eye", EUCLIDEAN: "XYZ"}[filter_name]
            ax.plot(np.arange(1, len(mean) + 1), mean, style, color=COLOURS[filter_name], label=text)
            labels.append(EndLabel(text, float(mean[-1]), COLOURS[filter_name]))
        ax.set_yscale("log")
        ax.set_title(f"Pose NEES / 6, mean of {len(drives)} drives, noise: {name}")
        ax.set_xlim(left=0)
        plain_log_axis(ax)
        label_ends(ax, labels)
    panels[-1].set_xlabel("frame")
    return figure


@styled
def figure_speed(results: Mapping[str, Arrays]) -> Figure:
    """Time of a frame by size of the map, and the ratio of one update with (u, v, d) to two with bearings."""
    measured = speed.milliseconds(results)
    sizes = np.array(list(measured))
    figure = Figure(figsize=(WIDTH_INCHES, 3.6))
    figure.subplots_adjust(left=0.05, right=0.83, top=0.9, bottom=0.14, wspace=0.16)
    times, ratios = figure.subplots(1, 2)
    labels = []
    for number, form in enumerate(speed.FORMS):
        style = ("-", "--", "-.", ":")[number]
        for name in (JOINT, DUAL):
            medians = [float(np.median(measured[n][f"{form}.{name}"])) for n in measured]
            times.plot(
                sizes, medians, style, color=COLOURS[name], marker="o", markersize=3, label=f"{form}, {name} (ms)"
            )
        found = [ratio_interval(measured[n][f"{form}.{JOINT}"], measured[n][f"{form}.{DUAL}"]) for n in measured]
        values = np.array([one.value for one in found])
        spread = np.nan_to_num([[one.value - one.low, one.high - one.value] for one in found]).T
        shifted = sizes * 1.015 ** (number - 1.5)
        ratios.errorbar(shifted, values, spread, fmt=style, color=COLOURS[JOINT], marker="o", markersize=3, label=form)
        labels.append(EndLabel(form, values[-1], COLOURS[JOINT]))
    for ax in (times, ratios):
        ax.set_xscale("log")
        ax.set_xlabel("landmarks")
        ax.set_xticks(sizes, [str(n) for n in sizes])
        ax.minorticks_off()
    times.set_yscale("log")
    plain_log_axis(times)
    times.set_title("Predict + update (ms), ours in blue, rival in red")
    ratios.axhline(1.0, color=MUTED, linewidth=0.9)
    ratios.set_title("Ours over rival, with 95 % interval: below 1 is faster")
    label_ends(ratios, labels)
    return figure


def _draw_cloud(ax: Axes, depth: float, uvd: FloatArray, R: FloatArray, regions: tuple[str, ...]) -> None:
    """The measured points seen from above, depth to the right, with the 95 % regions of (X, Z)."""
    shown = places(EUCLIDEAN, uvd[:SHOWN])
    shown = shown[uvd[:SHOWN, 2] > 0]
    ax.plot(shown[:, 2], shown[:, 0], ".", color=INK, markersize=1.6, alpha=0.5, label="measured (m)")
    angle = np.linspace(0.0, 2 * np.pi, 400)
    circle = np.sqrt(chi2.ppf(CONFIDENCE, 2)) * np.stack([np.cos(angle), np.sin(angle)])
    for name in regions:
        centre, P = landmark(name, CAMERA.project([0.0, 0.0, depth]), R)
        first, last = (0, 2)  # theta and rho, or X and Z: y = 0, phi = 0
        edge = np.tile(centre[:, None], len(angle))
        edge[[first, last]] += np.linalg.cholesky(P[np.ix_([first, last], [first, last])]) @ circle
        if name == JOINT:
            edge = np.where(edge[2] > 0, (ray_direction(edge.T) / edge[2][:, None]).T, np.nan)
        ax.plot(edge[2], edge[0], color=COLOURS[name], label=f"95 %, {NAMES[name]} (m)")
    ax.plot(depth, 0.0, "o", color=INK, markerfacecolor="white", markersize=6, label="truth (m)")
    low, high = np.percentile(shown[:, [0, 2]], [0.3, 99.7], axis=0)
    margin = 0.25 * (high - low)
    ax.set(ylim=(low[0] - margin[0], high[0] + margin[0]), xlim=(low[1] - margin[1], high[1] + margin[1]))
    ax.set(xlabel="Z, forward (m)")


def _draw_landmark(ax: Axes, depths: convergence.Depths, at: int, reference: FloatArray, name: str) -> None:
    """Raw and estimated depths of one landmark over the updates, less the reference (K,)."""
    updates = np.arange(len(reference))
    raw = depths.raw[at] - reference
    mean = float(np.nanmean(raw))
    ax.axhline(0.0, color=INK, alpha=0.18, linewidth=4)
    ax.plot(updates, raw, "o", color=MUTED, markersize=4, label="raw (m)")
    ax.axhline(mean, color=MUTED, linewidth=0.9, linestyle=":")
    labels = [EndLabel(name, 0.0, MUTED), EndLabel("mean of raw", mean, MUTED)]
    for (filter_name, R), history in depths.filters.items():
        depth = depths.depth(history)[0][at] - reference
        ax.plot(updates, depth, _style(R), color=COLOURS[filter_name], label=_called(filter_name, R))
        labels.append(EndLabel(_called(filter_name, R), float(depth[-1]), COLOURS[filter_name]))
    label_ends(ax, labels)


def _style(R: str) -> str:
    return "-" if R == DIAGONAL else "--"


def _called(filter_name: str, R: str) -> str:
    return f"{'ours' if filter_name == JOINT else 'rival'}, {R}"


def _draw_histogram(ax: Axes, depth: float, uvd: FloatArray, R: FloatArray) -> None:
    edges = np.arange(0.0, 305.0, 5.0)
    middle = 0.5 * (edges[1:] + edges[:-1])
    z = places(EUCLIDEAN, uvd)[:, 2]
    counts, _ = np.histogram(z[uvd[:, 2] > 0], edges)
    ax.bar(middle, 100 * counts / len(uvd), 5.0, color=MUTED, alpha=0.35, label="measured (%)")
    for name in (JOINT, EUCLIDEAN):
        centre, P = landmark(name, CAMERA.project([0.0, 0.0, depth]), R)
        with np.errstate(divide="ignore"):
            carriers = 1.0 / edges[::-1] if name == JOINT else edges
        shares = np.diff(norm.cdf((carriers - centre[2]) / np.sqrt(P[2, 2])))
        shares = shares[::-1] if name == JOINT else shares
        ax.step(edges, 100 * np.r_[shares[:1], shares], color=COLOURS[name], label=f"{NAMES[name]} (%)")
    ax.set_xlabel("Z, forward (m)")
    claimed = {"claimed, inverse depth": COLOURS[JOINT], "claimed, XYZ": COLOURS[EUCLIDEAN]}
    _colour_key_inside(ax, {"measured": MUTED} | claimed)


def _colour_key_inside(ax: Axes, colours: Mapping[str, str]) -> None:
    """Names one below the other in the upper right corner."""
    for row, (name, colour) in enumerate(colours.items()):
        ax.text(0.98, 0.95 - 0.09 * row, name, transform=ax.transAxes, color=colour, ha="right", va="top")


def _near_and_far(
    results: Mapping[str, Arrays], draw: Callable[[Axes, convergence.Depths, str], None], what: str
) -> Figure:
    """Rows are noises, columns near and far."""
    figure = Figure(figsize=(WIDTH_INCHES, 6.2))
    figure.subplots_adjust(left=0.05, right=0.9, top=0.9, bottom=0.075, hspace=0.3, wspace=0.4)
    figure.text(0.05, 0.985, what[0].upper() + what[1:], color=MUTED, va="top")
    for row, (noise, name) in zip(figure.subplots(2, 2), NOISES.items(), strict=True):
        depths = convergence.gathered(results, noise)
        for ax, (label, (low, high)) in zip(row, convergence.RANGES.items(), strict=True):
            draw(ax, depths, label)
            ax.set_title(f"{label.capitalize()}, {low:g}–{high:g} m, noise: {name}")
            ax.set_xlabel("update")
    return figure


def _smoothed(values: FloatArray, frames: int = 10) -> FloatArray:
    """Running mean, shorter at the ends."""
    window = np.ones(min(frames, len(values)))
    mean: FloatArray = np.convolve(values, window, "same") / np.convolve(np.ones(len(values)), window, "same")
    return mean
