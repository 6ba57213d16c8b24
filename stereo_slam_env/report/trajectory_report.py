"""Report of judged trajectories: the verdict, the path, errors and NEES, calibration, alignments, windows, figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stereo_slam_env.evaluation.figures import readable
from stereo_slam_env.evaluation.paired_verdict import PairedVerdict
from stereo_slam_env.evaluation.trajectory_runs import RunsScore, labels_of
from stereo_slam_env.evaluation.trajectory_score import TrajectoryScore
from stereo_slam_env.report.charts import trajectories
from stereo_slam_env.report.page import Content, Drawing, Section, clean_figures, data_section, part, write_page
from stereo_slam_env.report.trajectory_table import (
    alignment_text,
    gauge_table,
    headline,
    notes_of,
    notes_of_runs,
    runs_errors_table,
    runs_table,
    score_table,
)

DRAWN = 4
"""Runs of one estimator that are drawn one by one; all count."""


def write_trajectory_report(
    out: str | Path,
    scores: Sequence[TrajectoryScore],
    verdict: PairedVerdict | None = None,
    runs: RunsScore | None = None,
) -> Path:
    """Write `out/report.html`, and each of its figures as `out/figures/<name>.png` and `.svg`.

    Parameters
    ----------
    out : str or Path
        Folder, made where it is missing.
    scores : sequence of TrajectoryScore
        Estimates, all against the same reference.
    verdict : PairedVerdict, optional
        Of the first one against the second one.
    runs : RunsScore, optional
        Where the estimates are runs of one estimator: what they show together.

    Returns
    -------
    Path
        The page; it needs nothing but itself.

    Raises
    ------
    ValueError
        There are no scores.
    """
    if not scores:
        raise ValueError("scores must not be empty: there is nothing to report")
    out = Path(out)
    clean_figures(out)
    title, subtitle = f"{' and '.join(labels_of(scores))} against {scores[0].reference}", _extent(scores)
    each = part("items", [headline(score) for score in scores], "headline" if runs is None else "")
    if runs is not None:
        title = f"{runs.total} runs, judged together"
    contents: list[Content] = [
        each if runs is None else part("paragraph", runs.words, "headline"),
        *([part("paragraph", verdict.words, "headline")] if verdict is not None else []),
        part("items", notes_of(scores) if runs is None else notes_of_runs(scores), "failures fair"),
    ]
    if runs is not None:
        contents.append(_together(runs))
    some = f"The first {DRAWN} of {len(scores)} runs, here and below." if runs and len(scores) > DRAWN else ""
    scores = scores[:DRAWN] if runs else scores
    contents += [_path(scores, some), *_consistency(scores), *_windows(scores)]
    contents += (
        [] if runs is None else [Section("Each run", [each], "One run is one draw: only together they say much.")]
    )
    contents += [Section("Figures", [score_table(scores)]), data_section(out)]
    return write_page(out / "report.html", title=title, subtitle=subtitle, contents=contents)


def _extent(scores: Sequence[TrajectoryScore]) -> str:
    """Poses, ways and alignments of all estimates, where they differ from the least to the most."""
    frames, ways = [score.frames for score in scores], [score.path_m for score in scores]
    poses = " to ".join(dict.fromkeys(f"{one}" for one in (min(frames), max(frames))))
    way = " to ".join(dict.fromkeys(readable(one) for one in (min(ways), max(ways))))
    each = " each" if len(scores) > 1 else ""
    return (
        f"{poses} scored poses over {way} m{each} · aligned: {' or '.join(dict.fromkeys(map(alignment_text, scores)))}"
    )


def _together(runs: RunsScore) -> Section:
    """What runs of one estimator show together."""
    caption = f"Mean over {len(runs.runs)} runs, which are independent: the more, the narrower the band."
    guide = "Many runs together show what none of them shows alone."
    claims: list[Content] = (
        [Drawing("runs", caption, trajectories.plot_runs(runs)), runs_table(runs)] if runs.claims else []
    )
    return Section("All runs together", [*claims, runs_errors_table(runs)], guide)


def _path(scores: Sequence[TrajectoryScore], guide: str) -> Section:
    chart, factor = trajectories.plot_paths(scores)
    caption = "Reference and estimates."
    if _claiming(scores):
        caption += (
            " The tubes are 3σ across the path: where the reference leaves one, the error is larger than claimed."
        )
    if factor != 1.0:
        caption += f" Errors{' and tubes' if _claiming(scores) else ''} are drawn {factor:g} times as large."
    return Section("Path", [Drawing("path", caption, chart)], guide)


def _consistency(scores: Sequence[TrajectoryScore]) -> list[Section]:
    guide = "Position in the world, rotation in the body; equal scales for all estimates."
    charts = zip(labels_of(scores), trajectories.plot_errors(scores), strict=True)
    drawn = [Drawing(f"errors_{i}", f"{name}.", chart) for i, (name, chart) in enumerate(charts)]
    sections = [Section("Errors and their 3σ bounds" if _claiming(scores) else "Errors", drawn, guide)]
    if _claiming(scores):
        guide = "Above the band the claimed covariance is too small, below it too large."
        caption = "95 % of the frames of a true claim are inside the band."
        over_time = Drawing("nees", caption, trajectories.plot_nees_over_time(scores))
        caption = "Left: below the dashed line the claim is too small. Right: a peak at the right end says the same."
        calibration = Drawing("calibration", caption, trajectories.plot_calibration(scores))
        sections.append(Section("Can the covariance be believed?", [over_time, calibration], guide))
        sections.append(_alignments(scores))
    return sections


def _alignments(scores: Sequence[TrajectoryScore]) -> Section:
    """The claim under each alignment."""
    guide = (
        "The same claim on the pose, by the alignment of the worlds; the covariance is carried through each. Errors of "
        f"two poses are taken as {' and '.join(dict.fromkeys(score.correlation for score in scores))}."
    )
    return Section("Alignments", [gauge_table(scores)], guide)


def _windows(scores: Sequence[TrajectoryScore]) -> list[Section]:
    """How the error grows with the length of a window."""
    if not any(len(score.windows) > 1 for score in scores):
        return []
    guide = "Motion over windows does not hang on the alignment, nor on one early error of the heading."
    caption = "A straight line is a power law: a random walk grows with the root of the time, a wrong scale with it."
    return [Section("Drift", [Drawing("windows", caption, trajectories.plot_windows(scores))], guide)]


def _claiming(scores: Sequence[TrajectoryScore]) -> bool:
    return any(score.claims for score in scores)
