"""The commands `evaluate`, anybody's trajectory against a reference, and `calibrate` and `claim`, its covariance."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereo_slam_env.cli.shared_options import (
    BodyEstimatedOption,
    BodyOption,
    JsonOption,
    TruthOption,
    body_from,
    console,
    show_json,
)

if TYPE_CHECKING:
    from stereo_slam_env.evaluation.drift_model import DriftModel
    from stereo_slam_env.evaluation.trajectory_score import TrajectoryScore
    from stereo_slam_env.recording.seed_files import SeedFiles
    from stereo_slam_env.recording.trajectory import Trajectory


def evaluate(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Trajectories, the reference last: TUM, KITTI, EuRoC, OpenVINS, cnspy, SQUARE, ROS, or BAG:/topic. "
            "Several estimates are runs of one estimator, and so are all that match {seed}.",
            metavar="EST... [REF]",
        ),
    ],
    truth: TruthOption = [],  # noqa: B006
    against: Annotated[
        Path | None,
        typer.Option("--against", help="A second estimate: which of the two is better?", metavar="EST2"),
    ] = None,
    align: Annotated[
        str | None,
        typer.Option(
            "--align",
            help="'none'; 'start': first pose on first pose; 'gravity-yaw': position and heading; 'rigid'; 'sim3': and "
            "scale.",
            show_default="the gauge of the file",
        ),
    ] = None,
    align_seconds: Annotated[
        float | None,
        typer.Option("--align-seconds", help="Align by the first so many seconds; 0: by one pose.", show_default="all"),
    ] = None,
    up: Annotated[str, typer.Option("--up", help="Axis of gravity in the reference's world: x, y or z.")] = "z",
    body: BodyOption = None,
    body_estimated: BodyEstimatedOption = False,
    offset: Annotated[
        str, typer.Option("--time-offset", help="Seconds to add to the estimate's times, or 'auto'.", metavar="S")
    ] = "0",
    interpolate: Annotated[bool, typer.Option("--interpolate", help="Interpolate the reference.")] = False,
    max_gap: Annotated[
        float, typer.Option("--max-gap", help="Largest time between a pose and its reference, s.")
    ] = 0.01,
    pair: Annotated[
        bool,
        typer.Option("--pair", help="Compare two estimates without ground truth."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Write a report with pictures, too, and all figures as JSON.", show_default="none"),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge any trajectory: its errors and its covariance."""
    from stereo_slam_env.benchmark.recordings.source import checked
    from stereo_slam_env.evaluation.gauges import AlignmentKind
    from stereo_slam_env.evaluation.trajectory_runs import score_runs
    from stereo_slam_env.evaluation.trajectory_score import SCHEMA, evaluate_trajectory
    from stereo_slam_env.files.folders import own_files, require_writable, write_json
    from stereo_slam_env.recording.seed_files import SeedFiles, has_seed
    from stereo_slam_env.recording.trajectory_files import load_trajectory
    from stereo_slam_env.report.trajectory_table import notes_of_runs, show_runs_score, show_trajectory_scores

    *estimates, last = files
    references = list(truth)
    if references or any(map(has_seed, files)) or not estimates:
        estimates.append(last)
    else:
        references = [last]
    by_seed = any(map(has_seed, [*estimates, *references]))
    if by_seed:
        seeds = _seeds(estimates, references)
    else:
        seeds = SeedFiles({f"{k}": files for k, files in enumerate(_pairs(estimates, references))})
    if out is not None:
        if out.suffix == ".json":
            raise ValueError(f"--out must be a folder, got {out}: for the figures alone, --json prints them")
        require_writable(out)
    if (len(seeds.pairs) > 1 or by_seed) and against is not None:
        raise ValueError("--against compares one estimate with another: give one estimate, not runs")
    how = None if align is None else checked("--align", align, AlignmentKind)
    T_bc = body_from(body, body_estimated)

    def score(path: Trajectory | Path, truth: Trajectory) -> TrajectoryScore:
        return evaluate_trajectory(
            path,
            truth,
            align=how,
            align_seconds=align_seconds,
            up=up,
            body=T_bc,
            time_offset="auto" if offset == "auto" else _seconds(offset),
            interpolate=interpolate,
            max_gap=max_gap,
            pair=pair,
        )

    truths = {at: load_trajectory(at) for at in dict.fromkeys(at for _, at in seeds.pairs.values())}
    scores: list[TrajectoryScore] = []
    failed = dict(seeds.missing)
    for seed, (path, at) in seeds.pairs.items():
        try:
            scores.append(score(replace(load_trajectory(path), name=seed) if by_seed else path, truths[at]))
        except ValueError as error:
            if not by_seed:
                raise
            failed[seed] = str(error)  # a run that left nothing to score counts, as one that failed
    if not scores:
        raise ValueError(
            f"none of {len(failed)} runs can be scored, {next(iter(failed))}: {next(iter(failed.values()))}"
        )
    if against is not None:
        scores.append(score(against, next(iter(truths.values()))))
    verdict = scores[0].against(scores[1]) if against is not None else None
    runs, by_itself = None, ""
    if by_seed:
        runs = score_runs(scores, failed)
    elif len(scores) > 1 and against is None:
        try:
            runs = score_runs(scores)
        except ValueError as error:  # errors stand side by side without a claim, too
            by_itself = f"each is judged by itself: {error}" if any(score.claims for score in scores) else ""
    figures = {
        "schema": SCHEMA,
        "scores": [score.as_dict() for score in scores],
        "against": verdict and asdict(verdict),
        "runs": runs and runs.as_dict(),
    }
    if as_json:
        show_json(figures)
    elif runs is not None:
        show_runs_score(console(), runs, notes_of_runs(scores))
    else:
        show_trajectory_scores(console(), scores)
        for words in filter(None, (verdict and verdict.words, by_itself)):
            typer.echo(words)
    if out is not None:
        own_files(out, ["score.json", "report.html"])
        write_json(out / "score.json", figures)
        from stereo_slam_env.report.trajectory_report import write_trajectory_report

        page = write_trajectory_report(out, scores, verdict, runs)
        typer.echo(f"report: {page.resolve()}", err=as_json)


def _pairs(estimates: list[Path], references: list[Path]) -> list[tuple[Path, Path]]:
    """Each estimate with its reference: one for all, one for each, or that beside a single estimate."""
    from stereo_slam_env.recording.seed_files import truth_beside

    if not references and len(estimates) == 1 and (beside := truth_beside(estimates[0])) is not None:
        references = [beside]
    if not references:
        raise ValueError(f"evaluate needs an estimate and a reference, got {estimates[-1]} alone")
    if len(references) not in (1, len(estimates)):
        raise ValueError(f"--truth must name one reference, or one for each of {len(estimates)}, got {len(references)}")
    return [(estimate, references[k % len(references)]) for k, estimate in enumerate(estimates)]


def _seeds(estimates: list[Path], references: list[Path]) -> SeedFiles:
    """Runs by the pattern of the estimates and that of the truths."""
    from stereo_slam_env.recording.seed_files import seed_files

    if len(estimates) == 2 and not references:
        estimates, references = estimates[:1], estimates[1:]
    if len(estimates) != 1 or len(references) > 1:
        raise ValueError(
            f"a pattern with {{seed}} names all runs of one system, got {len(estimates)} estimates and "
            f"{len(references)} truths: give one of each"
        )
    return seed_files(estimates[0], references[0] if references else None)


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"--time-offset must be a number of seconds or 'auto', got {text!r}") from error


def calibrate(
    estimates: Annotated[
        list[Path],
        typer.Argument(help="Trajectories of one system, a drive each, with times.", metavar="EST..."),
    ],
    truth: TruthOption,
    out: Annotated[Path, typer.Option("--out", help="Where the model goes, JSON.")] = Path("model.json"),
    body: BodyOption = None,
    body_estimated: BodyEstimatedOption = False,
    max_gap: Annotated[float, typer.Option("--max-gap", help="Largest time between a pose and its truth, s.")] = 0.01,
    as_json: JsonOption = False,
) -> None:
    """Learn from drives with a truth how an odometry errs."""
    from stereo_slam_env.evaluation.drift_calibration import calibrate as learned
    from stereo_slam_env.files.folders import require_writable

    if out.suffix != ".json":
        raise ValueError(f"--out must end in .json, got {out}")
    require_writable(out.parent)
    model = learned(estimates, truth, body=body_from(body, body_estimated), max_gap=max_gap)
    model.write(out)
    if as_json:
        show_json(model.as_dict())
        return
    _show(model)
    typer.echo(f"model: {out.resolve()}")


def claim(
    estimate: Annotated[Path, typer.Argument(help="A trajectory of the same system, with times.", metavar="EST")],
    model: Annotated[Path, typer.Argument(help="Model written by `calibrate`.", metavar="MODEL.json")],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Where the trajectory goes, .square.", show_default="EST.square, here"),
    ] = None,
    ros: Annotated[
        Path | None,
        typer.Option(
            "--ros", help="Also write the 36 numbers of ROS messages, and settings of an EKF.", metavar="OUT.yaml"
        ),
    ] = None,
    optical: Annotated[
        bool,
        typer.Option(
            "--optical", help="In --ros: the poses are a camera's, z forward; turn body and world to x forward, z up."
        ),
    ] = False,
) -> None:
    """Give a trajectory the covariance that `calibrate` learned."""
    from stereo_slam_env.evaluation.drift_model import DriftModel
    from stereo_slam_env.evaluation.drift_model import claim as claimed
    from stereo_slam_env.evaluation.ros_covariances import ros_covariances, write_ros_yaml
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.recording.trajectory_files import load_trajectory, save_trajectory

    path = Path(f"{estimate.stem}.square") if out is None else out
    if path.suffix != ".square":
        raise ValueError(f"--out must end in .square, which has covariances, got {path}")
    if path.resolve() == estimate.resolve():
        raise ValueError(f"--out would replace the estimate, {estimate}: give another name")
    if ros is None and optical:
        raise ValueError("--optical turns the axes of --ros OUT.yaml: give both")
    if ros is not None and ros.suffix not in (".yaml", ".yml"):
        raise ValueError(f"--ros must end in .yaml, got {ros}")
    for file in filter(None, (path, ros)):
        require_writable(file.parent)
    trajectory = claimed(load_trajectory(estimate), DriftModel.read(model))
    messages = None if ros is None else ros_covariances(trajectory, optical=optical)
    save_trajectory(path, trajectory)
    typer.echo(f"trajectory: {path.resolve()}")
    if ros is None or messages is None:
        return
    write_ros_yaml(ros, messages)
    typer.echo(f"for ROS: {ros.resolve()}")
    if messages.drives_along_z and not optical:
        typer.echo("the body drives along its z axis, as a camera's does: --optical turns it to x forward, z up")


_UNLIKE = 20.0
"""An interval of the NEES of a new drive that is so many times as high as low says little: deviations off by 4.5."""


def _show(model: DriftModel) -> None:
    """Print how the drives are covered by the model of the others."""
    from stereo_slam_env.report.table import Column, Table, show_table

    if model.coverage_error is None:
        typer.echo("one drive: nothing is known of its coverage of another one, give two or more; ten are few")
        return
    columns = [Column("windows", "s"), Column("drives"), Column("NEES / 6"), Column("inside the 90 % ellipsoid", "%")]
    rows = [
        [f"{check.seconds:g}", f"{check.drives}", f"{check.nees / 6.0:.2f}", f"{100.0 * check.coverage:.0f}"]
        for check in model.checks
    ]
    show_table(console(), Table(columns, rows))
    typer.echo(
        f"each of {len(model.drives)} drives by the model of the others; 90 % are covered on average, "
        f"± {100.0 * model.coverage_error:.0f} % by their number, after the variances were multiplied by "
        f"{model.factor:.3g}"
    )
    if model.drive_range is not None:
        low, high = model.drive_range
        typer.echo(
            f"of one new drive, NEES / 6 is expected between {low:.2g} and {high:.2g} (90 %), by how these differ"
            + (": they are too few or too unlike for a claim on a single drive" if high > _UNLIKE * low else "")
        )
