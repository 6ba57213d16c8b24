"""The command `stereo-slam train`: a network that decides where to look, by PPO."""

from __future__ import annotations

import dataclasses
import json
from typing import Annotated, Any

import typer

from stereo_slam_env.cli.parts import OutOption, console, new_directory


def train(
    decisions: Annotated[
        int, typer.Option("--decisions", help="How many the network makes; each holds for some steps.", min=1)
    ] = 120_000,
    seed: Annotated[int, typer.Option("--seed", help="Of network, actions and episodes.", min=0)] = 0,
    minutes: Annotated[
        float | None, typer.Option("--minutes", help="Stop after this time; the same command goes on.")
    ] = None,
    environments: Annotated[int, typer.Option("--environments", help="How many run in lock-step.", min=1)] = 16,
    threads: Annotated[int, typer.Option("--threads", help="Over which they are spread.", min=1)] = 1,
    environment: Annotated[str, typer.Option("--environment", help="Id of one with a head.")] = "StereoSlam/Gaze-v0",
    arguments: Annotated[str, typer.Option("--arguments", help="Of the environment, as JSON.")] = "{}",
    filter_name: Annotated[str, typer.Option("--filter", help="The filter in the loop.")] = "shared-anchor",
    reward: Annotated[
        str, typer.Option("--reward", help="information: what a belief gains. error: the truth.")
    ] = "error",
    criterion: Annotated[str, typer.Option("--criterion", help="Of the information on the pose.")] = "log-det",
    belief: Annotated[str, typer.Option("--belief", help="Whose information: filter or reference.")] = "filter",
    nees_gate: Annotated[
        float | None, typer.Option("--nees-gate", help="Nothing is paid while the NEES leaves this band.")
    ] = None,
    out: OutOption = None,
) -> None:
    """Train a network with PPO to look where a filter learns most; needs the extra rl."""
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.report.charts.policies import plot_learning
    from stereo_slam_env.report.console import progress_bar
    from stereo_slam_env.training.ppo import VALIDATION_SEEDS, LearningCurve, PPOSettings
    from stereo_slam_env.training.ppo import train as train_network
    from stereo_slam_env.training.task import GazeTask, evaluate

    directory = out or new_directory("train")
    require_writable(directory)
    paid: dict[str, Any] = {"reward": reward, "criterion": criterion, "belief": belief, "nees_gate": nees_gate}
    task = GazeTask(environment, _arguments(arguments), filter_name, **paid)
    settings = PPOSettings(decisions=decisions, seed=seed, environments=environments, threads=threads)
    try:
        with progress_bar(console(stderr=True), "decisions") as progress:
            network = train_network(task, settings, directory, minutes=minutes, progress=progress)
    except KeyboardInterrupt:
        typer.echo(f"interrupted: to go on, run the same command with --out {directory}", err=True)
        raise typer.Exit(130) from None
    straight = dataclasses.asdict(evaluate(None, task, VALIDATION_SEEDS[: settings.validation]))
    curve = LearningCurve(directory / "learning_curve.csv")
    rows = curve.rows
    plot_learning([rows], straight).save(directory / "learning_curve.png")
    best = curve.best
    for name, value in straight.items():
        typer.echo(f"{name:<24} network {best[name]:8.3f}   straight ahead {value:8.3f}")
    made = int(rows[-1]["decisions"])
    if made < decisions:
        typer.echo(f"stopped after {made:,} of {decisions:,} decisions; to go on: the same command, --out {directory}")
    typer.echo(f"network: {network.resolve()} (the best so far, after {int(best['decisions']):,} decisions)")


def _arguments(text: str) -> dict[str, object]:
    try:
        arguments = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"--arguments must be JSON, got {text!r}: {error}") from None
    if not isinstance(arguments, dict):
        raise ValueError(f"--arguments must be a JSON object, got {text!r}")
    return arguments
