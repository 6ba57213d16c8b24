"""The page of the paper: verdicts first, then the figures in its layout and every number behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stereo_slam_env.evaluation import mean_band, share_inside
from stereo_slam_env.report import Cell, Column, Tone, figure_block, html_page, number, table
from stereo_slam_env.studies.paper import convergence, figures, karlsruhe, landmark_uncertainty, long_drive, speed
from stereo_slam_env.studies.paper.claims import (
    ASSUMED_NAMES,
    COMPILED,
    DUAL,
    EUCLIDEAN,
    JOINT,
    NOISES,
    PIXELS,
    RIGHT,
    Arrays,
    Claim,
    Finding,
    FloatArray,
    Verdict,
)

if TYPE_CHECKING:
    from stereo_slam_env.studies.paper import PaperSettings

Figure = tuple[Any, str, str]
"""What is drawn, the name of its files, and the caption."""
Row = Sequence[str | float]
Numbers = tuple[Sequence[str], Sequence[Row]]
"""Heads and rows of a table."""
TONES: Mapping[Verdict, Tone] = {
    Verdict.HOLDS: "good",
    Verdict.HOLDS_ONLY_IF: "fair",
    Verdict.DOES_NOT_HOLD: "bad",
    Verdict.NOT_SHOWN: "none",
}
NAMES: Mapping[str, str] = {JOINT: "inverse depth (the paper's)", DUAL: "two bearing updates", EUCLIDEAN: "XYZ"}
RULE = (
    "A claim holds under a condition if the whole 95 % interval of what was measured lies in the range asked for, does "
    "not hold if it lies outside, and is not shown where it crosses a limit. It holds if it holds under every "
    "condition, and holds only if ... where it holds under some: these are named. Limits were set before these runs."
)
CONDITIONS = (
    "Noise as the paper assumes: errors of u, v and d independent. Independent pixels: errors of both pixels of both "
    "images independent, so that d = u_left - u_right shares that of u. R is what the filters assume of it: the "
    "paper's is diagonal, that of independent pixels is full, and each describes the noise of its name. The competitor "
    'does two updates with bearings, of the left and then the right image, with the same R; "competitor, 1 px an '
    "image\" gives it errors of 1 px in each image while ours keeps the paper's R."
)


def write_report(
    out: Path,
    claims: Sequence[Claim],
    results: Mapping[str, Arrays],
    runs: long_drive.Runs,
    settings: PaperSettings,
    with_karlsruhe: bool,
) -> Path:
    """Write `report.html` and `figures` into a directory.

    Parameters
    ----------
    out : Path
        The directory.
    claims : sequence of Claim
        What is judged.
    results, runs : mapping
        Of all experiments, and of the drives of section 4.4.
    settings : PaperSettings
        How much was measured.
    with_karlsruhe : bool
        Whether the paper's own recordings were run.
    """
    samples, place = settings.samples, out / "figures"
    ours = runs[long_drive.DRIVE, PIXELS, JOINT, RIGHT[PIXELS]][0]
    true_course = long_drive.course(ours, true=True)
    sections = [
        f"<h2>Verdicts</h2>{_verdicts(claims)}<p>{escape(RULE)}</p><p>{escape(CONDITIONS)}</p>",
        "" if with_karlsruhe else f'<p class="quiet">{escape(karlsruhe.HOW_TO_GET_IT)}</p>',
        _section(
            "4.1 Landmark uncertainty",
            [
                (
                    figures.figure_1(samples),
                    "figure-1",
                    "Figure 1. Points measured at 70 m with the 95 % regions of both parametrisations, and the "
                    f"histogram of depth; {figures.SHOWN} of {samples} points are drawn. Each noise with the R that "
                    "describes it.",
                ),
                (
                    figures.figure_2(samples),
                    "figure-2",
                    "Figure 2. Points measured at 15, 30 and 45 m under the paper's noise, and the 95 % region of "
                    "inverse depth.",
                ),
            ],
            claims,
            place,
            {"All shares": uncertainty_table(samples)},
        ),
        _section(
            "4.3 Depth of near and far landmarks",
            [
                (
                    figures.figure_4(results),
                    "figure-4",
                    "Figure 4. Claimed sigma of the depth (lines) and its true RMS error (markers) over the updates: "
                    "where markers lie above their line, the filter is overconfident. R = diagonal: the paper's; full: "
                    "of independent pixels.",
                ),
                (
                    figures.figure_5(results),
                    "figure-5",
                    "Figure 5. Depth of one near and one far landmark over the updates, against the raw measurements, "
                    "all relative to the true depth: the first drive, the landmark nearest to the middle of its range.",
                ),
            ],
            claims,
            place,
            {"After the last update": convergence_table(results)},
        ),
        _section(
            "4.4 A long drive",
            [
                (
                    figures.figure_6(long_drive.course(ours), true_course),
                    "figure-6",
                    f"Figure 6. Trajectory, yaw and velocity of the first drive; noise: {NOISES[PIXELS]}, the right R.",
                ),
                (
                    figures.figure_nees(runs),
                    "figure-nees",
                    "Pose NEES over the drive, running mean of 10 frames. R = diagonal: the paper's; full: of "
                    "independent pixels.",
                ),
            ],
            claims,
            place,
            {"Means over the drives": drive_table(runs)},
        ),
        _section(
            "Speed",
            [
                (
                    figures.figure_speed(results),
                    "figure-speed",
                    "Processor time of predict + update by number of landmarks, and the ratio of both filters, in "
                    "turns in one process.",
                )
            ],
            claims,
            place,
            {"Milliseconds": speed_table(results)},
        ),
        karlsruhe_section(place, claims, results) if with_karlsruhe else "",
    ]
    subtitle = (
        f"Chen, Lin and Shih, “Using Range and Bearing Observation in Stereo-Based EKF SLAM”: "
        f"{samples:,} points a cloud, {settings.turn_seeds} turns, {settings.drive_seeds} drives of "
        f"{settings.drive_frames} frames for each noise{', compiled' if COMPILED else ''}."
    )
    path = out / "report.html"
    path.write_text(html_page(title="The paper, judged", subtitle=subtitle, body="\n".join(sections)), encoding="utf-8")
    return path


def karlsruhe_section(folder: Path, claims: Sequence[Claim], results: Mapping[str, Arrays]) -> str:
    """Markup of what the paper's own recordings show; the figures go to `folder`."""
    shown: list[Figure] = []
    depths = karlsruhe.depths(results)
    if depths is not None and len(depths.label):
        text = (
            "The turn: claimed sigma over the updates, and the depth of one landmark. R = diagonal: the paper's; "
            "measurement: as the front end says of each."
        )
        shown.append((figures.figure_karlsruhe(depths), "karlsruhe-4", text))
    said, true = (karlsruhe.course(results, who) for who in ("said", "true"))
    if said is not None and true is not None:
        text = "Trajectory, yaw and velocity against the GPS/IMU unit, a weak truth."
        shown.append((figures.figure_6(said, true), "karlsruhe-6", text))
    own = [one for one in claims if one.sentence.key.startswith(karlsruhe.PREFIX)]
    return _section("On the Karlsruhe sequences", shown, own, folder, {}, everything=True)


def measured_range(findings: Sequence[Finding]) -> str:
    """Smallest and largest value over the conditions."""
    values = [f.measured.value for f in findings if np.isfinite(f.measured.value)]
    if not values:
        return "–"
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _section(
    title: str,
    shown: Sequence[Figure],
    claims: Sequence[Claim],
    folder: Path,
    numbers: Mapping[str, Numbers],
    *,
    everything: bool = False,
) -> str:
    """Figures, findings of the claims that they are the evidence of (or of all), and tables by heading."""
    blocks = "".join(figure_block(drawing, name, text, folder) for drawing, name, text in shown)
    names = [name for _, name, _ in shown]
    found = "".join(_findings(one) for one in claims if everything or one.sentence.evidence in names)
    tables = "".join(f"<h3>{escape(heading)}</h3>{_numbers(*of)}" for heading, of in numbers.items())
    return f"<h2>{escape(title)}</h2>{blocks}<h3>Condition by condition</h3>{found}{tables}"


def _verdicts(claims: Sequence[Claim]) -> str:
    columns = [
        Column("Section", kind="text"),
        Column("Claim", kind="words"),
        Column("Verdict", kind="words"),
        Column("Measured", "over conditions", kind="text"),
        Column("What is measured", "and when it counts as true", kind="words"),
    ]
    rows: list[list[Cell | str]] = [
        [
            one.sentence.section,
            one.sentence.claim,
            Cell(one.says, tone=TONES[one.verdict]),
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
    rows: list[list[Cell | str]] = [
        [
            *finding.condition.values(),
            number(finding.measured.value, ".4g"),
            f"{finding.measured.low:.4g} – {finding.measured.high:.4g}" if finding.measured.known else "–",
            str(finding.asked),
            Cell(finding.verdict.value, tone=TONES[finding.verdict]),
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
