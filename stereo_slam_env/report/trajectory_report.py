"""Report of judged trajectories: the verdict, the path with its covariance tube, errors and NEES, all figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from stereo_slam_env.evaluation.trajectory_score import PairedVerdict, TrajectoryScore
from stereo_slam_env.report.charts import trajectories
from stereo_slam_env.report.data_section import data_section
from stereo_slam_env.report.page import clean_figures, figure_block, part, write_page
from stereo_slam_env.report.page_tables import Cell, Column, table
from stereo_slam_env.report.trajectory_table import headline, score_rows, unusable_note


def write_trajectory_report(
    out: str | Path, scores: Sequence[TrajectoryScore], verdict: PairedVerdict | None = None
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
    folder = clean_figures(out)
    body = [
        part("items", [headline(score) for score in scores], "headline"),
        *([part("paragraph", verdict.words, "headline")] if verdict is not None else []),
        part("items", [note for score in scores if (note := unusable_note(score))], "failures fair"),
        _path(scores, folder),
        *_consistency(scores, folder),
        part("section", "Figures", "", [_figures(scores)]),
        data_section(out),
    ]
    names = " and ".join(trajectories.labels_of(scores))
    subtitle = f"{scores[0].frames} scored poses over {scores[0].path_m:.0f} m · aligned: {scores[0].alignment}"
    return write_page(
        out / "report.html", title=f"{names} against {scores[0].reference}", subtitle=subtitle, parts=body
    )


def _path(scores: Sequence[TrajectoryScore], folder: Path) -> Markup:
    chart, factor = trajectories.plot_paths(scores)
    caption = "Reference and estimates."
    if _claiming(scores):
        caption += (
            " The tubes are 3σ across the path: where the reference leaves one, the error is larger than claimed."
        )
    if factor != 1.0:
        caption += f" Errors{' and tubes' if _claiming(scores) else ''} are drawn {factor:g} times as large."
    return part("section", "Path", "", [figure_block(chart, "path", caption, folder)])


def _consistency(scores: Sequence[TrajectoryScore], folder: Path) -> list[Markup]:
    guide = "Position in the world, rotation in the body; equal scales for all estimates."
    charts = zip(trajectories.labels_of(scores), trajectories.plot_errors(scores), strict=True)
    drawn = [figure_block(chart, f"errors_{i}", f"{name}.", folder) for i, (name, chart) in enumerate(charts)]
    sections = [part("section", "Errors and their 3σ bounds" if _claiming(scores) else "Errors", guide, drawn)]
    if _claiming(scores):
        guide = "Above the band the claimed covariance is too small, below it too large."
        caption = "95 % of the frames of a true claim are inside the band."
        drawn = [figure_block(trajectories.plot_nees_over_time(scores), "nees", caption, folder)]
        sections.append(part("section", "Can the covariance be believed?", guide, drawn))
    return sections


def _claiming(scores: Sequence[TrajectoryScore]) -> bool:
    return any(score.claims for score in scores)


def _figures(scores: Sequence[TrajectoryScore]) -> Markup:
    columns = [Column(f"against {scores[0].reference}", kind="text")]
    columns += [Column(label) for label in trajectories.labels_of(scores)]
    rows: list[list[Cell | str]] = [[title, *cells] for title, cells in score_rows(scores)]
    return table(columns, rows)
