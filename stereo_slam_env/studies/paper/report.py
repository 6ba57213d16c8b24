"""The page of the paper: verdicts first, then the figures in its layout and every number behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stereo_slam_env.evaluation import mean_band, readable, share_inside
from stereo_slam_env.files import write_text
from stereo_slam_env.report import Chart, Column, TableCell, Tone, figure_block, html_page, number, table
from stereo_slam_env.studies.paper import convergence, figures, karlsruhe, landmark_uncertainty, long_drive, speed
from stereo_slam_env.studies.paper.claims import (
    ASSUMED_NAMES,
    DUAL,
    EUCLIDEAN,
    JOINT,
    NOISES,
    PIXELS,
    RIGHT,
    TABLE,
    Arrays,
    Claim,
    ClaimFinding,
    ClaimVerdict,
    FloatArray,
)

if TYPE_CHECKING:
    from stereo_slam_env.studies.paper import PaperSettings

Row = Sequence[str | float]
Numbers = tuple[Sequence[str], Sequence[Row]]
"""Heads and rows of a table."""
TONES: Mapping[ClaimVerdict, Tone] = {
    ClaimVerdict.HOLDS: "good",
    ClaimVerdict.HOLDS_ONLY_IF: "fair",
    ClaimVerdict.DOES_NOT_HOLD: "bad",
    ClaimVerdict.NOT_SHOWN: "none",
}
NAMES: Mapping[str, str] = {JOINT: "inverse depth (the paper's)", DUAL: "two bearing updates", EUCLIDEAN: "XYZ"}


def write_report(
    out: Path,
    claims: Sequence[Claim],
    results: Mapping[str, Arrays],
    runs: long_drive.Runs,
    settings: PaperSettings,
    with_karlsruhe: bool,
) -> Path:
    """Write `report.html` and `figures` into a directory."""
    place, samples = out / "figures", settings.samples
    ours = runs[long_drive.DRIVE, PIXELS, JOINT, RIGHT[PIXELS]][0]
    rule, conditions = (f"<p>{escape(TABLE[name])}</p>" for name in ("rule", "conditions"))
    points = {"figure-1": figures.figure_1(samples), "figure-2": figures.figure_2(samples)}
    depths = {"figure-4": figures.figure_4(results), "figure-5": figures.figure_5(results)}
    courses = figures.figure_6(long_drive.course(ours), long_drive.course(ours, true=True))
    drives = {"figure-6": courses, "figure-nees": figures.figure_nees(runs)}
    times = {"figure-speed": figures.figure_speed(results)}

    def section(title: str, charts: Mapping[str, Chart], heading: str, numbers: Numbers) -> str:
        found = [one for one in claims if one.sentence.evidence in charts]
        shown = _section(title, charts, found, place, shown=figures.SHOWN, samples=samples)
        return f"{shown}<h3>{heading}</h3>{_numbers(*numbers)}"

    sections = [
        f'<p class="banner">{escape(settings.remark)}</p>' if settings.remark else "",
        f"<h2>Verdicts</h2>{_verdicts(claims)}{rule}{conditions}",
        "" if with_karlsruhe else f'<p class="quiet">{escape(karlsruhe.HOW_TO_GET_IT)}</p>',
        section("4.1 Landmark uncertainty", points, "All shares", uncertainty_table(samples)),
        section("4.3 Depth of near and far landmarks", depths, "After the last update", convergence_table(results)),
        section("4.4 A long drive", drives, "Means over the drives", drive_table(runs)),
        section("Speed", times, "Milliseconds", speed_table(results)),
        karlsruhe_section(place, claims, results) if with_karlsruhe else "",
    ]
    subtitle = (
        f"Chen, Lin and Shih, “Using Range and Bearing Observation in Stereo-Based EKF SLAM”: "
        f"{samples:,} points a cloud, {settings.turn_seeds} turns, {settings.drive_seeds} drives of "
        f"{settings.drive_frames} frames for each noise."
    )
    path = out / "report.html"
    write_text(path, html_page(title="The paper, judged", subtitle=subtitle, body="\n".join(sections)))
    return path


def karlsruhe_section(folder: Path, claims: Sequence[Claim], results: Mapping[str, Arrays]) -> str:
    """Markup of what the paper's own recordings show; the figures go to `folder`."""
    charts = {}
    depths = karlsruhe.depths(results)
    if depths is not None and len(depths.label):
        charts["karlsruhe-4"] = figures.figure_karlsruhe(depths)
    said, true = (karlsruhe.course(results, who) for who in ("said", "true"))
    if said is not None and true is not None:
        charts["karlsruhe-6"] = figures.figure_6(said, true)
    own = [one for one in claims if one.sentence.key.startswith(karlsruhe.PREFIX)]
    return _section("On the Karlsruhe sequences", charts, own, folder)


def measured_range(findings: Sequence[ClaimFinding]) -> str:
    """Smallest and largest value over the conditions."""
    values = [f.measured.value for f in findings if np.isfinite(f.measured.value)]
    if not values:
        return "–"
    low, high = (readable(value) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _section(title: str, charts: Mapping[str, Chart], claims: Sequence[Claim], folder: Path, **numbers: object) -> str:
    """Figures, with these numbers in their captions, and findings of the claims that they are the evidence of."""
    captions = {name: TABLE["figures"][name].format(**numbers) for name in charts}
    blocks = "".join(figure_block(chart, name, captions[name], folder) for name, chart in charts.items())
    found = "".join(_findings(one) for one in claims)
    return f"<h2>{escape(title)}</h2>{blocks}<h3>Condition by condition</h3>{found}"


def _verdicts(claims: Sequence[Claim]) -> str:
    columns = [
        Column("Section", kind="text"),
        Column("Claim", kind="words"),
        Column("Verdict", kind="words"),
        Column("Measured", "over conditions", kind="text"),
        Column("What is measured", "and when it counts as true", kind="words"),
    ]
    rows: list[list[TableCell | str]] = [
        [
            one.sentence.section,
            one.sentence.claim,
            TableCell(one.says, tone=TONES[one.verdict]),
            measured_range(one.findings),
            one.sentence.statement,
        ]
        for one in claims
    ]
    return table(columns, rows, wide=True)


def _findings(claim: Claim) -> str:
    """A claim, condition by condition."""
    factors = list(claim.findings[0].condition) if claim.findings else []
    columns = [
        *(Column(factor, kind="text") for factor in factors),
        Column("measured"),
        *(Column(head, kind="text") for head in ("95 % interval", "asked", "verdict")),
    ]
    rows: list[list[TableCell | str]] = [
        [
            *finding.condition.values(),
            number(finding.measured.value, ".4g"),
            " – ".join(readable(end, ".4g") for end in (finding.measured.low, finding.measured.high))
            if finding.measured.known
            else "–",
            str(finding.asked),
            TableCell(finding.verdict.value, tone=TONES[finding.verdict]),
        ]
        for finding in claim.findings
    ]
    verdict = f"<b class='{TONES[claim.verdict]}'>{escape(claim.says)}</b>"
    head = f"<summary>{escape(claim.sentence.claim)}: {verdict}</summary>"
    return f"<details>{head}<p>{escape(claim.sentence.statement)}</p>{table(columns, rows)}</details>"


def _numbers(heads: Sequence[str], rows: Sequence[Row]) -> str:
    columns = [
        Column(head, kind="text" if isinstance(value, str) else "number")
        for head, value in zip(heads, rows[0], strict=True)
    ]
    cells = [[value if isinstance(value, str) else number(value, ".3g") for value in row] for row in rows]
    return table(columns, cells)


# What was measured, in absolute numbers.


def uncertainty_table(samples: int) -> Numbers:
    """Section 4.1: coverage and distance of both parametrisations."""
    found = landmark_uncertainty.fits(samples)
    heads = ("noise", "R", "depth, m", "in 95 %: inverse depth", "XYZ", "KS: inverse depth", "XYZ")
    rows: list[Row] = []
    for noise, assumed, depth in dict.fromkeys(key[:3] for key in found):
        ours, xyz = (found[noise, assumed, depth, name] for name in (JOINT, EUCLIDEAN))
        numbers = (ours.coverage.value, xyz.coverage.value, ours.distance, xyz.distance)
        rows.append((NOISES[noise], ASSUMED_NAMES[assumed], depth, *numbers))
    return heads, rows


def convergence_table(results: Mapping[str, Arrays]) -> Numbers:
    """Section 4.3: after the last update."""
    heads = (
        *("noise", "filter", "R", "landmark", "number"),
        *("claimed σ, m", "RMS error, m", "NEES of depth", "of 1/depth"),
    )
    rows: list[Row] = []
    for noise in NOISES:
        depths = convergence.gathered(results, noise)
        for (name, R), history in depths.filters.items():
            z, sigma = (values[:, -1] for values in depths.depth(history))
            error = z - depths.true[:, -1]
            nees = convergence.nees(depths, history)
            for label in convergence.RANGES:
                at = depths.label == label
                of_depth, of_inverse = float(np.nanmean((error[at] / sigma[at]) ** 2)), float(np.nanmean(nees[at]))
                case = (NOISES[noise], NAMES[name], ASSUMED_NAMES[R], label)
                rows.append((*case, float(at.sum()), _rms(sigma[at]), _rms(error[at]), of_depth, of_inverse))
    return heads, rows


def drive_table(runs: long_drive.Runs) -> Numbers:
    """Section 4.4: means over the drives, and the one drive in the simulated street."""
    heads = (
        *("drives", "noise", "filter", "R", "position, m", "drift, %", "yaw, °", "velocity, m/s", "length, %"),
        *("NEES / 6", "band", "in band, %", "landmark NEES / 3", "NIS / dof"),
    )
    before = (
        *(long_drive.position_rmse, long_drive.drift_percent, long_drive.yaw_rmse, long_drive.velocity_rmse),
        *(long_drive.scale_error_percent, long_drive.pose_nees),
    )
    after = (long_drive.landmark_nees, long_drive.nis)
    rows: list[Row] = []
    for place, where in ((long_drive.DRIVE, "past points"), (long_drive.STREET, "in the street")):
        for noise in NOISES:
            for case in long_drive.cases(place, noise):
                drives = runs[case]
                band = mean_band(6, len(drives))
                nees = np.mean([run.pose_nees for run in drives], axis=0)
                means = [float(np.nanmean(long_drive.of_runs(drives, quantity))) for quantity in (*before, *after)]
                rows.append(
                    (
                        *(f"{len(drives)} {where}", NOISES[noise], NAMES[case[2]], ASSUMED_NAMES[case[3]]),
                        *means[: len(before)],
                        f"{band[0] / 6:.2f}–{band[1] / 6:.2f}",
                        100.0 * share_inside(nees[1:], band),
                        *means[len(before) :],
                    )
                )
    return heads, rows


def speed_table(results: Mapping[str, Arrays]) -> Numbers:
    """Milliseconds of predict + update, medians."""
    measured = speed.milliseconds(results)
    heads = ("state", *(f"{who}, {n}" for n in measured for who in ("ours", "competitor")))
    rows: list[Row] = [
        (form, *(float(np.median(times[f"{form}.{name}"])) for times in measured.values() for name in (JOINT, DUAL)))
        for form in speed.FORMS
    ]
    return heads, rows


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))
