"""The page: verdicts first, then the figures in the paper's layout and every number behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from stereo_slam_env.report.page import figure_block, page
from stereo_slam_env.report.page_tables import Cell, Column, Tone, number, table
from stereo_slam_env.studies.paper import figures, karlsruhe, long_drive, tables
from stereo_slam_env.studies.paper.claims import Claim, Finding, Verdict
from stereo_slam_env.studies.paper.parts import Arrays
from stereo_slam_env.studies.paper.settings import COMPILED, JOINT, NOISES, PIXELS, RIGHT, PaperSettings

TONES: Mapping[Verdict, Tone] = {
    Verdict.HOLDS: "good",
    Verdict.HOLDS_ONLY_IF: "fair",
    Verdict.DOES_NOT_HOLD: "bad",
    Verdict.NOT_SHOWN: "none",
}
RULE = (
    "A claim holds under a condition if the whole 95 % interval of what was measured lies in the range asked for, does "
    "not hold if it lies outside, and is not shown where it crosses a limit. It holds if it holds under every "
    "condition, and holds only if ... where it holds under some: these are named. Limits were set before these runs."
)
CONDITIONS = (
    "Noise as the paper assumes: errors of u, v and d independent. Independent pixels: errors of both pixels of both "
    "eyes independent, so that d = u_left - u_right shares that of u. R is what the filters assume of it: the paper's "
    "is diagonal, that of independent pixels is full, and each describes the noise of its name. The rival does two "
    'updates with bearings, of the left and then the right eye, with the same R; "rival 1 px an eye" gives it errors '
    "of 1 px in each eye while ours keeps the paper's R."
)


def write_report(
    out: Path,
    claims: Sequence[Claim],
    results: Mapping[str, Arrays],
    settings: PaperSettings,
    with_karlsruhe: bool,
) -> Path:
    """Write figures and page into a directory.

    Parameters
    ----------
    out : Path
        For `report.html` and `figures`.
    claims : sequence of Claim
        What is judged.
    results : mapping of str to arrays
        Of all parts.
    settings : PaperSettings
        How much was measured.
    with_karlsruhe : bool
        Whether the paper's own recordings were run.
    """
    folder = out / "figures"
    sections = [
        f"<h2>Verdicts</h2>{_verdicts(claims)}<p>{escape(RULE)}</p><p>{escape(CONDITIONS)}</p>",
        "" if with_karlsruhe else f'<p class="quiet">{escape(karlsruhe.HOW_TO_GET_IT)}</p>',
        _section_4_1(folder, claims, settings),
        _section_4_3(folder, claims, results),
        _section_4_4(folder, claims, results),
        _section_speed(folder, claims, results),
        karlsruhe_section(folder, claims, results) if with_karlsruhe else "",
    ]
    path = out / "report.html"
    subtitle = (
        f"Chen, Lin and Shih, “Using Range and Bearing Observation in Stereo-Based EKF SLAM”: "
        f"{settings.samples:,} points a cloud, {settings.turn_seeds} turns, {settings.drive_seeds} drives of "
        f"{settings.drive_frames} frames for each noise{', compiled' if COMPILED else ''}."
    )
    path.write_text(page(title="The paper, judged", subtitle=subtitle, body="\n".join(sections)), encoding="utf-8")
    return path


def measured_range(findings: Sequence[Finding]) -> str:
    """Smallest and largest value over the conditions."""
    values = [f.measured.value for f in findings if np.isfinite(f.measured.value)]
    if not values:
        return "–"
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


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


def _findings(claims: Sequence[Claim], keys: str) -> str:
    """A table for each claim whose evidence is one of the figures `keys` names."""
    blocks = []
    for one in claims:
        if one.sentence.evidence not in keys.split():
            continue
        factors = list(one.findings[0].condition) if one.findings else []
        columns = [
            *(Column(factor, kind="text") for factor in factors),
            Column("measured"),
            Column("95 % interval", kind="text"),
            Column("asked", kind="text"),
            Column("verdict", kind="text"),
        ]
        rows: list[list[Cell | str]] = [
            [
                *finding.condition.values(),
                number(finding.measured.value, ".4g"),
                f"{finding.measured.low:.4g} – {finding.measured.high:.4g}" if finding.measured.known else "–",
                str(finding.asked),
                Cell(finding.verdict.value, tone=TONES[finding.verdict]),
            ]
            for finding in one.findings
        ]
        head = (
            f"<summary>{escape(one.sentence.claim)}: <b class='{TONES[one.verdict]}'>{escape(one.says)}</b></summary>"
        )
        blocks.append(f"<details>{head}<p>{escape(one.sentence.statement)}</p>{table(columns, rows)}</details>")
    return "<h3>Condition by condition</h3>" + "".join(blocks)


def _numbers(heads_and_rows: tuple[Sequence[str], list[tables.Row]]) -> str:
    heads, rows = heads_and_rows
    kinds = ["text" if isinstance(value, str) else "number" for value in rows[0]]
    columns = [
        Column(head, kind="text" if kind == "text" else "number") for head, kind in zip(heads, kinds, strict=True)
    ]
    cells = [[value if isinstance(value, str) else number(value, ".3g") for value in row] for row in rows]
    return table(columns, cells)


def _section_4_1(folder: Path, claims: Sequence[Claim], settings: PaperSettings) -> str:
    one = figure_block(
        figures.figure_1(settings.samples),
        "figure-1",
        "Figure 1. Points measured at 70 m with the 95 % regions of both parametrisations, and the histogram of depth; "
        f"{figures.SHOWN} of {settings.samples} points are drawn. Each noise with the R that describes it.",
        folder,
    )
    two = figure_block(
        figures.figure_2(settings.samples),
        "figure-2",
        "Figure 2. Points measured at 15, 30 and 45 m under the paper's noise, and the 95 % region of inverse depth.",
        folder,
    )
    shares = _numbers(tables.uncertainty_table(settings.samples))
    found = _findings(claims, "figure-1 figure-2")
    return f"<h2>4.1 Landmark uncertainty</h2>{one}{two}{found}<h3>All shares</h3>{shares}"


def _section_4_3(folder: Path, claims: Sequence[Claim], results: Mapping[str, Arrays]) -> str:
    four = figure_block(
        figures.figure_4(results),
        "figure-4",
        "Figure 4. Claimed sigma of the depth (lines) and its true RMS error (markers) over the updates: where markers "
        "lie above their line, the filter is overconfident. R = diagonal: the paper's; full: of independent pixels.",
        folder,
    )
    five = figure_block(
        figures.figure_5(results),
        "figure-5",
        "Figure 5. Depth of one near and one far landmark over the updates, against the raw measurements, all relative "
        "to the true depth: the first drive, the landmark nearest to the middle of its range.",
        folder,
    )
    numbers = _numbers(tables.convergence_table(results))
    return (
        f"<h2>4.3 Depth of near and far landmarks</h2>{four}{five}{_findings(claims, 'figure-4 figure-5')}"
        f"<h3>After the last update</h3>{numbers}"
    )


def _section_4_4(folder: Path, claims: Sequence[Claim], results: Mapping[str, Arrays]) -> str:
    noise, R = PIXELS, RIGHT[PIXELS]
    arrays = long_drive.drives(results, noise)[0]
    six = figure_block(
        figures.figure_6(*(long_drive.one(arrays, case) for case in (f"{JOINT}.{R}", long_drive.TRUTH))),
        "figure-6",
        f"Figure 6. Trajectory, yaw and velocity of the first drive; noise: {NOISES[noise]}, the right R.",
        folder,
    )
    nees = figure_block(
        figures.figure_nees(results),
        "figure-nees",
        "Pose NEES over the drive, running mean of 10 frames. R = diagonal: the paper's; full: of independent pixels.",
        folder,
    )
    numbers = _numbers(tables.drive_table(results))
    return (
        f"<h2>4.4 A long drive</h2>{six}{nees}{_findings(claims, 'figure-6 figure-nees')}"
        f"<h3>Means over the drives</h3>{numbers}"
    )


def _section_speed(folder: Path, claims: Sequence[Claim], results: Mapping[str, Arrays]) -> str:
    speed = figure_block(
        figures.figure_speed(results),
        "figure-speed",
        "Processor time of predict + update by number of landmarks, and the ratio of both filters, in turns in one "
        "process.",
        folder,
    )
    numbers = _numbers(tables.speed_table(results))
    return f"<h2>Speed</h2>{speed}{_findings(claims, 'figure-speed')}<h3>Milliseconds</h3>{numbers}"


def karlsruhe_section(folder: Path, claims: Sequence[Claim], results: Mapping[str, Arrays]) -> str:
    """Markup of what the paper's own recordings show; the figures go to `folder`."""
    blocks = []
    depths = karlsruhe.depths(results)
    if depths is not None and len(depths.label):
        blocks.append(
            figure_block(
                figures.figure_karlsruhe(depths),
                "karlsruhe-4",
                "The turn: claimed sigma over the updates, and the depth of one landmark. R = diagonal: the paper's; "
                "measurement: as the front end says of each.",
                folder,
            )
        )
    true = karlsruhe.drive(results, long_drive.TRUTH)
    said = karlsruhe.drive(results, f"{JOINT}.{karlsruhe.OWN}")
    if said is not None and true is not None and len(true["positions"]):
        text = "Trajectory, yaw and velocity against the GPS/IMU unit, a weak truth."
        blocks.append(figure_block(figures.figure_6(said, true), "karlsruhe-6", text, folder))
    own = [one for one in claims if one.sentence.key.startswith(karlsruhe.PREFIX)]
    evidence = " ".join(dict.fromkeys(one.sentence.evidence for one in own))
    return f"<h2>On the Karlsruhe sequences</h2>{''.join(blocks)}{_findings(own, evidence)}"
