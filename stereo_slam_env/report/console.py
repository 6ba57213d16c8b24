"""Output of the command line: settings, the progress bar and the result table."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from filters import StereoCamera
from filters.contract.noise import ColouredNoise, StereoNoise
from stereo_slam_env.benchmark.scenarios.measurement_errors import (
    LAGS,
    OUTLIER,
    MeasurementErrors,
    error_correlation,
    noise_by_range,
)
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, PolicyChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.statistics.changes import RunComparison
from stereo_slam_env.benchmark.statistics.measures import EFFICIENCY, POSE_NEES
from stereo_slam_env.benchmark.statistics.policy_verdict import baseline_of, judge_policies
from stereo_slam_env.benchmark.statistics.remarks import (
    innovation_remarks,
    limit_reached,
    motion_remarks,
    reference_remarks,
)
from stereo_slam_env.benchmark.statistics.verdict import judge, pose_nees
from stereo_slam_env.benchmark.storage.tables import CellResult
from stereo_slam_env.evaluation.figures import FIGURES, UNKNOWN, Figure
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.rig_errors import rig_errors
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.recording.recording import Recording

if TYPE_CHECKING:  # runs the front end
    from stereo_slam_env.benchmark.campaign import Progress as ProgressCallback

MOST_COLUMNS = 5
_FAR_FROM_PRIOR = 3.0
"""Sigmas of the prior beyond which what is put down to the rig is hardly the rig's."""
_NAMES_WRAP_AT = 24
"""Names of rows are wrapped, in a narrow console, but to no less."""
_CLAIMS_MATTER_MOST = (
    *("final_position_sigma_m", "final_pose_logdet", "end_error_m", "position_rmse_m", "pose_anees", "diverged"),
)


def show_settings(console: Console, scenario: Scenario) -> None:
    """Print what the filters will assume: nothing of it is hidden in the code."""
    sees = scenario.source.takes_images
    noise = "as each measurement says" if sees else "as the recording says"
    if scenario.noise is not None:
        noise = f"{json.dumps(dict(scenario.noise))} px"
    motion = scenario.motion
    lines = {
        "scenario": f"{scenario.name} ({scenario.source})",
        "frames": "all" if scenario.frames is None else str(scenario.frames),
        "assumed noise": noise,
        "gate": "none" if scenario.gate is None else f"{scenario.gate:g} per landmark",
        "consensus": "one-point RANSAC over the frame" if scenario.consensus else "no",
        "odometry": "used" if scenario.use_odometry else "not used",
        "motion": f"{motion['sigma_acceleration']:.3g} m/s², {motion['sigma_angular_acceleration']:.3g} rad/s²",
        "filters": _choices(scenario.filters),
    }
    if scenario.policies:
        lines["policies"] = _choices(scenario.policies)
    if sees:
        lines["search"] = {"flow": "the same for all filters", "forecast": "guided by each filter"}[scenario.search]
    if scenario.source.seeded:
        lines["seeds"] = f"{len(scenario.seeds)} ({_ranges(scenario.seeds)})"
    _show_lines(console, lines)


def _show_lines(console: Console, lines: Mapping[str, str]) -> None:
    for name, value in lines.items():
        console.print(f"[dim]{name:>14}[/dim]  {value}", highlight=False, soft_wrap=True)


def _choices(choices: Sequence[FilterChoice] | Sequence[PolicyChoice]) -> str:
    if len(choices) > MOST_COLUMNS:
        return f"{len(choices)}: {', '.join(choice.label for choice in choices)}"
    return ", ".join(
        choice.label + (f" {json.dumps(dict(choice.options))}" if choice.options else "") for choice in choices
    )


def show_study(console: Console, study: Study) -> None:
    """Print what is going to be run."""
    first, lines = study.cells[0], {}
    if study.factorial is not None:
        lines["crossed"] = "; ".join(f"{name}: {', '.join(map(str, of))}" for name, of in study.factorial.items())
    if study.is_grid:
        lines["study"] = f"{study.name}: {len(study.cells)} scenarios"
        for factor in first.factors:
            lines[factor] = ", ".join(dict.fromkeys(str(cell.factors.get(factor)) for cell in study.cells))
        lines[""] = "the first of them:"
    _show_lines(console, lines)
    show_settings(console, first.scenario)


def show_recording(console: Console, recording: Recording) -> None:
    """Print what a real recording holds and how it was read."""
    frames = recording.frames
    observed = sum(len(frame.observation) for frame in frames)
    referenced = sum(frame.truth is not None for frame in frames)
    noise = f"R = {json.dumps(recording.noise.R.round(6).tolist())} px² of (u, v, d)"
    if any(frame.observation.R is not None for frame in frames):
        R = np.concatenate([frame.observation.covariances(recording.noise) for frame in frames])
        median = " / ".join(f"{sigma:.2f}" for sigma in np.median(np.sqrt(np.einsum("nii->ni", R)), axis=0))
        noise = f"an R for each measurement, its median sigma {median} px of u / v / d"
    source = dict(recording.source)
    front_end = source.pop("front_end", None)
    lines = {
        "recording": f"{recording.name}: {len(frames)} frames, {frames[-1].timestamp - frames[0].timestamp:.1f} s, "
        f"{observed / len(frames):.0f} landmarks a frame, {referenced} with a reference pose",
        "rig": _rig(recording.camera),
        "reference": str(recording.reference),
        **_audit(recording),
        "its noise": noise,
        **_lasting(recording.noise, referenced > 0),
        **_rig_found(recording),
        "read as": _listed(source),
    }
    if front_end is not None:
        usual = dataclasses.asdict(TrackerSettings())
        changed = {key: value for key, value in front_end.items() if value != usual[key]}
        lines["front end"] = _listed(changed) if changed else "default settings"
    _show_lines(console, lines)


def _rig(camera: StereoCamera) -> str:
    focal = f"{camera.fx:.6g}" if camera.fx == camera.fy else f"{camera.fx:.6g} and {camera.fy:.6g}"
    return (
        f"{camera.width}x{camera.height} px, focal length {focal} px, principal point ({camera.cx:.6g}, "
        f"{camera.cy:.6g}) px, baseline {camera.baseline:.4g} m"
    )


def _lasting(noise: StereoNoise, referenced: bool) -> dict[str, str]:
    """How errors last, as `coloured-noise` is told."""
    if not isinstance(noise, ColouredNoise):
        return {}
    said = []
    if noise.drift is not None and any(noise.drift.pixels):
        steps = " / ".join(f"{step:.2f}" for step in noise.drift.pixels)
        said.append(f"each point walks {steps} px of u / v / d a frame")
    if noise.drift is not None and noise.drift.share:
        said.append(f"each point walks {noise.drift.share:.2f} of its sigma a frame")
    if noise.lasting_time is not None:
        said.append(f"its errors are forgotten with a time constant of {noise.lasting_time:.1f} s")
    if noise.gauge_walk:
        said.append(f"all together by {1e3 * noise.gauge_walk:.1f} mrad per root of a radian of image motion")
    if noise.misalignment and referenced:
        said.append(f"camera and reference are aligned to {1e3 * noise.misalignment:.0f} mrad")
    assumed = []
    if noise.disparity_offset:
        assumed.append(f"disparity offset {noise.disparity_offset:.2f} px")
    if noise.right_yaw or noise.right_roll:
        assumed.append(f"right camera {1e3 * noise.right_yaw:.1f} mrad in yaw, {1e3 * noise.right_roll:.1f} in roll")
    if noise.scale:
        assumed.append(f"scale {100 * noise.scale:.1f} %")
    lasting = {"that lasts": "; ".join(said) or "nothing"}
    return lasting | ({"assumed of the rig": f"sigmas, not measured: {', '.join(assumed)}"} if assumed else {})


def _audit(recording: Recording) -> dict[str, str]:
    """Whether the images contradict the reference; nothing where there is none, or an exact one."""
    from stereo_slam_env.frontend.reference_audit import audit_of  # needs OpenCV, which a judge of filters may lack

    found = audit_of(recording)
    return {} if found is None else {"its steps": str(found)}


def _rig_found(recording: Recording) -> dict[str, str]:
    """Errors that the filter puts down to the rig, with standard errors and how far beyond their prior they are."""
    units = {"disparity_offset": (1.0, "px"), "right_yaw": (1e3, "mrad"), "right_roll": (1e3, "mrad")}
    found = {name: (units[name], *value) for name, value in rig_errors(recording).items()}
    said = []
    for name, ((scale, unit), value, sigma) in found.items():
        words = f"{name.replace('_', ' ')} {scale * value:+.2f} ± {scale * sigma:.2f} {unit}"
        beyond = abs(value) > _FAR_FROM_PRIOR * getattr(recording.noise, name)
        said.append(words + (f" (beyond {_FAR_FROM_PRIOR:g} sigma of what a rig may be wrong by)" if beyond else ""))
    return {"put down to the rig": f"{', '.join(said)}; tracks that slide look the same"} if said else {}


def show_noise(console: Console, name: str, found: MeasurementErrors) -> None:
    """Print the errors of measurements, a block a range, a line a coordinate; then how they last."""
    rows = noise_by_range(found)
    console.print(f"errors of the measurements of {name}, px", highlight=False)
    if not rows:
        console.print("none of them has a known truth")
        return
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("depth, m")
    for heading in ("count", "", "bias", "sigma (MAD)", "claimed sigma", f"beyond {OUTLIER:g} px"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        depths = f"{row.low:g}–{row.high:g}" if math.isfinite(row.high) else f"{row.low:g} and more"
        about = ("all" if row is rows[-1] else depths, str(row.count))
        for axis, coordinate in enumerate("uvd"):
            table.add_row(
                *(about if axis == 0 else ("", "")),
                coordinate,
                f"{row.bias[axis]:+.3f}",
                f"{row.sigma[axis]:.3f}",
                f"{row.claimed[axis]:.3f}",
                f"{row.outliers[axis]:.1%}",
                end_section=axis == 2,
            )
    console.print(table, highlight=False)
    console.print("correlation of two errors of a landmark (u, v, d)", highlight=False)
    for lag in LAGS:
        known = ["–" if math.isnan(value) else f"{value:+.2f}" for value in error_correlation(found, lag)]
        frames = "1 frame" if lag == 1 else f"{lag} frames"
        console.print(f"  {frames} apart: {', '.join(known)}", highlight=False)


@contextmanager
def progress_bar(console: Console, what: str = "trials") -> Iterator[ProgressCallback]:
    """A bar with the time left, to be used as `progress=`; `what` are counted."""
    columns = (
        TextColumn("running"),
        BarColumn(),
        TextColumn("{task.fields[count]}"),
        TextColumn("{task.fields[said]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    bar = Progress(*columns, console=console)
    task = bar.add_task("running", total=None, count="", said="")

    def tell(done: float, total: int, said: str = "") -> None:
        if not bar.live.is_started:  # not before there is something to tell: wrong input is refused before that
            bar.start()
        bar.update(task, completed=done, total=total, count=f"{math.floor(done)} of {total} {what}", said=said)

    try:
        yield tell
    finally:
        if bar.live.is_started:
            bar.stop()


def show_results(console: Console, summaries: Sequence[FilterSummary], *, claims: bool = False) -> None:
    """Print the result table, a line for each option a filter was not given and for each run that failed.

    A column a filter; of many filters, a row each, with the figures that matter most. `claims`: with what is claimed of
    the final pose.
    """
    brief = len(summaries) > MOST_COLUMNS
    labels, figures = [summary.filter_name for summary in summaries], _cells(summaries, claims=claims, brief=brief)
    if brief:
        _print_columns(console, labels, figures)
    else:
        columns = [[cells[k] for cells in figures.values()] for k in range(len(labels))]
        _print_columns(console, list(figures), dict(zip(labels, columns, strict=True)))
    for summary in summaries:
        for remark in summary.remarks:
            console.print(f"[yellow]note[/yellow]: {escape(remark)}", highlight=False, soft_wrap=True)
        for failure in summary.failures:
            console.print(
                f"[red]{escape(summary.filter_name)} failed[/red]: {escape(failure)}", highlight=False, soft_wrap=True
            )


def _print_columns(console: Console, names: Sequence[str], columns: Mapping[str, Sequence[str]]) -> None:
    """Print columns by their headings beside the names of the rows: as many in one table as the console is wide."""
    longest_word = max(cell_len(word) for name in names for word in name.split())
    most = [max(map(cell_len, names))]
    least = [max(longest_word, min(_NAMES_WRAP_AT, most[0]))]
    for heading, cells in columns.items():
        of_cells = max(map(cell_len, cells))
        least.append(max(of_cells, *map(cell_len, heading.split())))
        most.append(max(of_cells, cell_len(heading)))
    columns_left = list(range(1, len(least)))
    headings, values = list(columns), list(columns.values())
    while columns_left:
        shown = [0]
        while columns_left and (len(shown) == 1 or _width([*shown, columns_left[0]], least) <= console.width):
            shown.append(columns_left.pop(0))
        spare = console.width - _width(shown, least)
        table = Table(box=None, pad_edge=False, header_style="bold")
        for k in shown:
            width = least[k] + min(max(spare, 0), most[k] - least[k])
            spare -= width - least[k]
            table.add_column(escape(headings[k - 1]) if k else "", justify="right" if k else "left", width=width)
        for row, name in enumerate(names):
            table.add_row(escape(name), *(values[k - 1][row] for k in shown[1:]))
        console.print(table, highlight=False)
        if columns_left:
            console.print()


def _width(columns: Sequence[int], widths: Sequence[int]) -> int:
    """Of some columns and what is between them."""
    return sum(widths[k] + 2 for k in columns) - 2


def show_cells(console: Console, results: Sequence[CellResult]) -> None:
    """Print the table of every cell."""
    for result in results:
        if result.cell.factors:
            console.print(f"\n[bold]{escape(result.cell.name)}[/bold]", highlight=False)
        show_results(console, result.summaries, claims=bool(result.cell.scenario.policies))
        about = *innovation_remarks(result.summaries), *motion_remarks(result.runs, result.summaries)
        words = [_headline(result), *reference_remarks(result.runs).values(), *about]
        console.print("\n" + escape("\n".join(words)) + "\n", highlight=False, soft_wrap=True)


def _headline(result: CellResult) -> str:
    scenario = result.cell.scenario
    if not scenario.policies:
        return judge(result.summaries, result.figures).headline
    verdict = judge_policies(result.summaries, result.figures, baseline=baseline_of(scenario.competitors))
    return "\n".join([verdict.headline, *(f"- {found.words}" for found in verdict.comparisons.values())])


def show_comparison(console: Console, comparison: RunComparison) -> None:
    """Print what changed between two runs, what did not, and what to bear in mind; it fits a screen."""
    console.print(escape(comparison.headline), highlight=False, soft_wrap=True)
    for warning in comparison.warnings:
        console.print(f"[yellow]note[/yellow]: {escape(warning)}", highlight=False, soft_wrap=True)
    if comparison.shown:
        table = Table(box=SIMPLE_HEAD, pad_edge=False)
        for heading in comparison.columns:
            table.add_column(heading, justify="right" if heading in ("before", "after") else "left")
        for row in comparison.as_rows():
            table.add_row(*map(escape, row))
        console.print(table, highlight=False)
    for line in comparison.rest:
        console.print(escape(line), highlight=False, soft_wrap=True)


def _cells(summaries: Sequence[FilterSummary], *, claims: bool, brief: bool) -> dict[str, list[str]]:
    """Cells of each figure by its title, one a filter; figures that no filter has are left out."""
    figures = [f for f in FIGURES.values() if "console" in f.places and (claims or f.group != "claim")]
    figures.sort(key=lambda figure: figure.group != "claim")
    if brief:
        figures = [f for f in figures if (f.name in _CLAIMS_MATTER_MOST if claims else "brief" in f.places)]
    rows = {}
    bands = {pose_nees(s)[1] for s in summaries if s.pose_anees_band is not None}
    for figure in figures:
        of_all = f" (95 %: {next(iter(bands))})" if figure is POSE_NEES and len(bands) == 1 else ""
        rows[f"{figure.title}{of_all}"] = [_cell(figure, summary) for summary in summaries]
        if figure is EFFICIENCY and not brief:
            limits = [limit_reached(summary) for summary in summaries]
            rows["95 % interval of that"] = [UNKNOWN if found is None else found.sureness for found in limits]
    return {title: cells for title, cells in rows.items() if set(cells) != {UNKNOWN}}


def _cell(figure: Figure, summary: FilterSummary) -> str:
    value = summary.figures[figure.name]
    if figure.per_runs:
        return f"{value} of {summary.runs}"
    found = limit_reached(summary) if figure is EFFICIENCY else None
    return figure.text(value) if found is None else found.value.removesuffix(" %")


def _listed(entries: Mapping[str, object]) -> str:
    return ", ".join(f"{key} = {value}" for key, value in entries.items())


def _ranges(seeds: Sequence[int]) -> str:
    consecutive = list(seeds) == list(range(seeds[0], seeds[0] + len(seeds)))
    return f"{seeds[0]} to {seeds[-1]}" if consecutive and len(seeds) > 1 else ", ".join(map(str, seeds))
