"""Figures of docs/concepts.md and docs/nees.md.

Everything in them is computed by the package: its camera, its filters, its gate, its criterion, its plots.
"""

from __future__ import annotations

import copy
import csv
import io
from collections.abc import Callable
from functools import cache
from pathlib import Path

import gymnasium as gym
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2, norm

from filters import Start, StereoCamera, StereoFilter, StereoNoise, StereoObservation, make_filter
from stereo_slam_env.benchmark import long_drive
from stereo_slam_env.envs import InformationCriterion, log_det
from stereo_slam_env.evaluation import FilterRun, run_filter
from stereo_slam_env.report import BAND, INK, MUTED, Chart, filter_colours, plot_error_bounds, plot_nees
from stereo_slam_env.viewer import style_context

WIDTH_INCHES = 10.4
BLUE, ORANGE, GREEN = COLOURS = tuple(filter_colours(("inverse-depth", "dual-bearing", "euclidean")).values())
CAMERA = StereoCamera(fx=721.5, fy=721.5, cx=672.0, cy=196.0, baseline=0.571, width=1344, height=391)
FULL_R = StereoNoise.independent_pixels(1.0)
SIGMA_D = float(np.sqrt(FULL_R.R[2, 2]))


@style_context()
def stereo_geometry() -> Figure:
    """Two eyes and a point from above; and what a pixel of disparity is worth in metres."""
    figure = Figure(figsize=(WIDTH_INCHES, 3.6))
    above, curve = figure.subplots(1, 2, width_ratios=(1, 1.25))
    figure.subplots_adjust(left=0.05, right=0.985, bottom=0.14, top=0.9, wspace=0.16)
    baseline, focal = 1.0, 1.1  # drawn out of scale: a real baseline would be a dot
    eyes = np.array([0.0, baseline])
    for x, name in zip(eyes, ("left eye", "right eye"), strict=True):
        above.plot([x - 0.42, x + 0.42], [focal, focal], color=MUTED, linewidth=2)
        above.plot([x], [0], "o", color=INK)
        above.annotate(name, (x, 0), (0, -14), textcoords="offset points", ha="center")
    for point, colour, name in (((0.62, 3.2), BLUE, "near: d is large"), ((0.9, 6.6), ORANGE, "far: d is small")):
        for x in eyes:
            above.plot([x, point[0]], [0, point[1]], color=colour)
            above.plot([x + (point[0] - x) * focal / point[1]], [focal], "|", color=colour, markersize=11, mew=2.2)
        above.plot(*point, "o", color=colour, markersize=7)
        above.annotate(name, point, (9, -3), textcoords="offset points", color=colour)
    above.annotate("b", (0.5, -0.05), (0, -14), textcoords="offset points", ha="center", fontweight="bold")
    above.annotate("images", (-0.45, focal), (-4, 0), textcoords="offset points", color=MUTED, ha="right", va="center")
    above.set(title="From above:  d = u_left − u_right = f b / z", xlim=(-1.3, 3.0), ylim=(-0.75, 7.2))
    above.grid(visible=False)
    above.set_xticks([])
    above.set_yticks([])
    above.set_ylabel("z, forward")

    d = np.linspace(2.0, 45.0, 400)
    curve.fill_between(d, _depth(d + SIGMA_D), _depth(np.maximum(d - SIGMA_D, 0.4)), color=BAND, label="± 1 sigma")
    curve.plot(d, _depth(d), color=BLUE)
    for z, offset in ((10.0, (-140, 20)), (50.0, (10, 4)), (100.0, (10, 0))):
        at = _disparity(z)
        half = 0.5 * (_depth(at - SIGMA_D) - _depth(at + SIGMA_D))
        curve.plot([at], [z], "o", color=BLUE)
        curve.annotate(f"{z:.0f} m: d = {at:.1f} px, ± {half:.2g} m", (at, z), offset, textcoords="offset points")
    curve.set(
        title=f"Depth (m) of a disparity, with an error of {SIGMA_D:.1f} px", xlabel="disparity d (px)", ylim=(0, 160)
    )
    return figure


@style_context()
def depth_not_gaussian() -> Figure:
    """The same measurement as depth and as inverse depth, near, farther, far."""
    figure = Figure(figsize=(WIDTH_INCHES, 4.3))
    panels = figure.subplots(2, 3)
    figure.subplots_adjust(left=0.03, right=0.985, bottom=0.11, top=0.93, wspace=0.1, hspace=0.62)
    for column, z in enumerate((20.0, 60.0, 120.0)):
        d = _disparity(z)
        sigma_z = _depth(d) * SIGMA_D / d
        depths = np.linspace(max(0.5, z - 4 * sigma_z), z + (4 if column == 0 else 5) * sigma_z, 600)
        true = norm.pdf(_disparity(depths), d, SIGMA_D) * CAMERA.disparity_constant / depths**2
        _two_densities(panels[0, column], depths, true, norm.pdf(depths, z, sigma_z))
        panels[0, column].set(title=f"{z:.0f} m away, d = {d:.1f} px", xlabel="depth z (m)")
        inverse = np.linspace(d - 4 * SIGMA_D, d + 4 * SIGMA_D, 400) / CAMERA.disparity_constant
        density = norm.pdf(inverse * CAMERA.disparity_constant, d, SIGMA_D)
        _two_densities(panels[1, column], inverse, density, density)
        panels[1, column].axvline(0.0, color=MUTED, linewidth=0.8)
        panels[1, column].set(xlabel="inverse depth 1/z (1/m)", xlim=(inverse[0], inverse[-1]))
    panels[0, 0].annotate("what d says", (0.7, 0.84), xycoords="axes fraction", color=BLUE)
    panels[0, 0].annotate("the Gaussian\nof XYZ", (0.7, 0.58), xycoords="axes fraction", color=ORANGE)
    panels[1, 0].annotate("both", (0.02, 0.86), xycoords="axes fraction", color=BLUE)
    return figure


@style_context()
def inverse_depth() -> Figure:
    """Where a point may be after one look, from above: samples, and the two claims about them."""
    figure = Figure(figsize=(WIDTH_INCHES, 3.1))
    panels = figure.subplots(1, 3)
    figure.subplots_adjust(left=0.065, right=0.985, bottom=0.16, top=0.88, wspace=0.2)
    rng = np.random.default_rng(3)
    angle = np.linspace(0, 2 * np.pi, 200)
    circle = np.sqrt(chi2.ppf(0.95, 2)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = np.ix_([0, 2], [0, 2])
    for ax, z in zip(panels, (20.0, 60.0, 120.0), strict=True):
        uvd = CAMERA.project([0.0, 0.0, z])
        samples = _from_above(uvd + rng.multivariate_normal(np.zeros(3), FULL_R.R, 250))
        ax.plot(*samples.T, ".", color=MUTED, markersize=2.5, alpha=0.7)
        edge = np.insert(uvd[[0, 2]] + circle @ np.linalg.cholesky(FULL_R.R[rows]).T, 1, uvd[1], axis=1)
        ax.plot(*_from_above(edge).T, color=BLUE)
        J = np.linalg.inv(CAMERA.project_jacobian([0.0, 0.0, z]))
        ellipse = [0.0, z] + circle @ np.linalg.cholesky((J @ FULL_R.R @ J.T)[rows]).T
        ax.plot(ellipse[:, 1], 100 * ellipse[:, 0], color=ORANGE, linestyle=(0, (4, 2)))
        ax.plot([z], [0.0], "o", color=INK, markersize=5)
        ax.set(title=f"{z:.0f} m away", xlabel="z, forward (m)", xlim=(max(0.0, ellipse[:, 1].min() - 0.1 * z), None))
    panels[2].set_xlim(0, 400)
    panels[2].set_ylim(-60, 60)
    panels[0].set_ylabel("x, sideways (cm)")
    panels[0].annotate("95 % of what d says", (0.03, 0.05), xycoords="axes fraction", color=BLUE)
    panels[0].annotate("95 % ellipse of XYZ", (0.03, 0.15), xycoords="axes fraction", color=ORANGE)
    return figure


@style_context()
def anchors() -> Figure:
    """Landmarks hang on the place from where they were first seen."""
    figure = Figure(figsize=(WIDTH_INCHES, 3.3))
    ax = figure.add_axes((0.02, 0.04, 0.96, 0.86))
    path = np.array([[0, 0], [2.4, 0.1], [4.8, 0.5], [7.1, 1.3], [9.2, 2.5]])
    seen = {0: [[6.4, 2.9], [8.3, -1.2], [5.2, -2.0]], 2: [[11.6, 3.4], [12.4, 0.6]]}
    ax.plot(*path.T, color=MUTED, linewidth=1, linestyle=(0, (4, 3)))
    for (frame, points), colour in zip(seen.items(), (BLUE, ORANGE), strict=True):
        anchor = path[frame]
        for number, point in enumerate(points):
            ax.annotate("", point, anchor, arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.2})
            ax.plot(*point, "*", color=colour, markersize=11)
            if number == 0:
                ax.annotate("(θ, φ, ρ)", point, (8, 4), textcoords="offset points", color=colour)
        ax.annotate(f"anchor of {len(points)}", anchor, (-14, 22), textcoords="offset points", color=colour)
    for frame, place in enumerate(path):
        ax.plot(*place, "s", color=(BLUE, MUTED, ORANGE, MUTED, INK)[frame], markersize=8)
    ax.annotate("camera now", path[-1], (-8, 12), textcoords="offset points", ha="right")
    ax.set(title="5 landmarks, 2 anchors: 6 n = 30 numbers, or 3 n + 3 k = 21 with the anchor kept once")
    ax.set(xlim=(-0.8, 13.6), ylim=(-2.6, 4.1), xticks=[], yticks=[])
    return figure


@style_context()
def gate() -> Figure:
    """Innovations in their ellipse, and those that are not believed."""
    figure = Figure(figsize=(WIDTH_INCHES, 3.6))
    plane, along = figure.subplots(1, 2, width_ratios=(1, 1.25))
    figure.subplots_adjust(left=0.06, right=0.985, bottom=0.14, top=0.9, wspace=0.16)
    rng = np.random.default_rng(5)
    predicted = np.diag([9.0, 1.0, 1.0])  # a pose known to 3 px sideways
    S = predicted + FULL_R.R
    good, bad = rng.multivariate_normal(np.zeros(3), S, 400), rng.uniform(-14, 14, (25, 3))
    limit = chi2.ppf(0.99, 3)
    for innovations, colour, name in ((good, BLUE, "right"), (bad, ORANGE, "wrong match")):
        distances = np.einsum("mi,mi->m", innovations, np.linalg.solve(S, innovations.T).T)
        inside = distances <= limit
        plane.plot(*innovations[inside][:, [0, 2]].T, ".", color=colour, label=name)
        plane.plot(*innovations[~inside][:, [0, 2]].T, "x", color=colour, markersize=5)
        along.hist(np.minimum(distances, 39), bins=np.arange(0, 41, 1.0), color=colour, alpha=0.7, density=True)
    angle = np.linspace(0, 2 * np.pi, 200)
    edge = np.sqrt(limit) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edge = edge @ np.linalg.cholesky(S[np.ix_([0, 2], [0, 2])]).T
    plane.plot(*edge.T, color=INK)
    plane.set(
        title="Innovations (px), crosses are refused", xlabel="of u", ylabel="of d", xlim=(-15, 15), ylim=(-15, 15)
    )
    along.axvline(limit, color=INK)
    along.annotate(
        f"gate 0.99: {limit:.1f}", (limit, 0.9), (6, 0), along.get_xaxis_transform(), textcoords="offset points"
    )
    along.annotate("right matches", (0.16, 0.45), xycoords="axes fraction", color=BLUE)
    along.annotate("wrong ones; the last bar is all beyond", (0.42, 0.45), xycoords="axes fraction", color=ORANGE)
    along.set(title="Their squared distance  νᵀ S⁻¹ ν", xlabel="squared standard deviations", yticks=[])
    return figure


@style_context()
def information_gain() -> Figure:
    """What one more look would tell, by where one looks."""
    gains = look_gains()
    figure = Figure(figsize=(WIDTH_INCHES, 2.7))
    panels = figure.subplots(1, len(gains), sharey=True)
    figure.subplots_adjust(left=0.17, right=0.985, bottom=0.1, top=0.88, wspace=0.1)
    for ax, (subject, by_look), colour in zip(panels, gains.items(), COLOURS, strict=True):
        names = list(by_look)[::-1]
        ax.barh(names, [by_look[name] for name in names], color=colour, height=0.6)
        for row, name in enumerate(names):
            ax.annotate(f"{by_look[name]:.1f}", (by_look[name], row), (4, 0), textcoords="offset points", va="center")
        ax.set(title=f"Learnt about the {subject}, nats", xlim=(0, 1.2 * max(by_look.values())))
        ax.grid(visible=False, axis="y")
        ax.tick_params(axis="y", labelcolor=INK)
    return figure


@cache
def look_gains() -> dict[str, dict[str, float]]:
    """By how much ln det of what is left unknown falls, by subject and look; nats."""
    known = np.array([[-3.0, 0.5, 10.0], [4.0, -1.0, 35.0], [-15.0, -2.0, 120.0]])
    new = np.array([[3.0, 0.5, 10.0]])
    slam = make_filter("shared-anchor", camera=CAMERA, noise=FULL_R, drop_unseen=False)
    slam.reset(Start(linear_velocity=(0.0, 0.0, 5.0)))
    for _ in range(5):  # some looks at all three, then a second in the dark
        slam.update(StereoObservation(np.arange(3), CAMERA.project(known - slam.pose.position)))
        slam.predict(0.02)
    for _ in range(10):
        slam.predict(0.1)
    looks = {
        f"again at one {point[2]:.0f} m away": (np.array([k]), slam.forecast(np.array([k])).uvd)
        for k, point in enumerate(known)
    }
    looks["at a new one, 10 m away"] = (np.array([3]), CAMERA.project(new))
    before = _unknown(slam)
    gains: dict[str, dict[str, float]] = {subject: {} for subject in before}
    for name, (ids, uvd) in looks.items():
        after = copy.deepcopy(slam)
        after.update(StereoObservation(ids, uvd))
        for subject, left in _unknown(after).items():
            gains[subject][name] = before[subject] - left
    return gains


def _unknown(slam: StereoFilter) -> dict[str, float]:
    P = slam.joint_covariance(slam.landmarks.ids)
    return {
        "position": log_det(P[:3, :3]),
        "orientation": log_det(P[3:6, 3:6]),
        "pose and map": InformationCriterion("log-det").potential(P),
    }


def nees() -> Chart:
    """A filter that knows how wrong it is, and three that do not."""
    return plot_nees(runs())


def error_bounds_consistent() -> Chart:
    """Errors of one drive inside the 3 sigma that the filter claims."""
    return plot_error_bounds(next(run for run in runs() if run.filter_name == RIGHT))


def error_bounds_overconfident() -> Chart:
    """Errors of the same drive, of a filter that is too sure."""
    return plot_error_bounds(next(run for run in runs() if run.filter_name == XYZ))


RIGHT, XYZ = "right R", "XYZ, d ≥ 5 px"


@cache
def runs(seeds: int = 12, frames: int = 240, landmarks: int = 30) -> tuple[FilterRun, ...]:
    """Four filters on the same drives, with errors of 1 px."""
    made = []
    for seed in range(seeds):
        recording = long_drive(seed, "pixels", frames=frames, landmarks=landmarks)
        for label, name, noise, options in (
            (RIGHT, "inverse-depth", FULL_R, {}),
            ("half the sigma", "inverse-depth", StereoNoise.independent_pixels(0.5), {}),
            ("twice the sigma", "inverse-depth", StereoNoise.independent_pixels(2.0), {}),
            (XYZ, "euclidean", FULL_R, {"min_disparity": 5.0}),
        ):
            made.append(
                run_filter(
                    recording, name, {"gate": None, **options}, label=label, noise=noise, score_map=False, seed=seed
                )
            )
    return tuple(made)


WORLDS_AND_BELIEFS = {
    ("white", "shared-anchor"): "White errors",
    ("lasting", "shared-anchor"): "Errors that last",
    ("lasting", "coloured-noise"): "The same, told what lasts",
}
"""Panels of `claimed_and_true`: world and belief, and a title."""


@style_context()
def claimed_and_true() -> Figure:
    """What policies of gaze claim to gain against a fixed gaze, and what they gain by the truth.

    `results/active_policies.csv` is what `benchmarks/active_policies.py` has written.
    """
    figure = Figure(figsize=(WIDTH_INCHES, 3.8))
    panels = figure.subplots(1, len(WORLDS_AND_BELIEFS))
    figure.subplots_adjust(left=0.08, right=0.99, bottom=0.14, top=0.9, wspace=0.2)
    with (Path(__file__).resolve().parents[2] / "results" / "active_policies.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for ax, (case, title) in zip(panels, WORLDS_AND_BELIEFS.items(), strict=True):
        ax.axline((0, 0), slope=1, color=MUTED, linestyle="--", linewidth=1.0)
        ax.axhline(0, color=MUTED, linewidth=0.6)
        here = [row for row in rows if (row["world"], row["belief"]) == case]
        for row in here:
            x, y = float(row["claimed"]), float(row["true"])
            spread = [[x - float(row["claimed_low"])], [float(row["claimed_high"]) - x]]
            height = [[y - float(row["true_low"])], [float(row["true_high"]) - y]]
            ax.errorbar(x, y, xerr=spread, yerr=height, fmt="o", markersize=4, color=BLUE, capsize=2)
            ax.annotate(row["policy"], (x, y), (x - 1.2, y + 1.2), color=BLUE, ha="right")
        ax.set(title=f"{title}: {here[0]['drives']} drives", xlim=(-45, 12), ylim=(-45, 16))
        ax.set_xlabel("change of the claimed sigma, %")
    panels[0].annotate("as claimed", (-6, 2), color=MUTED, ha="right")
    panels[0].set_ylabel("change of the true end error, %")
    return figure


@style_context()
def grids() -> Figure:
    """Six grids of streets of `Branches-v0`, by a drive through all of their roads; the dot is the start."""
    figure = Figure(figsize=(WIDTH_INCHES, 5.0))
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.93, wspace=0.05, hspace=0.2)
    vector = gym.make_vec("StereoSlam/Branches-v0", num_envs=6)
    vector.reset(seed=0)
    for row, ax in enumerate(figure.subplots(2, 3).flat):
        route = vector.unwrapped.rows.world.route_of(row)
        ax.plot(route.positions[:, 0], route.positions[:, 2], color=BLUE, linewidth=1.2)
        ax.plot(0.0, 0.0, "o", color=ORANGE, markersize=6)
        ax.set(title=f"{route.streets.count} roads of {route.streets.slots}", aspect="equal")
        ax.set_axis_off()
    vector.close()
    return figure


FIGURES: tuple[Callable[[], Figure | Chart], ...] = (
    stereo_geometry,
    depth_not_gaussian,
    inverse_depth,
    anchors,
    gate,
    claimed_and_true,
    grids,
    information_gain,
    nees,
    error_bounds_consistent,
    error_bounds_overconfident,
)


def _depth(d: np.ndarray | float) -> np.ndarray | float:
    return CAMERA.disparity_constant / d


def _disparity(z: np.ndarray | float) -> np.ndarray | float:
    return CAMERA.disparity_constant / z


def _from_above(uvd: np.ndarray) -> np.ndarray:
    """z in m and x in cm of measurements; those near d = 0 are left out, they are anywhere."""
    points = CAMERA.backproject(uvd[uvd[:, 2] > 0.3])
    return np.stack([points[:, 2], 100 * points[:, 0]], axis=1)


def _two_densities(ax: Axes, x: np.ndarray, true: np.ndarray, claimed: np.ndarray) -> None:
    ax.fill_between(x, 0, true, color=BLUE, alpha=0.25, linewidth=0)
    ax.plot(x, true, color=BLUE)
    ax.plot(x, claimed, color=ORANGE, linestyle=(0, (4, 2)))
    ax.set(yticks=[], ylim=(0, None), xlim=(x[0], x[-1]))


def svg_of(figure: Figure) -> str:
    """The drawing on white, with its texts as text."""
    buffer = io.StringIO()
    with style_context():
        figure.savefig(buffer, format="svg", facecolor="white", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def save(draw: Callable[[], Figure | Chart], path: Path) -> None:
    """Draw a figure and write it as SVG."""
    figure = draw()
    if isinstance(figure, Chart):
        figure.save(path)
    else:
        path.write_text(svg_of(figure), encoding="utf-8")
