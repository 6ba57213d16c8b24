"""Report of a run: one self-contained page on which filter is best, by how much, how consistent and at what cost."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
from stereo_slam_env.benchmark.statistics.remarks import (
    body_remarks,
    innovation_remarks,
    motion_remarks,
    reference_remarks,
)
from stereo_slam_env.benchmark.statistics.verdict import Verdict, judge
from stereo_slam_env.evaluation.audits import ReferenceAudit
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Bounds, Figures, RunKey, key_of
from stereo_slam_env.report import tables
from stereo_slam_env.report.charts import accuracy, bodies, factors, nees, policies, series
from stereo_slam_env.report.comparison_report import attribution_section, conclusions
from stereo_slam_env.report.overview import colour_key, overview, policy_overview
from stereo_slam_env.report.page import (
    Content,
    Drawing,
    Recordings,
    Section,
    clean_figures,
    data_section,
    part,
    write_page,
)

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
    clean_figures(out)
    if looks is None:
        verdict = judge(summaries, figures)
        first_screen, pairs = overview(summaries, verdict), _pairs(summaries, figures, verdict)
    else:
        found = judge_policies(summaries, figures, baseline=looks.baseline)
        first_screen = policy_overview(summaries, found)
        pairs = _against(found.compared, found.baseline, "Policy")
    contents: list[Content] = [
        reference_banner(runs),
        *([conclusions(attribution)] if attribution is not None else []),
        first_screen,
        colour_key([summary.filter_name for summary in summaries]),
        *(part("paragraph", remark, "banner") for remark in innovation_remarks(summaries)),
        part("paragraph", _note(summaries, looks) + _drawn(runs, figures)),
        part("items", [remark for s in summaries for remark in s.remarks], "failures fair"),
        *([attribution_section(attribution)] if attribution is not None else []),
        *_sections(runs, summaries, bounds or {}, looks, audits),
        *pairs,
        _failures(summaries),
        Section("Settings", [part("settings", settings)]),
        data_section(out, recordings),
    ]
    return write_page(out / "report.html", title=title, subtitle=_subtitle(runs, figures, looks), contents=contents)


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
            note += ": consistent filters have 88 to 99 % of them; differences within that mean nothing."
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


def _sections(
    runs: Sequence[FilterRun],
    summaries: Sequence[FilterSummary],
    bounds: Bounds,
    looks: Looks | None,
    audits: Mapping[str, ReferenceAudit],
) -> Iterator[Section]:
    who = "Filter" if looks is None else "Policy"
    with_truth = any(series.scored(run).any() for run in runs)
    with_nees = any(np.isfinite(run.pose_nees).any() for run in runs)
    first = series.first_recording(runs)
    where = f"{first[0].recording_name}" + (f", seed {first[0].seed}" if first[0].seed is not None else "")

    if looks is not None:
        yield Section("Where policies look, and what that is worth", [*_gaze(runs, looks, where)])
    if with_truth:
        table = tables.figures_table(summaries, ["accuracy"], who, "accuracy")
        yield Section("Accuracy", [table, *_accuracy(runs, summaries, where)])
    else:
        drawn = Drawing("trajectory", f"Path on {where}.", accuracy.plot_trajectory(runs))
        truth = any(np.isfinite(run.true_positions).all(axis=1).any() for run in runs)
        none = (
            "No filter came to a frame with ground truth." if truth else "There is no ground truth to hold it against."
        )
        yield Section("Trajectory", [drawn], none)
    guide = (
        "The posterior Cramér–Rao bound along the true trajectory: on average over such drives and noise, no unbiased"
        " filter that knows no more has a smaller error. Over few runs bound / RMSE scatters, and where its 95 %"
        " interval includes 100 %, a filter is at the limit."
    )
    yield Section("Distance from the limit", [*_limits(runs, summaries, bounds)], guide)
    guide = " ".join(
        ["Above the band a filter is overconfident, below it too cautious.", *motion_remarks(runs, summaries)]
    )
    table = tables.consistency_table(summaries, who, "consistency")
    means = [table] if len(table.columns) > 1 else []
    yield Section("Consistency", [*means, *_consistency(runs, summaries, with_nees)], guide)
    yield Section("Is the reference right?", [*_audits(audits)], _AUDIT_NOTE)
    if with_nees:
        limit = nees.error_limits(first)
        guide = "Position in the world, rotation in the camera frame; equal scales for all filters."
        if len(first) > MOST_SHOWN:
            guide += f" The first {MOST_SHOWN} of {len(first)} filters."
        bounded = [
            Drawing(f"error_{i}", f"{run.filter_name} on {where}.", nees.plot_error_bounds(run, limit))
            for i, run in enumerate(first[:MOST_SHOWN])
        ]
        yield Section("Errors and their 3σ bounds", bounded, guide)
    yield Section("Map and depth", [*_map(runs, summaries, same_landmarks=looks is None)])
    with_bodies = [run for run in first if run.bodies is not None and len(run.bodies.frames)]
    table = tables.figures_table(summaries, ["bodies"], who, "bodies")
    contents = [table] if len(table.columns) > 1 else []
    yield Section("Moving bodies", [*contents, *_bodies(with_bodies, where)], " ".join(body_remarks(with_bodies)))
    caption = f"Velocity in the world and heading on {where}."
    yield Section("Velocity and heading", [Drawing("velocity", caption, accuracy.plot_velocity(runs))])
    guide = "Compare filters within a report, not across machines."
    table = tables.figures_table(summaries, ["cost", "events"], who, "cost")
    yield Section("Cost and events", [table, *_cost(runs, summaries)], guide)


def _bodies(runs: Sequence[FilterRun], where: str) -> Iterator[Content]:
    for i, run in enumerate(runs[:MOST_SHOWN]):
        caption = (
            f"Bodies of {run.filter_name} on {where}, at {bodies.INSTANTS} instants at most: ellipses of"
            f" {bodies.SIGMAS:g}σ, arrows where they are a second later."
        )
        if run.bodies is not None:
            yield Drawing(f"bodies_{i}", caption, bodies.plot_body_map(run, run.bodies))
    if any(run.bodies is not None and np.isfinite(run.bodies.pose_nees).any() for run in runs):
        caption = f"Bodies on {where} from 1 s after birth; grey: the 95 % band; the scale is logarithmic."
        yield Drawing("body_nees", caption, bodies.plot_body_nees(runs))


def _audits(audits: Mapping[str, ReferenceAudit]) -> Iterator[Content]:
    for number, (name, audit) in enumerate(audits.items()):
        if len(audit.frames):
            yield Drawing(f"audit_{number}", f"{name}: {audit}.", accuracy.plot_audit(audit))


def _gaze(runs: Sequence[FilterRun], looks: Looks, shown: str) -> Iterator[Content]:
    caption = (
        "Root mean squares over the runs, on one scale: a policy that claims less than its true error is overconfident."
    )
    yield Drawing("claim_and_truth", caption, policies.plot_claim_and_truth(runs))
    if looks.recordings:
        yield Drawing("gaze", f"Pan and tilt of the head on {shown}.", policies.plot_gaze(looks.recordings))
        caption = f"{shown} from above: path, landmarks seen (the others are faint), lines of sight twice a second."
        yield Drawing("gaze_map", caption, policies.plot_gaze_map(looks.recordings))


def _accuracy(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], shown: str) -> Iterator[Content]:
    if len(set(map(key_of, runs))) > 1 and any(s.position_rmse_m is not None for s in summaries):
        caption = "The error of each run."
        if len(summaries) > 1:
            caption = (
                "Each dot is a run; below, by the error of the best filter on the same recording: right of 1 is worse."
            )
        yield Drawing("error_by_run", caption, accuracy.plot_error_by_run(runs))
    caption = f"Path on {shown}; errors of all runs, single ones thin, without alignment."
    yield Drawing("trajectory", caption, accuracy.plot_trajectory(runs))
    if any(s.rpe for s in summaries):
        caption = "Relative error over segments of the path, averaged over segments and runs."
        yield Drawing("relative_error", caption, accuracy.plot_segment_errors(summaries))


def _limits(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], bounds: Bounds) -> Iterator[Content]:
    if any(key_of(run) in bounds for run in runs):
        caption = (
            "Root mean square over the runs with a bound, and the posterior Cramér–Rao bound, dashed: a lower limit on"
            " average, which the mean of few runs may fall below."
        )
        yield Drawing("error_and_limit", caption, accuracy.plot_error_against_bound(runs, bounds))
    if any(s.efficiency_percent is not None for s in summaries):
        caption = "Bound over RMSE of each run; the stroke is that over all runs."
        yield Drawing("efficiency", caption, accuracy.plot_efficiency(summaries))


def _consistency(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], with_nees: bool) -> Iterator[Content]:
    if any(s.consistency for s in summaries):
        caption = "Means by their degrees of freedom in their 95 % bands, and the share of the frames inside."
        yield Drawing("consistency", caption, nees.plot_consistency(summaries))
    if with_nees:
        yield Drawing("nees", "Pose NEES / 6 along the drive; the scale is logarithmic.", nees.plot_nees(runs))
    caption = "Innovations along the drive, pooled over runs and short stretches of time."
    yield Drawing("nis", caption, nees.plot_nis(runs))


def _map(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary], *, same_landmarks: bool) -> Iterator[Content]:
    if any(s.landmark_by_range for s in summaries):
        caption = (
            "By true distance: error relative to the camera, mean depth error (Sibley's bias), NEES / 3 in (u, v, d)."
        )
        yield Drawing("landmarks", caption, nees.plot_landmark_errors(summaries))
    if any(s.depth_convergence for s in summaries):
        caption = "All landmarks of that depth at first sight: the σ a filter claims should follow its true error."
        yield Drawing("convergence", caption, nees.plot_depth_convergence(summaries))
    if same_landmarks and any(run.traces for run in runs):
        caption = (
            "Two landmarks. Dots: the frame's own disparity. A narrow band that misses the truth is false confidence."
        )
        yield Drawing("depth", caption, nees.plot_depth(runs))


def _cost(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary]) -> Iterator[Content]:
    if any(s.ms_per_frame is not None for s in summaries):
        caption = "Medians over frames and runs; of the memory, the largest growth in a run."
        yield Drawing("cost", caption, factors.plot_cost(summaries))
    caption = "Predict and update, median over runs, along the drive and by the size of the map."
    yield Drawing("time_per_frame", caption, factors.plot_time_per_frame(runs))


def _pairs(summaries: Sequence[FilterSummary], figures: Figures, verdict: Verdict) -> list[Section]:
    """Each filter against each other one; of many filters, each against the best one."""
    if len(summaries) < 2:
        return []
    baseline = verdict.best if len(summaries) > MOST_SHOWN else None
    compared = compare_all(summaries, figures, baseline=baseline)
    return [*_repeated(figures), *_against(compared, baseline, "Filter")]


def _repeated(figures: Figures) -> list[Section]:
    """Systems over runs and recordings, where one is run several times."""
    compared = compare_systems(figures)
    if compared is None:
        return []
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
    return [Section("Systems, over runs and recordings", [tables.pair_table(compared, "System", "systems")], guide)]


def _against(compared: PairwiseTable, baseline: str | None, who: str) -> list[Section]:
    if not compared.cells:
        return []
    guide = (
        f"The first {who.lower()} by the second one, run by run on the same recordings: the geometric mean of the"
        " ratios, as a difference in %, and its 95 % interval, corrected for the number of pairs, where there are"
        " enough runs. A colour means that interval and signed-rank test both show the difference."
    )
    heading = f"Each against {baseline}" if baseline else "Each against each"
    return [Section(heading, [tables.pair_table(compared, who, "pairs")], guide)]


def _failures(summaries: Sequence[FilterSummary]) -> Section:
    lines = [f"{s.filter_name}: {failure}" for s in summaries for failure in s.failures[:MOST_FAILURES]]
    lines += [
        f"{s.filter_name}: {more} more, see the trial table"
        for s in summaries
        if (more := len(s.failures) - MOST_FAILURES) > 0
    ]
    return Section("Failures", [part("items", lines)])
