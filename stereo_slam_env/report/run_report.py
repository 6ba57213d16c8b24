"""Report of a run: one self-contained page on which filter is best, by how much, how consistent and at what cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from markupsafe import Markup

from stereo_slam_env.benchmark.statistics.attribution import Attribution
from stereo_slam_env.benchmark.statistics.differences import MIN_PAIRS
from stereo_slam_env.benchmark.statistics.measures import (
    PairwiseTable,
    compare_all,
    compare_systems,
    run_spread,
    systems,
)
from stereo_slam_env.benchmark.statistics.policy_verdict import Looks, judge_policies
from stereo_slam_env.benchmark.statistics.remarks import innovation_remarks, motion_remarks, reference_remarks
from stereo_slam_env.benchmark.statistics.verdict import Verdict, judge
from stereo_slam_env.evaluation.audits import ReferenceAudit
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Bounds, Figures, RunKey, key_of
from stereo_slam_env.report import tables
from stereo_slam_env.report.charts import accuracy, factors, nees, policies, series
from stereo_slam_env.report.charts.drawing import Chart
from stereo_slam_env.report.comparison_report import attribution_section, conclusions
from stereo_slam_env.report.overview import colour_key, overview, policy_overview
from stereo_slam_env.report.page import TABLES, Recordings, clean_figures, data_section, figure_blocks, part, write_page

MOST_SHOWN = 6
"""Of more filters than that, each is compared with the best one only, and the first ones have figures of their own."""

MOST_FAILURES = 100
"""Failures of a filter that are listed; the trial table has all."""

_AUDIT_NOTE = (
    "Tracks of each frame, carried to the next one by the step of the reference, and by the motion that fits them best."
    " Where the two disagree, one of them is wrong, and errors of a filter say little. A drift over many frames is not"
    " seen here."
)


def write_report(
    out: Path,
    title: str,
    runs: Sequence[FilterRun],
    summaries: Sequence[FilterSummary],
    figures: Figures,
    settings: Mapping[str, Any],
    *,
    bounds: Bounds | None = None,
    attribution: Attribution | None = None,
    looks: Looks | None = None,
    recordings: Recordings | None = None,
    audits: Mapping[str, ReferenceAudit] = MappingProxyType({}),
) -> Path:
    """Write `out/report.html`, figures as `out/figures/<name>.png` and `.svg`, tables as `out/tables/<name>.tex`.

    Returns the page, which needs nothing but itself. Charts are of `runs`; `summaries` and `figures` are of these and,
    in a large campaign, of more, whose time series are not kept: all tables and tests are of them. `settings` is what
    was asked for (scenario, noise, gate, seeds, versions), JSON-able, perhaps nested; `attribution` is of the options
    that the filters differ in; `recordings` are linked, and `audits` say by
    their names where the images contradict the reference. With `looks` policies are compared: the page then first says
    what they claim and what is true. A `ValueError` says that there are no runs.
    """
    if not runs or not summaries:
        raise ValueError("runs and summaries must not be empty: there is nothing to report")
    folder = clean_figures(out)
    if looks is None:
        verdict = judge(summaries, figures)
        first_screen, pairs = overview(summaries, verdict), _pairs(summaries, figures, verdict, out)
    else:
        found = judge_policies(summaries, figures, baseline=looks.baseline)
        first_screen, pairs = policy_overview(summaries, found), _against(found.compared, found.baseline, "Policy", out)
    body = [
        reference_banner(runs),
        *([conclusions(attribution)] if attribution is not None else []),
        first_screen,
        colour_key([summary.filter_name for summary in summaries]),
        *(part("paragraph", remark, "banner") for remark in innovation_remarks(summaries)),
        part("paragraph", _note(summaries, looks) + _drawn(runs, figures)),
        part("items", [remark for s in summaries for remark in s.remarks], "failures fair"),
        *([attribution_section(attribution, folder)] if attribution is not None else []),
        *_drawn_sections(runs, summaries, bounds or {}, looks, audits, folder),
        pairs,
        _failures(summaries),
        part("section", "Settings", "", [part("settings", settings)]),
        data_section(out, recordings),
    ]
    return write_page(out / "report.html", title=title, subtitle=_subtitle(runs, figures, looks), parts=body)


def reference_banner(runs: Sequence[FilterRun]) -> Markup:
    """Reference of the runs; one that is no independent truth stands out."""
    return Markup("\n").join(
        [
            part("paragraph", words, "quiet" if reference.is_independent else "banner")
            for reference, words in reference_remarks(runs).items()
        ]
    )


def _note(summaries: Sequence[FilterSummary], looks: Looks | None) -> str:
    note = "Click a heading to sort by it."
    if looks is None and any(s.frames_in_band_percent is not None for s in summaries):
        note += " NEES is correlated in time, so the share of the frames inside the band is a rough measure"
        runs = max((s.consistency["pose"].runs for s in summaries if "pose" in s.consistency), default=0)
        if runs >= MIN_PAIRS:
            note += ": consistent filters have some 88 to 99 % of them, and within that it ranks nothing."
        else:
            note += f", and of {'one run' if runs == 1 else f'{runs} runs'} it tells nothing."
    return note


def _drawn(runs: Sequence[FilterRun], figures: Figures) -> str:
    """Of which recordings the charts are, where they are not of all."""
    drawn, count = len(set(map(key_of, runs))), len(_recordings(figures))
    if drawn == count:
        return ""
    return f" Tables and tests are of all {count} recordings, curves and dots of the first {drawn}."


def _recordings(figures: Figures) -> set[RunKey]:
    return {key for of_filter in figures.values() for key in of_filter.of_run}


def _subtitle(runs: Sequence[FilterRun], figures: Figures, looks: Looks | None) -> str:
    recordings = _recordings(figures)
    first = series.first_recording(runs)[0]
    length = series.last_known(series.distance(first))
    by_filter = series.by_filter(runs)
    outside = sum(all(map(_is_from_outside, of_one)) for of_one in by_filter.values())
    who = len(by_filter) - outside
    frames = sorted({len(run) for run in runs})
    each = f"{frames[0]}" if len(frames) == 1 else f"{frames[0]} to {frames[-1]}"
    parts = [
        f"{who} policies on identical drives"
        if looks is not None
        else f"{who} filters on identical measurements"
        if who > 1
        else "1 filter"
        if who
        else "no filter",
        *([f"{outside} trajector{'y' if outside == 1 else 'ies'} from outside"] if outside else []),
        f"{len(recordings)} recordings" if len(recordings) > 1 else f"1 recording ({first.recording_name})",
        f"{each} frames{' each' if len(recordings) > 1 else ''}"
        + (f", {'the first ' if len(recordings) > 1 else ''}over {length:.3g} m" if np.isfinite(length) else ""),
    ]
    return " · ".join(parts)


def _is_from_outside(run: FilterRun) -> bool:
    """Whether it is a trajectory of another program: neither innovations nor times of its frames are known."""
    return run.failure is None and not (np.isfinite(run.nis).any() or np.isfinite(run.milliseconds).any())


# ---- sections -------------------------------------------------------------------------------------------------------


def _drawn_sections(
    runs: Sequence[FilterRun],
    summaries: Sequence[FilterSummary],
    bounds: Bounds,
    looks: Looks | None,
    audits: Mapping[str, ReferenceAudit],
    folder: Path,
) -> list[Markup]:
    """The sections; their charts are made first, then all are drawn at once and put in their places."""
    charts: dict[str, tuple[Chart, str]] = {}

    def draw(name: str, caption: str, plot: Callable[..., Chart], *arguments: Any) -> Markup:
        charts[name] = plot(*arguments), caption
        return Markup('<figure id="{}"></figure>').format(name)

    sections = Markup("\n").join(_sections(runs, summaries, bounds, looks, audits, draw, folder.parent / TABLES))
    for name, block in figure_blocks(charts, folder).items():
        sections = sections.replace(Markup('<figure id="{}"></figure>').format(name), block)
    return [sections]


def _sections(
    runs: Sequence[FilterRun],
    summaries: Sequence[FilterSummary],
    bounds: Bounds,
    looks: Looks | None,
    audits: Mapping[str, ReferenceAudit],
    draw: Callable[..., Markup],
    folder: Path,
) -> Iterator[Markup]:
    who = "Filter" if looks is None else "Policy"
    with_truth = any(series.scored(run).any() for run in runs)
    with_nees = any(np.isfinite(run.pose_nees).any() for run in runs)
    first = series.first_recording(runs)
    where = f"{first[0].recording_name}" + (f", seed {first[0].seed}" if first[0].seed is not None else "")

    def latex(name: str) -> Path:
        return folder / f"{name}.tex"

    if looks is not None:
        yield part("section", "Where policies look, and what that is worth", "", [*_gaze(runs, looks, where, draw)])
    if with_truth:
        table = tables.figures_table(summaries, ["accuracy"], who, latex("accuracy"))
        yield part("section", "Accuracy", "", [table, *_accuracy(runs, summaries, where, draw)])
    else:
        drawn = draw("trajectory", f"Path on {where}.", accuracy.plot_trajectory, runs)
        truth = any(np.isfinite(run.true_positions).all(axis=1).any() for run in runs)
        none = (
            "No filter came to a frame with ground truth." if truth else "There is no ground truth to hold it against."
        )
        yield part("section", "Trajectory", none, [drawn])
    if limits := [*_limits(runs, summaries, bounds, draw)]:
        guide = (
            "The posterior Cramér–Rao bound along the true trajectory: on average over such drives and noise, no"
            " unbiased filter that knows no more has a smaller error. Over few runs bound / RMSE scatters, and where"
            " its 95 % interval includes 100 %, a filter is at the limit."
        )
        yield part("section", "Distance from the limit", guide, limits)
    guide = " ".join(
        ["Above the band a filter is overconfident, below it too cautious.", *motion_remarks(runs, summaries)]
    )
    table = tables.consistency_table(summaries, who, latex("consistency"))
    yield part("section", "Consistency", guide, [table, *_consistency(runs, summaries, with_nees, draw)])
    if drawings := [*_audits(audits, draw)]:
        yield part("section", "Is the reference right?", _AUDIT_NOTE, drawings)
    if with_nees:
        limit = nees.error_limits(first)
        guide = "Position in the world, rotation in the camera frame; equal scales for all filters."
        if len(first) > MOST_SHOWN:
            guide += f" The first {MOST_SHOWN} of {len(first)} filters."
        bounded = [
            draw(f"error_{i}", f"{run.filter_name} on {where}.", nees.plot_error_bounds, run, limit)
            for i, run in enumerate(first[:MOST_SHOWN])
        ]
        yield part("section", "Errors and their 3σ bounds", guide, bounded)
    if drawings := [*_map(runs, summaries, draw, same_landmarks=looks is None)]:
        yield part("section", "Map and depth", "", drawings)
    caption = f"Velocity in the world and heading on {where}."
    yield part("section", "Velocity and heading", "", [draw("velocity", caption, accuracy.plot_velocity, runs)])
    guide = "Compare filters within a report, not across machines."
    table = tables.figures_table(summaries, ["cost", "events"], who, latex("cost"))
    yield part("section", "Cost and events", guide, [table, *_cost(runs, summaries, draw)])


def _audits(audits: Mapping[str, ReferenceAudit], draw: Callable[..., Markup]) -> Iterator[Markup]:
    for number, (name, audit) in enumerate(audits.items()):
        if len(audit.frames):
            yield draw(f"audit_{number}", f"{name}: {audit}.", accuracy.plot_audit, audit)


def _gaze(runs: Sequence[FilterRun], looks: Looks, shown: str, draw: Callable[..., Markup]) -> Iterator[Markup]:
    caption = (
        "Root mean squares over the runs, on one scale: a policy that claims less than its true error is overconfident."
    )
    yield draw("claim_and_truth", caption, policies.plot_claim_and_truth, runs)
    if looks.recordings:
        yield draw("gaze", f"Pan and tilt of the head on {shown}.", policies.plot_gaze, looks.recordings)
        caption = f"{shown} from above: path, landmarks seen (the others are faint), lines of sight twice a second."
        yield draw("gaze_map", caption, policies.plot_gaze_map, looks.recordings)


def _accuracy(
    runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], shown: str, draw: Callable[..., Markup]
) -> Iterator[Markup]:
    if len(set(map(key_of, runs))) > 1 and any(s.position_rmse_m is not None for s in summaries):
        caption = "The error of each run."
        if len(summaries) > 1:
            caption = (
                "Each dot is a run; below, by the error of the best filter on the same recording: right of 1 is worse."
            )
        yield draw("error_by_run", caption, accuracy.plot_error_by_run, runs)
    caption = f"Path on {shown}; errors of all runs, single ones thin, without alignment."
    yield draw("trajectory", caption, accuracy.plot_trajectory, runs)
    if any(s.rpe for s in summaries):
        caption = "Relative error over segments of the path, averaged over segments and runs."
        yield draw("relative_error", caption, accuracy.plot_segment_errors, summaries)


def _limits(
    runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], bounds: Bounds, draw: Callable[..., Markup]
) -> Iterator[Markup]:
    if any(key_of(run) in bounds for run in runs):
        caption = (
            "Root mean square over the runs with a bound, and the posterior Cramér–Rao bound, dashed: a lower limit on"
            " average, which the mean of few runs may fall below."
        )
        yield draw("error_and_limit", caption, accuracy.plot_error_against_bound, runs, bounds)
    if any(s.efficiency_percent is not None for s in summaries):
        caption = "Bound over RMSE of each run; the stroke is that over all runs."
        yield draw("efficiency", caption, accuracy.plot_efficiency, summaries)


def _consistency(
    runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], with_nees: bool, draw: Callable[..., Markup]
) -> Iterator[Markup]:
    if any(s.consistency for s in summaries):
        caption = "Means by their degrees of freedom in their 95 % bands, and the share of the frames inside."
        yield draw("consistency", caption, nees.plot_consistency, summaries)
    if with_nees:
        yield draw("nees", "Pose NEES / 6 along the drive; the scale is logarithmic.", nees.plot_nees, runs)
    caption = "Innovations along the drive, pooled over runs and short stretches of time."
    yield draw("nis", caption, nees.plot_nis, runs)


def _map(
    runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], draw: Callable[..., Markup], *, same_landmarks: bool
) -> Iterator[Markup]:
    if any(s.landmark_by_range for s in summaries):
        caption = (
            "By true distance: error relative to the camera, mean depth error (Sibley's bias), NEES / 3 in (u, v, d)."
        )
        yield draw("landmarks", caption, nees.plot_landmark_errors, summaries)
    if any(s.depth_convergence for s in summaries):
        caption = "All landmarks of that depth at first sight: the σ a filter claims should follow its true error."
        yield draw("convergence", caption, nees.plot_depth_convergence, summaries)
    if same_landmarks and any(run.traces for run in runs):
        caption = (
            "Two landmarks. Dots: the frame's own disparity. A narrow band that misses the truth is false confidence."
        )
        yield draw("depth", caption, nees.plot_depth, runs)


def _cost(
    runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], draw: Callable[..., Markup]
) -> Iterator[Markup]:
    if any(s.ms_per_frame is not None for s in summaries):
        caption = "Medians over frames and runs; of the memory, the largest growth in a run."
        yield draw("cost", caption, factors.plot_cost, summaries)
    caption = "Predict and update, median over runs, along the drive and by the size of the map."
    yield draw("time_per_frame", caption, factors.plot_time_per_frame, runs)


def _pairs(summaries: Sequence[FilterSummary], figures: Figures, verdict: Verdict, out: Path) -> Markup:
    """Each filter against each other one; of many filters, each against the best one."""
    if len(summaries) < 2:
        return Markup()
    baseline = verdict.best if len(summaries) > MOST_SHOWN else None
    return _repeated(figures, out) + _against(
        compare_all(summaries, figures, baseline=baseline), baseline, "Filter", out
    )


def _repeated(figures: Figures, out: Path) -> Markup:
    """Systems over runs and recordings, where one is run several times."""
    compared = compare_systems(figures)
    if compared is None:
        return Markup()
    many = {name: labels for name, labels in systems(list(figures)).items() if len(labels) > 1}
    repeats = [
        f"{name}: {len(labels)} runs of each recording, whose position errors scatter by "
        f"{100 * run_spread(figures, labels):.2g} % (standard deviation)"
        for name, labels in many.items()
    ]
    guide = (
        f"{'; '.join(repeats)}. Of each recording the mean over runs counts, and the recordings are the sample: their"
        " scatter holds that of the runs, too. A system that is run once counts as it is."
    )
    table = tables.pair_table(compared, "System", out / TABLES / "systems.tex")
    return part("section", "Systems, over runs and recordings", guide, [table])


def _against(compared: PairwiseTable, baseline: str | None, who: str, out: Path) -> Markup:
    if not compared.cells:
        return Markup()
    guide = (
        f"The first {who.lower()} by the second one, run by run on the same recordings: the geometric mean of the"
        " ratios, as a difference in %, and its 95 % interval, corrected for the number of pairs, where there are"
        " enough runs. A colour means that interval and signed-rank test both show the difference."
    )
    heading = f"Each against {baseline}" if baseline else "Each against each"
    return part("section", heading, guide, [tables.pair_table(compared, who, out / TABLES / "pairs.tex")])


def _failures(summaries: Sequence[FilterSummary]) -> Markup:
    lines = [f"{s.filter_name}: {failure}" for s in summaries for failure in s.failures[:MOST_FAILURES]]
    lines += [
        f"{s.filter_name}: {more} more, see the trial table"
        for s in summaries
        if (more := len(s.failures) - MOST_FAILURES) > 0
    ]
    return part("section", "Failures", "", [part("items", lines)]) if lines else Markup()
