"""The page of the paper: verdicts first, then the figures in its layout and every number behind them."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stereo_slam_env.evaluation import mean_band, readable, share_inside
from stereo_slam_env.files import own_files, write_atomically, write_text
from stereo_slam_env.paper import convergence, landmark_uncertainty, long_drive, plots, speed
from stereo_slam_env.paper.drives import (
    DRIVE,
    FRAMES_OF_THE_PAPER,
    HOW_TO_GET_KARLSRUHE,
    TURN,
    Setting,
)
from stereo_slam_env.paper.paper_claims import (
    ASSUMED_NAMES,
    EUCLIDEAN,
    FILTER_NAMES,
    JOINT,
    NOISES,
    PLACES,
    SIMULATION,
    TABLE,
    Arrays,
    Claim,
    ClaimFinding,
    ClaimVerdict,
    FloatArray,
    finite_mean,
)
from stereo_slam_env.report import Chart, Column, Table, TableCell, Tone, figure_block, html_page, number, on_page

if TYPE_CHECKING:
    from stereo_slam_env.paper import PaperSettings

Row = Sequence[str | float]
Numbers = tuple[Sequence[str], Sequence[Row]]
"""Heads and rows of a table."""
TONES: Mapping[ClaimVerdict, Tone] = {
    ClaimVerdict.HOLDS: "good",
    ClaimVerdict.HOLDS_ONLY_IF: "fair",
    ClaimVerdict.DOES_NOT_HOLD: "bad",
    ClaimVerdict.NOT_SHOWN: "none",
}


class Page:
    """`report.html` and `figures`, written again after each section of the study."""

    def __init__(
        self, out: Path, settings: PaperSettings, real: Sequence[str], without: str, figure: str | None = None
    ) -> None:
        self.path, self._out, self._settings, self._figure = out / "report.html", out, settings, figure
        self._real, self._renders, self._notes = real, not without, [without]
        if not real:
            self._notes.append("Not judged on real drives: install the extra gtsam (KITTI 00), or give --real FOLDER.")
        if not any(name in FRAMES_OF_THE_PAPER for name in real):
            self._notes.append(HOW_TO_GET_KARLSRUHE)
        self._blocks: dict[str, str] = {}

    @property
    def notes(self) -> list[str]:
        """Places that were not judged, and what each would need; none of figures without any drive."""
        if self._figure in ("1", "2", "speed"):
            return []
        return [note for note in self._notes if note]

    def write(self, claims: Sequence[Claim], results: Mapping[str, Arrays], done: tuple[int, int]) -> None:
        """Write the page of what there is; `done` are parts finished and all parts."""
        body = []
        if self._settings.remark:
            body.append(f'<p class="banner">{escape(self._settings.remark)}</p>')
        if done[0] < done[1]:
            body.append(f'<p class="banner">Still running: {done[0]} of {done[1]} parts are finished.</p>')
        body.append(f"<h2>Verdicts</h2>{contradictions(claims)}{_verdicts(claims)}")
        body += [f"<p>{escape(TABLE[name])}</p>" for name in ("rule", "conditions")]
        body += [f'<p class="quiet">{escape(note)}</p>' for note in self.notes]
        body += self._sections(claims, results)
        settings = self._settings
        drawn = f"{settings.rendered_turns} and {settings.rendered_drives} in rendered images, "
        subtitle = (
            f"Chen, Lin and Shih, “Using Range and Bearing Observation in Stereo-Based EKF SLAM”: "
            f"{settings.samples:,} points a cloud; {settings.turn_seeds} turns and {settings.drive_seeds} drives of "
            f"{settings.drive_frames} frames for each noise, {drawn if self._renders else ''}"
            f"real drives: {', '.join(self._real) or 'none'}."
        )
        page = html_page(title="The paper, judged", subtitle=subtitle, body="\n".join(body))
        write_text(self.path, page)
        write_text(self._out / "claims.md", markdown(claims))

    def _sections(self, claims: Sequence[Claim], results: Mapping[str, Arrays]) -> list[str]:
        """A section a figure, in the order of the paper, of those that there are results for."""
        samples, kinds = self._settings.samples, {name.partition(".")[0] for name in results}
        timed = any(name.startswith("speed-") for name in results)
        drawers: dict[str, tuple[str, bool, Callable[[], Chart], Callable[[], Numbers] | None]] = {
            "1": ("Figure 1: a landmark at 70 m (4.1)", True, lambda: plots.figure_1(samples), None),
            "2": (
                "Figure 2: landmarks at 15, 30 and 45 m (4.1)",
                True,
                lambda: plots.figure_2(samples),
                lambda: uncertainty_table(samples),
            ),
            "4": (
                "Figure 4: uncertainty of the depth over the updates (4.3)",
                TURN in kinds,
                lambda: plots.figure_4(results),
                lambda: convergence_table(results),
            ),
            "5": (
                "Figure 5: depth of one landmark over the updates (4.3)",
                TURN in kinds,
                lambda: plots.figure_5(results),
                None,
            ),
            "6": (
                "Figure 6: trajectory, yaw and velocity (4.4)",
                DRIVE in kinds,
                lambda: plots.figure_6(*long_drive.example_course(results)),
                lambda: drive_table(results),
            ),
            "nees": ("Consistency (4.1, 5)", DRIVE in kinds, lambda: plots.figure_nees(results), None),
            "speed": (
                "Speed (3.1, 5)",
                timed,
                lambda: plots.figure_speed(results),
                lambda: speed_table(results),
            ),
        }
        sections = []
        for name, (title, is_there, draw, numbers) in drawers.items():
            if name == "4" and convergence.FEATURES in results and self._figure in (None, "3"):
                sections.append(self._blocks.get("figure-3") or self._picture(results[convergence.FEATURES]))
            if is_there and self._figure in (None, name):
                sections.append(self._section(name, title, claims, draw, numbers))
        return sections

    def _section(
        self,
        name: str,
        title: str,
        claims: Sequence[Claim],
        draw: Callable[[], Chart],
        numbers: Callable[[], Numbers] | None,
    ) -> str:
        key = f"figure-{name}"
        if key not in self._blocks:  # its results do not change any more
            caption = TABLE["figures"][key].format(shown=plots.SHOWN, samples=self._settings.samples)
            block = figure_block(draw(), key, caption, self._out / "figures")
            about = f"<h3>Every number</h3>{_numbers(*numbers())}" if numbers else ""
            findings_html = "".join(_findings(one) for one in claims if one.sentence.evidence == key)
            details = f"<h3>Condition by condition</h3>{findings_html}" if findings_html else ""
            self._blocks[key] = f"<h2>{escape(title)}</h2>{block}{details}{about}"
        return self._blocks[key]

    def _picture(self, arrays: Arrays) -> str:
        """Figure 3, which is no chart."""
        folder, name = self._out / "figures", "figure-3.png"
        folder.mkdir(parents=True, exist_ok=True)
        own_files(self._out, [f"figures/{name}"])
        encoded = convergence.feature_picture(arrays)
        write_atomically(folder / name, lambda stream: stream.write(encoded))
        data, caption = base64.b64encode(encoded).decode(), escape(TABLE["figures"]["figure-3"])
        image = f'<img alt="{caption}" style="width: 100%" src="data:image/png;base64,{data}">'
        self._blocks["figure-3"] = (
            f"<h2>Figure 3: features of a turn (4.3)</h2>"
            f'<figure id="figure-figure-3">{image}<figcaption>{caption}</figcaption></figure>'
        )
        return self._blocks["figure-3"]


def markdown(claims: Sequence[Claim]) -> str:
    """The verdicts as a table for a page in Markdown: a row a sentence, a column a place."""
    heads = ("§", "sentence", *(name.lower() for name in PLACES.values()))
    rows = [heads, ("---",) * len(heads)]
    for one in claims:
        places = (_in_place(one.at(place)) for place in PLACES)
        rows.append((one.sentence.section, f"{one.sentence.claim}<br>{one.sentence.statement}", *places))
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _in_place(claim: Claim) -> str:
    """Verdict in a place, and what was measured there."""
    return f"{claim.says}<br>{measured_range(claim.findings)}" if claim.findings else "–"


def measured_range(findings: Sequence[ClaimFinding]) -> str:
    """Smallest and largest value over the conditions."""
    values = [f.measured.value for f in findings if np.isfinite(f.measured.value)]
    if not values:
        return "–"
    low, high = (readable(value) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def contradictions(claims: Sequence[Claim]) -> str:
    """Markup of the sentences that are shown in simulation and refuted elsewhere, with what was measured there."""
    items = []
    for one in claims:
        holds_somewhere = any(finding.verdict is ClaimVerdict.HOLDS for finding in one.at(SIMULATION).findings)
        refuted = [
            finding
            for finding in one.findings
            if finding.place != SIMULATION and finding.verdict is ClaimVerdict.DOES_NOT_HOLD
        ]
        if holds_somewhere and refuted:
            where = ", ".join(dict.fromkeys(f.condition.get("drive", PLACES[f.place].lower()) for f in refuted))
            words = f"{one.sentence.claim}: {where} ({measured_range(refuted)}, asked: {refuted[0].asked})"
            items.append(f"<li>{escape(words)}</li>")
    if not items:
        return ""
    return f"<p><b>Shown in simulation under some conditions, refuted elsewhere:</b></p><ul>{''.join(items)}</ul>"


def _verdicts(claims: Sequence[Claim]) -> str:
    columns = [
        Column("Section", kind="text"),
        Column("Claim", "what is measured, and when it counts as true", kind="words"),
        Column("Verdict", "over all", kind="words"),
        *(Column(name, "and what was measured", kind="words") for name in PLACES.values()),
    ]
    rows: list[list[TableCell | str]] = []
    for one in claims:
        places = [one.at(place) for place in PLACES]
        cells = [
            TableCell(f"{at.says} [{measured_range(at.findings)}]", tone=TONES[at.verdict]) if at.findings else "–"
            for at in places
        ]
        verdict = TableCell(one.verdict.value.replace(" if", " if …"), tone=TONES[one.verdict])
        rows.append([one.sentence.section, f"{one.sentence.claim} – {one.sentence.statement}", verdict, *cells])
    return on_page(Table(columns, rows, "wide"))


def claims_table(claims: Sequence[Claim]) -> Table:
    """The verdict on each sentence in each place."""
    columns = [Column("section", kind="text"), Column("claim", kind="words")]
    columns += [Column(name.lower(), kind="words") for name in PLACES.values()]
    rows: list[list[TableCell | str]] = []
    for one in claims:
        verdicts = [one.at(place).verdict if one.at(place).findings else None for place in PLACES]
        cells = [TableCell(v.value.replace(" if", " if …"), tone=TONES[v]) if v else "–" for v in verdicts]
        rows.append([one.sentence.section, one.sentence.claim, *cells])
    return Table(columns, rows)


def _findings(claim: Claim) -> str:
    """A claim, condition by condition."""
    factors = list(dict.fromkeys(factor for finding in claim.findings for factor in finding.condition))
    columns = [
        Column("place", kind="text"),
        *(Column(factor, kind="text") for factor in factors),
        Column("measured"),
        *(Column(head, kind="text") for head in ("95 % interval", "asked", "verdict")),
    ]
    rows: list[list[TableCell | str]] = [
        [
            PLACES[finding.place].lower(),
            *(finding.condition.get(factor, "–") for factor in factors),
            number(finding.measured.value, ".4g"),
            " – ".join(readable(end, ".4g") for end in (finding.measured.low, finding.measured.high))
            if finding.measured.known
            else "–",
            str(finding.asked),
            TableCell(finding.verdict.value, tone=TONES[finding.verdict]),
        ]
        for finding in claim.findings
    ]
    verdict = f"<b class='{TONES[claim.verdict]}'>{escape(claim.verdict.value.replace(' if', ' if …'))}</b>"
    head = f"<summary>{escape(claim.sentence.claim)}: {verdict}</summary>"
    return f"<details>{head}<p>{escape(claim.sentence.statement)}</p>{on_page(Table(columns, rows))}</details>"


def _numbers(heads: Sequence[str], rows: Sequence[Row]) -> str:
    columns = [
        Column(head, kind="text" if isinstance(value, str) else "number")
        for head, value in zip(heads, rows[0], strict=True)
    ]
    cells = [[value if isinstance(value, str) else number(value, ".3g") for value in row] for row in rows]
    return on_page(Table(columns, cells))


# What was measured, in absolute numbers.


def uncertainty_table(samples: int) -> Numbers:
    """Section 4.1: coverage and distance of both parametrisations."""
    fits_of_samples = landmark_uncertainty.fits(samples)
    heads = ("noise", "R", "depth, m", "in 95 %: inverse depth", "XYZ", "KS: inverse depth", "XYZ")
    rows: list[Row] = []
    for noise, assumed, depth in dict.fromkeys(key[:3] for key in fits_of_samples):
        ours, xyz = (fits_of_samples[noise, assumed, depth, name] for name in (JOINT, EUCLIDEAN))
        numbers = (ours.coverage.value, xyz.coverage.value, ours.distance, xyz.distance)
        rows.append((NOISES[noise], ASSUMED_NAMES[assumed], depth, *numbers))
    return heads, rows


def convergence_table(results: Mapping[str, Arrays]) -> Numbers:
    """Section 4.3: after the last update."""
    heads = (
        *("place", "drives", "filter", "R", "landmark", "number"),
        *("claimed σ, m", "RMS error, m", "NEES of depth", "of 1/depth", "updates to index 0.1"),
    )
    rows: list[Row] = []
    for depths in convergence.settings(results):
        for (name, R), history in depths.filters.items():
            z, sigma = (values[:, -1] for values in depths.depth(history))
            error = z - depths.true[:, -1]
            nees, linear = convergence.nees(depths, history), convergence.updates_until_linear(depths, history)
            for label in convergence.RANGES:
                at = depths.label == label
                case = (*_place(depths.setting), FILTER_NAMES[name], ASSUMED_NAMES[R], label, float(at.sum()))
                of_depth, of_inverse = finite_mean((error[at] / sigma[at]) ** 2), finite_mean(nees[at])
                rows.append((*case, _rms(sigma[at]), _rms(error[at]), of_depth, of_inverse, finite_mean(linear[at])))
    return heads, rows


def drive_table(results: Mapping[str, Arrays]) -> Numbers:
    """Section 4.4: means over the drives."""
    quantities = ("position", "aligned", "drift", "yaw", "velocity", "scale", "pose_nees", "landmark_nees", "nis")
    heads = (
        *("place", "drives", "filter", "R", "position, m", "aligned, m", "drift, %", "yaw, °", "velocity, m/s"),
        *("length, %", "NEES / 6", "landmark NEES / 3", "NIS / dof", "in band, %"),
    )
    rows: list[Row] = []
    for one in long_drive.settings(results):
        where, how_many = _place(one.setting), len(one.by_drive)
        band = mean_band(6, how_many)
        for name, R in long_drive.cases(one.setting):
            means = [finite_mean(one.of(name, R, quantity)) for quantity in quantities]
            nees = np.array([arrays[f"{name}.{R}.nees"] for arrays in one.by_drive])[:, 1:]
            inside = 100.0 * share_inside(nees.mean(axis=0), band)
            drives = where[1] if one.is_one else f"{how_many} {where[1]}"
            rows.append((where[0], drives, FILTER_NAMES[name], ASSUMED_NAMES[R], *means, inside))
    return heads, rows


def speed_table(results: Mapping[str, Arrays]) -> Numbers:
    """Milliseconds of predict + update, medians."""
    measured = speed.milliseconds(results)
    heads = ("state", "filter", *(f"{n} landmarks" for n in measured))
    names = [(form, name, f"{form}.{name}") for form in speed.FORMS for name in (JOINT, *speed.RIVALS[form])]
    names.append(("points", EUCLIDEAN, speed.XYZ))
    rows: list[Row] = [
        (form, FILTER_NAMES[name], *(float(np.median(times[f"{key}.both"])) for times in measured.values()))
        for form, name, key in names
    ]
    return heads, rows


def _place(setting: Setting) -> tuple[str, str]:
    """Place of a setting, and what its drives are called."""
    words = setting.condition.get("noise", setting.condition.get("drive", "drawn by gl"))
    return PLACES[setting.place].lower(), words


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(finite_mean(np.square(values))))
