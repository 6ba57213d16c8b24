"""The commands `stereo-slam calibrate` and `stereo-slam claim`: a covariance for systems that have none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereo_slam_env.cli.parts import (
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
    """Learn from drives with a truth how the error of an odometry grows; for `claim`."""
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
    model: Annotated[Path, typer.Argument(help="What `calibrate` wrote.", metavar="MODEL.json")],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Where the trajectory goes, .square.", show_default="EST.square, here"),
    ] = None,
) -> None:
    """Write a trajectory with a covariance for each pose and, by its header, for each motion between two poses."""
    from stereo_slam_env.evaluation.drift_model import DriftModel
    from stereo_slam_env.evaluation.drift_model import claim as claimed
    from stereo_slam_env.recording.trajectory_files import load_trajectory, save_trajectory

    path = Path(f"{estimate.stem}.square") if out is None else out
    if path.suffix != ".square":
        raise ValueError(f"--out must end in .square, which has covariances, got {path}")
    if path.resolve() == estimate.resolve():
        raise ValueError(f"--out would replace the estimate, {estimate}: give another name")
    save_trajectory(path, claimed(load_trajectory(estimate), DriftModel.read(model)))
    typer.echo(f"trajectory: {path.resolve()}")


_UNLIKE = 20.0
"""An interval of the NEES of a new drive that is so many times as high as low says little: deviations off by 4.5."""


def _show(model: DriftModel) -> None:
    """Print how the drives are covered by the model of the others."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    if model.coverage_error is None:
        typer.echo("one drive: nothing is known of its coverage of another one, give two or more; ten are few")
        return
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for title in ("windows, s", "drives", "NEES / 6", "inside the 90 % ellipsoid, %"):
        table.add_column(title, justify="right")
    for check in model.checks:
        table.add_row(
            f"{check.seconds:g}", f"{check.drives}", f"{check.nees / 6.0:.2f}", f"{100.0 * check.coverage:.0f}"
        )
    console().print(table, highlight=False)
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
