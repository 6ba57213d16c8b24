"""Charts of the paper, in its layout, from what was measured here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.stats import chi2, norm

from stereo_slam_env.benchmark import CONFIDENCE
from stereo_slam_env.evaluation import mean_band
from stereo_slam_env.paper import convergence, long_drive, speed
from stereo_slam_env.paper.drives import Setting
from stereo_slam_env.paper.landmark_uncertainty import (
    ASSUMED,
    CAMERA,
    FIGURE_1,
    FIGURE_2,
    landmark,
    measurements,
    places,
    points,
)
from stereo_slam_env.paper.paper_claims import (
    DIAGONAL,
    DUAL,
    EUCLIDEAN,
    FILTER_NAMES,
    JOINT,
    NOISES,
    OWN,
    PAZ,
    REAL,
    RENDERED,
    RIGHT,
    SIMULATION,
    UVD,
    Arrays,
    FloatArray,
    ratio_interval,
)
from stereo_slam_env.report import (
    BAND,
    DASHED,
    INK,
    MUTED,
    WIDTH,
    Axis,
    BoxMark,
    Chart,
    Curve,
    Panel,
    figure,
    filter_colours,
    label_room,
    log_axis,
    panel_width,
)

COLOURS = filter_colours((JOINT, DUAL, EUCLIDEAN, PAZ))
NAMES = FILTER_NAMES
_SHORT = {JOINT: "ours", DUAL: "two bearings", PAZ: "Paz", EUCLIDEAN: "XYZ"}
SHOWN = 1000
"""Points of a cloud that are drawn: all of them would make the picture heavy, not clearer."""
Dash = tuple[float, ...]
_FORM_DASHES: tuple[Dash, ...] = ((), DASHED, (7, 3, 1, 3), (2, 3))
_DEPTHS = (0.0, 260.0)
"""What figure 1 shows, m."""


def figure_1(samples: int) -> Chart:
    """Cloud and regions of a point at 70 m, and the histogram of its depth; one row a noise, each with its right R."""
    panels = []
    width = panel_width(2, 10.0)
    for noise, name in NOISES.items():
        uvd, R = measurements(FIGURE_1, noise, samples), ASSUMED[RIGHT[noise]].R
        cloud = _cloud_panel(FIGURE_1, uvd, R, (JOINT, EUCLIDEAN), width, f"At {FIGURE_1:g} m, noise: {name}", _DEPTHS)
        panels += [cloud, _histogram(FIGURE_1, uvd, R, width)]
    return figure(panels, {NAMES[name]: COLOURS[name] for name in (JOINT, EUCLIDEAN)}, columns=2)


def figure_2(samples: int) -> Chart:
    """Cloud and our region at 15, 30 and 45 m, under the paper's noise."""
    panels = []
    for depth, letter in zip(FIGURE_2, "abc", strict=True):
        uvd, R = measurements(depth, UVD, samples), ASSUMED[RIGHT[UVD]].R
        panels.append(_cloud_panel(depth, uvd, R, (JOINT,), panel_width(3, 10.0), f"({letter}) {depth:g} m"))
    return figure(panels)


def figure_4(results: Mapping[str, Arrays]) -> Chart:
    """Claimed sigma of the depth against the number of updates, and the true error; left near, right far."""

    def draw(depths: convergence.Depths, label: str, title: str, width: float) -> Panel:
        used = depths.label == label
        updates = np.arange(1, depths.true.shape[1])
        claims, errors = [], []
        for (name, R), history in depths.filters.items():
            z, sigma = (values[used] for values in depths.depth(history))
            simulated = depths.setting.place == SIMULATION
            claimed = _typical(sigma, simulated)[1:]
            called = _called(name, R)
            claims.append((Curve(called, updates, claimed, COLOURS[name], said=f"{called}: claimed σ"), _dash(R)))
            if np.isfinite(depths.true[used]).all():
                error = _typical(z - depths.true[used], simulated)[1:] / (1.0 if simulated else float(norm.ppf(0.75)))
                errors.append(
                    (Curve(called, updates, error, COLOURS[name], said=f"{called}: true error"), R != DIAGONAL)
                )
        y = log_axis(np.asarray(curve.y) for curve, _ in (*claims, *errors))
        panel = Panel(Axis(0, float(updates[-1]), "update"), y, width, 190.0, title)
        _draw_lines(panel, claims)
        for curve, hollow in errors:
            panel.dots([curve], hollow=hollow)
        return panel

    return _near_and_far(results, draw, "Claimed σ of the depth, lines, and true error, markers (m)")


def figure_5(results: Mapping[str, Arrays]) -> Chart:
    """Depth of one landmark against the number of updates, beside the raw measurements; left near, right far."""

    def draw(depths: convergence.Depths, label: str, title: str, width: float) -> Panel:
        at = convergence.example(depths, label)
        if np.isfinite(depths.true[at]).all():
            return _landmark_panel(depths, at, depths.true[at], "truth", title, width)
        visible = depths.filters[JOINT, depths.setting.right].hindsight[at]
        return _landmark_panel(depths, at, visible, "in the end", title, width)

    what = "Estimated less true depth of one landmark (m); real: less where ours sees it in the end"
    return _near_and_far(results, draw, what)


def figure_6(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> Chart:
    """Trajectory; yaw, Vx and Vz over the frames below it: what a filter says of a drive, and truth."""
    keys = {"truth": MUTED, NAMES[JOINT]: COLOURS[JOINT]}
    room = label_room(keys)
    both = ((true, INK, "truth", 6.0, 0.18), (said, COLOURS[JOINT], NAMES[JOINT], 1.5, 1.0))
    x, _, z = np.concatenate([true["positions"], said["positions"]]).T
    scale = min(420.0 / (np.ptp(x) + 4.0), 420.0 / (np.ptp(z) + 4.0))
    track = Panel(
        _around(x, "x, right (m)"),
        _around(z, "z, forward (m)"),
        max(scale * (np.ptp(x) + 4.0), 120.0),
        max(scale * (np.ptp(z) + 4.0), 120.0),
        "Trajectory, seen from above",
    )
    for series, colour, name, width, opacity in both:
        places_w = series["positions"]
        track.lines([Curve(name, places_w[:, 0], places_w[:, 2], colour, width=width, opacity=opacity)])
    panels = [track]
    rows: tuple[tuple[str, Callable[[Mapping[str, FloatArray]], FloatArray]], ...] = (
        ("Yaw (°)", lambda series: np.rad2deg(series["yaw"])),
        ("Vx (m/s)", lambda series: series["velocities"][:, 0]),
        ("Vz (m/s)", lambda series: series["velocities"][:, 2]),
    )
    for title, values in rows:
        curves = [
            Curve(name, np.arange(len(values(series))), values(series), colour, width=width, opacity=opacity)
            for series, colour, name, width, opacity in both
        ]
        last = len(said["yaw"]) - 1.0
        y = _around(np.concatenate([np.asarray(curve.y) for curve in curves]), "")
        panel = Panel(Axis(0, last, "frame"), y, WIDTH - 60 - room, 110.0, title)
        panel.lines(curves)
        panels.append(panel)
    panels[1].colour_key(keys)
    return figure(panels, keys, columns=1)


def figure_nees(results: Mapping[str, Arrays]) -> Chart:
    """Pose NEES of the filters in each setting, mean over its drives, with the band of a consistent filter."""
    judged = [one for one in long_drive.settings(results) if np.isfinite(one.of(*_ours(one), "pose_nees")).any()]
    cases = [(JOINT, False), (JOINT, True), (DUAL, True), (PAZ, True), (EUCLIDEAN, True)]
    keys = {
        f"{_SHORT[name]}, {'right R' if right else 'other R'}" if name == JOINT else _SHORT[name]: COLOURS[name]
        for name, right in cases
    }
    panels = []
    for one in judged:
        setting, lines = one.setting, []
        (other,) = set(setting.levels) - {setting.right}
        for text, (name, right) in zip(keys, cases, strict=True):
            nees = np.array([arrays[f"{name}.{setting.right if right else other}.nees"] for arrays in one.by_drive])
            finite = np.isfinite(nees)
            with np.errstate(invalid="ignore"):
                mean = _smoothed((np.where(finite, nees, 0.0).sum(axis=0) / finite.sum(axis=0))[1:]) / 6
            curve = Curve(text, np.arange(1, len(mean) + 1), mean, keys[text])
            lines.append((curve, () if right else DASHED))
        low, high = (end / 6 for end in mean_band(6, len(nees)))
        values = [np.where(np.asarray(curve.y) > 0.0, curve.y, np.nan) for curve, _ in lines]
        y = log_axis([*values, np.array([low, high])])
        title = f"Pose NEES / 6, {_where(setting, len(nees))}"
        width = panel_width(1, label_room([*keys, "95 % band"]))
        panel = Panel(Axis(0, nees.shape[1] - 1.0, "frame"), y, width, 200.0, title)
        panel.boxes([BoxMark(0, nees.shape[1] - 1.0, low, high, BAND)])
        _draw_lines(panel, lines, ("95 % band", float(np.sqrt(low * high)), MUTED))
        panels.append(panel)
    return figure(panels, keys, columns=1)


def _where(setting: Setting, drives: int) -> str:
    if setting.place == REAL:
        return f"real drive: {setting.condition['drive']}"
    of = "rendered images" if setting.place == RENDERED else f"noise: {setting.condition['noise']}"
    return f"mean of {drives} drives, {of}" if drives > 1 else f"one drive, {of}"


def _ours(one: long_drive.DriveResults) -> tuple[str, str]:
    return JOINT, one.setting.right


def figure_speed(results: Mapping[str, Arrays]) -> Chart:
    """Time of a frame by size of the map, and the ratio of one update with (u, v, d) to two with bearings."""
    measured = speed.milliseconds(results)
    sizes = np.array(list(measured), dtype=np.float64)
    times, ratios = [], []
    for number, (form, dash) in enumerate(zip(speed.FORMS, _FORM_DASHES, strict=False)):
        for name in (JOINT, *speed.RIVALS[form]):
            medians = [float(np.median(measured[n][f"{form}.{name}.both"])) for n in measured]
            legend = f"{form}, {NAMES[name]}"
            times.append((Curve(form, sizes, medians, COLOURS[name], said=legend), dash))
        for rival, shift in zip(speed.RIVALS[form], (0.985, 1.015), strict=False):
            curves = [
                ratio_interval(one[f"{form}.{JOINT}.both"], one[f"{form}.{rival}.both"]) for one in measured.values()
            ]
            ends = np.array([(one.value, one.low, one.high) for one in curves]).T
            low, high = (np.where(np.isfinite(end), end, ends[0]) for end in ends[1:])
            places = sizes * shift * 1.03 ** (number - 0.5)
            ratios.append((Curve(form, places, ends[0], COLOURS[rival], low, high), dash))
    width = panel_width(2, label_room(speed.FORMS))
    margin = (sizes.max() / sizes.min()) ** 0.05 if len(sizes) > 1 else 1.1
    x = Axis(sizes.min() / margin, sizes.max() * margin, "landmarks", log=True, ticks=sizes.tolist())
    title = "Predict + update, ms (dashed: shared anchors)"
    panel = Panel(x, log_axis(np.asarray(curve.y) for curve, _ in times), width, 240.0, title)
    everything = np.concatenate([np.ravel([curve.low, curve.high]) for curve, _ in ratios] + [np.ones(1)])
    top = 0.08 * float(np.ptp(everything)) + 0.02
    y = Axis(max(float(everything.min()) - top, 0.0), float(everything.max()) + top)
    right = Panel(x, y, width, 240.0, "Ours over the competitor, with 95 % interval")
    right.rule(y=1.0)
    for curve, dash in times:
        panel.lines([curve], dash)
    panel.dots([curve for curve, _ in times], 22)
    _draw_lines(right, ratios)
    right.intervals([curve for curve, _ in ratios])
    right.dots([curve for curve, _ in ratios], 22)
    return figure([panel, right], {_SHORT[name]: COLOURS[name] for name in (JOINT, DUAL, PAZ)}, columns=2)


def _cloud_panel(
    depth: float,
    uvd: FloatArray,
    R: FloatArray,
    regions: tuple[str, ...],
    width: float,
    title: str,
    depths: tuple[float, float] | None = None,
) -> Panel:
    """The measured points seen from above, depth to the right, with the 95 % regions of (X, Z)."""
    points_shown = places(EUCLIDEAN, uvd[:SHOWN])[uvd[:SHOWN, 2] > 0]
    low, high = np.percentile(points_shown[:, [0, 2]], [0.3, 99.7], axis=0)
    margin = 0.25 * (high - low)
    x = depths or (float(low[1] - margin[1]), float(high[1] + margin[1]))
    y = Axis(float(low[0] - margin[0]), float(high[0] + margin[0]), "X, right (m)")
    panel = Panel(Axis(*x, "Z, forward (m)"), y, width, 210.0, title)
    panel.dots([Curve("", points_shown[:, 2], points_shown[:, 0], INK, opacity=0.45, said="measured")], 3)
    angle = np.linspace(0.0, 2 * np.pi, 400)
    circle = np.sqrt(chi2.ppf(CONFIDENCE, 2)) * np.stack([np.cos(angle), np.sin(angle)])
    for name in regions:
        centre, P = landmark(name, CAMERA.project([0.0, 0.0, depth]), R)
        first, last = (0, 2)  # theta and rho, or X and Z: y = 0, phi = 0
        edge = np.tile(centre[:, None], len(angle))
        edge[[first, last]] += np.linalg.cholesky(P[np.ix_([first, last], [first, last])]) @ circle
        if name == JOINT:
            edge = np.where(edge[2] > 0, points(edge.T).T, np.nan)
        panel.lines([Curve(NAMES[name], edge[2], edge[0], COLOURS[name], said=f"95 %, {NAMES[name]}")])
    panel.dots([Curve("", [depth], [0.0], INK, said="truth")], 50, hollow=True)
    return panel


def _histogram(depth: float, uvd: FloatArray, R: FloatArray, width: float) -> Panel:
    """Shares of the points by depth, and what both parametrisations claim of them."""
    edges = np.arange(0.0, 305.0, 5.0)
    z = places(EUCLIDEAN, uvd)[:, 2]
    counts, _ = np.histogram(z[uvd[:, 2] > 0], edges)
    measured = 100 * counts / len(uvd)
    claims = {}
    for name in (JOINT, EUCLIDEAN):
        centre, P = landmark(name, CAMERA.project([0.0, 0.0, depth]), R)
        with np.errstate(divide="ignore"):
            carriers = 1.0 / edges[::-1] if name == JOINT else edges
        shares = np.diff(norm.cdf((carriers - centre[2]) / np.sqrt(P[2, 2])))
        claims[name] = 100 * (shares[::-1] if name == JOINT else shares)
    top = 1.08 * max(float(measured.max()), *(float(share.max()) for share in claims.values()))
    title = "Depth: share of the points for 5 m each (%)"
    panel = Panel(Axis(*_DEPTHS, "Z, forward (m)"), Axis(0, top), width, 210.0, title)
    panel.boxes(
        BoxMark(low, low + 5.0, 0.0, float(share), MUTED, opacity=0.35)
        for low, share in zip(edges[:-1], measured, strict=True)
        if share > 0
    )
    for name, shares in claims.items():
        stairs = np.repeat(edges, 2)[1:-1], np.repeat(shares, 2)
        panel.lines([Curve(NAMES[name], *stairs, COLOURS[name], said=f"claimed, {NAMES[name]}")])
    words = {"measured": MUTED, "claimed, inverse depth": COLOURS[JOINT], "claimed, XYZ": COLOURS[EUCLIDEAN]}
    for row, (text, colour) in enumerate(words.items()):
        panel.text(text, width - 8, 14 + 18 * row, colour, align="right")
    return panel


def _landmark_panel(
    depths: convergence.Depths, at: int, reference: FloatArray, name: str, title: str, width: float
) -> Panel:
    """Raw and estimated depths of one landmark over the updates, less the reference (K,)."""
    updates = np.arange(len(reference))
    raw = depths.raw[at] - reference
    mean = float(np.nanmean(raw))
    lines = [
        (Curve(_called(of, R), updates, depths.depth(history)[0][at] - reference, COLOURS[of]), _dash(R))
        for (of, R), history in depths.filters.items()
    ]
    y = _around(np.concatenate([raw, *(np.asarray(curve.y) for curve, _ in lines)]), "")
    panel = Panel(Axis(0, float(updates[-1]), "update"), y, width, 190.0, title)
    panel.rule(y=0.0, colour=INK, width=5.0, opacity=0.18)
    panel.rule(y=mean, dash=(1, 3), width=1.2)
    panel.dots([Curve("", updates, raw, MUTED, said="raw")], 20)
    _draw_lines(panel, lines, (name, 0.0, MUTED), ("mean of raw", mean, MUTED))
    return panel


def _draw_lines(panel: Panel, lines: Sequence[tuple[Curve, Dash]], *labels: tuple[str, float, str]) -> None:
    """Draw curves with their dashes, their names at the right end, and other labels there."""
    for curve, dash in lines:
        panel.lines([curve], dash)
    panel.end_labels([*labels, *((curve.key, float(np.asarray(curve.y)[-1]), curve.colour) for curve, _ in lines)])


def _typical(values: FloatArray, simulated: bool) -> FloatArray:
    """Root mean square over landmarks (L, K); in images the median size: a corner at an edge has no one depth; (K,)."""
    if simulated:
        return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))
    return np.asarray(np.nanmedian(np.abs(values), axis=0))


def _near_and_far(
    results: Mapping[str, Arrays], draw: Callable[[convergence.Depths, str, str, float], Panel], what: str
) -> Chart:
    """Rows are noises, columns near and far."""
    keys: dict[str, str] = {}
    panels = []
    every = [depths for depths in convergence.settings(results) if set(convergence.RANGES) <= set(depths.label)]
    for depths in every:
        keys |= _keys(depths)
    room = label_room([*keys, "mean of raw"])
    for depths in every:
        setting = depths.setting
        where = setting.condition.get("noise", setting.condition.get("drive", "rendered images"))
        for label in convergence.RANGES:
            panels.append(draw(depths, label, f"{label.capitalize()}, {where}", panel_width(2, room, 62 + room)))
    panels[0].text(what, 0, -34)
    return figure(panels, keys, columns=len(convergence.RANGES), column=62 + room)


def _keys(depths: convergence.Depths) -> dict[str, str]:
    return {_called(name, R): COLOURS[name] for name, R in depths.filters}


def _around(values: FloatArray, title: str) -> Axis:
    """An axis around all values that are known."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    margin = 0.06 * (high - low) + 1e-3
    return Axis(low - margin, high + margin, title)


def _dash(R: str) -> Dash:
    return () if R == DIAGONAL else (2, 3) if R == OWN else DASHED


def _called(filter_name: str, R: str) -> str:
    return f"{_SHORT[filter_name]}, {R}"


def _smoothed(values: FloatArray, frames: int = 10) -> FloatArray:
    """Running mean, shorter at the ends."""
    window = np.ones(min(frames, len(values)))
    mean: FloatArray = np.convolve(values, window, "same") / np.convolve(np.ones(len(values)), window, "same")
    return mean
