"""The command `stereo-slam evaluate`: anybody's trajectory against a reference."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from stereo_slam_env.cli.parts import JsonOption, console, show_json


def evaluate(
    estimate: Annotated[
        Path,
        typer.Argument(help="Trajectory: TUM, KITTI, or TUM with covariances (29 columns, SQUARE).", metavar="EST"),
    ],
    reference: Annotated[Path, typer.Argument(help="What it is held against, of the same formats.", metavar="REF")],
    against: Annotated[
        Path | None,
        typer.Option("--against", help="A second estimate: which of the two is better?", metavar="EST2"),
    ] = None,
    align: Annotated[
        str | None,
        typer.Option(
            "--align",
            help="'none'; 'start': first pose on first pose; 'rigid': all positions on all, without scale.",
            show_default="as the file says, or none",
        ),
    ] = None,
    max_gap: Annotated[
        float, typer.Option("--max-gap", help="Largest time between a pose and its reference, s.")
    ] = 0.01,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Write a report with pictures, too, and all figures as JSON.", show_default="none"),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge any trajectory: its errors, and whether the covariance that it claims can be believed."""
    from stereo_slam_env.benchmark.recordings.source import checked
    from stereo_slam_env.evaluation.trajectory_score import Alignment, evaluate_trajectory
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.files.json_files import write_json
    from stereo_slam_env.recording.trajectory_files import load_trajectory
    from stereo_slam_env.report.trajectory_table import show_trajectory_scores

    if out is not None:
        if out.suffix == ".json":
            raise ValueError(f"--out must be a folder, got {out}: for the figures alone, --json prints them")
        require_writable(out)
    how = None if align is None else checked("--align", align, Alignment)
    truth = load_trajectory(reference)
    estimates = [estimate] if against is None else [estimate, against]
    scores = [evaluate_trajectory(path, truth, align=how, max_gap=max_gap) for path in estimates]
    verdict = scores[0].against(scores[1]) if len(scores) > 1 else None
    figures = {"scores": [score.as_dict() for score in scores], "against": verdict and asdict(verdict)}
    if as_json:
        show_json(figures)
    else:
        show_trajectory_scores(console(), scores)
        if verdict is not None:
            typer.echo(verdict.words)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "score.json", figures)
        from stereo_slam_env.report.trajectory_report import write_trajectory_report

        page = write_trajectory_report(out, scores, verdict)
        typer.echo(f"report: {page.resolve()}", err=as_json)
