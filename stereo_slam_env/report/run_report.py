"""Report of a run: one self-contained page on which filter is best, by how much, how consistent and at what cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from stereo_slam_env.benchmark.statistics.attribution import Attribution
from stereo_slam_env.benchmark.statistics.measures import PairwiseTable, compare_all
from stereo_slam_env.benchmark.statistics.policy_verdict import Looks, judge_policies
from stereo_slam_env.benchmark.statistics.remarks import innovation_remarks, reference_remarks
from stereo_slam_env.benchmark.statistics.verdict import Verdict, judge
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Bounds, Figures
from stereo_slam_env.report import tables
from stereo_slam_env.report.charts import accuracy, consistency, cost, landmarks, policies, series
from stereo_slam_env.report.charts.drawing import Chart
from stereo_slam_env.report.comparison_report import attribution_section, conclusions
from stereo_slam_env.report.overview import overview, policy_overview
from stereo_slam_env.report.page import clean_figures, data_links, figure_block, html_page, joined, part

MOST_SHOWN = 6
"""Of more filters than that, each is compared with the best one only, and the first ones have figures of their own."""


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
) -> Path:
    """Write `out/report.html`, and each of its figures as `out/figures/<name>.png` and `.svg`; returns the page.

    The page needs nothing but itself. `summaries` and `figures` are those of `runs`; `settings` is what was asked for
    (scenario, noise, gate, seeds, versions), JSON-able, perhaps nested; `attribution` is of the options that the
    filters differ in. With `looks` policies are compared: the page then first says what they claim and what is true. A
    `ValueError` says that there are no runs.
    """
    if not runs or not summaries:
        raise ValueError("runs and summaries must not be empty: there is nothing to report")
    folder = clean_figures(out)
    if looks is None:
        verdict = judge(summaries, figures)
        first_screen, pairs = overview(summaries, verdict), _pairs(summaries, figures, verdict)
    else:
        found = judge_policies(summaries, figures, baseline=looks.baseline)
        first_screen, pairs = policy_overview(summaries, found), _against(found.compared, found.baseline, "Policy")
    body = [
        reference_banner(runs),
        *([conclusions(attribution)] if attribution is not None else []),
        first_screen,
        *(part("paragraph", remark, "banner") for remark in innovation_remarks(summaries)),
        part("paragraph", _note(summaries, looks)),
        part("items", [remark for s in summaries for remark in s.remarks], "failures fair"),
        *([attribution_section(attribution, folder)] if attribution is not None else []),
        *(_drawn(section, folder) for section in _sections(runs, summaries, bounds or {}, looks)),
        pairs,
        _failures(summaries),
        part("section", "Settings", "", [part("settings", settings)]),
        data_links(out),
    ]
    path = out / "report.html"
    path.write_text(html_page(title=title, subtitle=_subtitle(runs, looks), body=joined(body)), encoding="utf-8")
    return path


def reference_banner(runs: Sequence[FilterRun]) -> Markup:
    """Reference of the runs; one that is no independent truth stands out."""
    return joined(
        [
            part("paragraph", words, "quiet" if reference.is_independent else "banner")
            for reference, words in reference_remarks(runs).items()
        ]
    )


def _note(summaries: Sequence[FilterSummary], looks: Looks | None) -> str:
    note = "Click a heading to sort by it."
    if looks is None and any(s.frames_in_band_percent is not None for s in summaries):
        note += (
            " NEES is correlated in time, so the share of the frames inside the band is a rough measure: consistent"
            " filters have some 88 to 99 % of them, and within that it ranks nothing."
        )
    return note


def _subtitle(runs: Sequence[FilterRun], looks: Looks | None) -> str:
    recordings = dict.fromkeys((run.recording_name, run.seed) for run in runs)
    first = series.first_recording(runs)[0]
    length = series.last_known(series.distance(first))
    who = len(series.by_filter(runs))
    parts = [
        f"{who} policies on identical drives"
        if looks is not None
        else f"{who} filters on identical measurements"
        if who > 1
        else "1 filter",
        f"{len(recordings)} recordings" if len(recordings) > 1 else f"1 recording ({first.recording_name})",
        f"{len(first)} frames" + (f" over {length:.0f} m" if np.isfinite(length) else ""),
    ]
    return " · ".join(parts)


# ---- sections -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Section:
    """Heading, a sentence on how to read it, a table, and figures by name with their captions."""

    heading: str
    guide: str = ""
    table: str = ""
    figures: Mapping[str, tuple[Callable[[], Chart], str]] | None = None


def _sections(
    runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], bounds: Bounds, looks: Looks | None
) -> list[_Section]:
    who = "Filter" if looks is None else "Policy"
    with_truth = any(series.scored(run).any() for run in runs)
    with_nees = any(np.isfinite(run.pose_nees).any() for run in runs)
    first = series.first_recording(runs)
    shown = f"{first[0].recording_name}" + (f", seed {first[0].seed}" if first[0].seed is not None else "")
    sections = [] if looks is None else [_gaze(runs, looks, shown)]
    sections += [_accuracy(runs, summaries, shown, who)] if with_truth else [_trajectory(runs, shown)]
    sections += _limits(runs, summaries, bounds)
    sections.append(_consistency(runs, summaries, with_nees, who))
    if with_nees:
        limits = consistency.error_limits(first)
        bounded = {
            f"error_{i}": (_later(consistency.plot_error_bounds, run, limits), f"{run.filter_name} on {shown}.")
            for i, run in enumerate(first[:MOST_SHOWN])
        }
        guide = "Position in the world, rotation in the camera frame; equal scales for all filters."
        if len(first) > MOST_SHOWN:
            guide += f" The first {MOST_SHOWN} of {len(first)} filters."
        sections.append(_Section("Errors and their 3σ bounds", guide, figures=bounded))
    sections += _map(runs, summaries, same_landmarks=looks is None)
    caption = f"Velocity in the world and heading on {shown}."
    sections.append(
        _Section("Velocity and heading", figures={"velocity": (_later(accuracy.plot_velocity, runs), caption)})
    )
    sections.append(_cost(runs, summaries, who))
    return sections


def _gaze(runs: Sequence[FilterRun], looks: Looks, shown: str) -> _Section:
    caption = (
        "Root mean squares over the runs, on one scale: a policy that claims less than its true error is overconfident."
    )
    figures = {"claim_and_truth": (_later(policies.plot_claim_and_truth, runs), caption)}
    if looks.recordings:
        caption = f"Pan and tilt of the head on {shown}."
        figures["gaze"] = (_later(policies.plot_gaze, looks.recordings), caption)
        caption = f"{shown} from above: path, landmarks seen (the others are faint), lines of sight twice a second."
        figures["gaze_map"] = (_later(policies.plot_gaze_map, looks.recordings), caption)
    return _Section("Where policies look, and what that is worth", figures=figures)


def _accuracy(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], shown: str, who: str) -> _Section:
    figures = {}
    if len({(run.recording_name, run.seed) for run in runs}) > 1 and any(
        s.position_rmse_m is not None for s in summaries
    ):
        caption = "The error of each run."
        if len(summaries) > 1:
            caption = "A line joins the errors on the same recording: look at its direction, not at the spread."
        figures["error_by_run"] = (_later(accuracy.plot_error_by_run, runs), caption)
    caption = f"Path on {shown}; errors of all runs, single ones thin, without alignment."
    figures["trajectory"] = (_later(accuracy.plot_trajectory, runs), caption)
    if any(s.rpe for s in summaries):
        caption = "Relative error over segments of the path, averaged over segments and runs."
        figures["relative_error"] = (_later(accuracy.plot_segment_errors, summaries), caption)
    return _Section("Accuracy", "", tables.accuracy_table(summaries, who), figures)


def _trajectory(runs: Sequence[FilterRun], shown: str) -> _Section:
    figures = {"trajectory": (_later(accuracy.plot_trajectory, runs), f"Path on {shown}.")}
    return _Section("Trajectory", "There is no ground truth to hold it against.", figures=figures)


def _limits(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], bounds: Bounds) -> list[_Section]:
    figures = {}
    if any((run.recording_name, run.seed) in bounds for run in runs):
        caption = (
            "Root mean square over the runs with a bound, and the posterior Cramér–Rao bound, dashed: a lower limit on"
            " average, which the mean of few runs may fall below."
        )
        figures["error_and_limit"] = (_later(accuracy.plot_error_against_bound, runs, bounds), caption)
    if any(s.efficiency_percent is not None for s in summaries):
        caption = "Bound over RMSE of each run; the stroke is that over all runs."
        figures["efficiency"] = (_later(accuracy.plot_efficiency, summaries), caption)
    guide = (
        "The posterior Cramér–Rao bound along the true trajectory: on average over such drives and noise, no unbiased"
        " filter that knows no more has a smaller error. Over few runs bound / RMSE scatters, and where its 95 %"
        " interval includes 100 %, a filter is at the limit."
    )
    return [_Section("Distance from the limit", guide, figures=figures)] if figures else []


def _consistency(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], with_nees: bool, who: str) -> _Section:
    figures = {}
    if any(s.consistency for s in summaries):
        caption = "Means by their degrees of freedom in their 95 % bands, and the share of the frames inside."
        figures["consistency"] = (_later(consistency.plot_consistency, summaries), caption)
    if with_nees:
        figures["nees"] = (
            _later(consistency.plot_nees, runs),
            "Pose NEES / 6 along the drive; the scale is logarithmic.",
        )
    caption = "Innovations along the drive, pooled over runs and short stretches of time."
    figures["nis"] = (_later(consistency.plot_nis, runs), caption)
    guide = "Above the band a filter is overconfident, below it too cautious."
    return _Section("Consistency", guide, tables.consistency_table(summaries, who), figures)


def _map(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], *, same_landmarks: bool) -> list[_Section]:
    figures = {}
    if any(s.landmark_by_range for s in summaries):
        caption = (
            "By true distance: error relative to the camera, mean depth error (Sibley's bias), NEES / 3 in (u, v, d)."
        )
        figures["landmarks"] = (_later(landmarks.plot_landmark_errors, summaries), caption)
    if any(s.depth_convergence for s in summaries):
        caption = "All landmarks of that depth at first sight: the σ a filter claims should follow its true error."
        figures["convergence"] = (_later(landmarks.plot_depth_convergence, summaries), caption)
    if same_landmarks and any(run.traces for run in runs):
        caption = (
            "Two landmarks. Dots: the frame's own disparity. A narrow band that misses the truth is false confidence."
        )
        figures["depth"] = (_later(landmarks.plot_depth, runs), caption)
    return [_Section("Map and depth", figures=figures)] if figures else []


def _cost(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], who: str) -> _Section:
    figures = {}
    if any(s.ms_per_frame is not None for s in summaries):
        figures["cost"] = (
            _later(cost.plot_cost, summaries),
            "Medians over frames and runs; of the memory, the largest growth in a run.",
        )
    caption = "Predict and update, median over runs, along the drive and by the size of the map."
    figures["time_per_frame"] = (_later(cost.plot_time_per_frame, runs), caption)
    guide = "Compare filters within a report, not across machines."
    return _Section("Cost and events", guide, tables.cost_table(summaries, who), figures)


def _later(plot: Callable[..., Chart], *arguments: Any) -> Callable[[], Chart]:
    return lambda: plot(*arguments)


def _drawn(section: _Section, folder: Path) -> Markup:
    blocks = [figure_block(plot(), name, caption, folder) for name, (plot, caption) in (section.figures or {}).items()]
    return part("section", section.heading, section.guide, [Markup(section.table), *blocks])


def _pairs(summaries: Sequence[FilterSummary], figures: Figures, verdict: Verdict) -> Markup:
    """Each filter against each other one; of many filters, each against the best one."""
    if len(summaries) < 2:
        return Markup()
    baseline = verdict.best if len(summaries) > MOST_SHOWN else None
    return _against(compare_all(summaries, figures, baseline=baseline), baseline, "Filter")


def _against(compared: PairwiseTable, baseline: str | None, who: str) -> Markup:
    if not compared.cells:
        return Markup()
    guide = (
        f"The first {who.lower()} by the second one, on the same recordings: difference in %, and its 95 % interval, "
        "corrected for the number of pairs. A colour means that interval and signed-rank test both show the difference."
    )
    heading = f"Each against {baseline}" if baseline else "Each against each"
    return part("section", heading, guide, [Markup(tables.pair_table(compared, who))])


def _failures(summaries: Sequence[FilterSummary]) -> Markup:
    lines = [f"{s.filter_name}: {failure}" for s in summaries for failure in s.failures]
    return part("section", "Failures", "", [part("items", lines)]) if lines else Markup()
