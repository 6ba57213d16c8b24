"""The command `stereo-slam train`: a network that decides where to look, by PPO."""

from __future__ import annotations

import dataclasses
import json
from importlib import import_module
from typing import Annotated, Any

import typer

from stereo_slam_env.cli.shared_options import OutOption, console, new_directory

GAZE = ("StereoSlam/Gaze-v0", *(f"StereoSlam/ActiveGaze{level}-v0" for level in ("", "-easy", "-hard")))
"""Ids of which where to look is learnt, by what a filter knows; every other id is learnt by its own reward."""


def train(
    decisions: Annotated[
        int | None, typer.Option("--decisions", help="How many it makes; 120,000, or what the task states.", min=1)
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Random seed.", min=0)] = 0,
    minutes: Annotated[
        float | None, typer.Option("--minutes", help="Stop after this time; the same command goes on.")
    ] = None,
    environments: Annotated[
        int | None, typer.Option("--environments", help="How many run in lock-step; 16, or as stated.", min=1)
    ] = None,
    threads: Annotated[int, typer.Option("--threads", help="Over which they are spread.", min=1)] = 1,
    environment: Annotated[
        str,
        typer.Option(
            "--environment",
            help="An id (module:id) that shows a Dict; the benchmarks are StereoSlam/ActiveGaze-v0, ClosedLoop-v0 and "
            "Branches-v0. Of Gaze-v0 and ActiveGaze-v0 where to look is learnt, of others their reward.",
        ),
    ] = "StereoSlam/Gaze-v0",
    arguments: Annotated[str, typer.Option("--arguments", help="Arguments of the environment, as JSON.")] = "{}",
    filter_name: Annotated[
        str | None, typer.Option("--filter", help="Looks: the filter in the loop; shared-anchor.")
    ] = None,
    reward: Annotated[
        str | None, typer.Option("--reward", help="Looks: error, the truth (default), or information, of a belief.")
    ] = None,
    criterion: Annotated[
        str | None, typer.Option("--criterion", help="Looks: of the information on the pose; log-det.")
    ] = None,
    belief: Annotated[
        str | None, typer.Option("--belief", help="Looks: whose information: filter (default) or reference.")
    ] = None,
    nees_gate: Annotated[
        float | None, typer.Option("--nees-gate", help="Looks: nothing is paid while the NEES leaves this band.")
    ] = None,
    discount: Annotated[
        float | None, typer.Option("--discount", help="Discount a decision; 0.95 for looks, 0.999 for other ids.")
    ] = None,
    validation: Annotated[
        int | None,
        typer.Option("--validation", help="Episodes that choose the network; 256, or as stated.", max=256),
    ] = None,
    out: OutOption = None,
) -> None:
    """Train a network with PPO on any task (extra rl)."""
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.policies.ppo import LearningCurve, merit, settings_for
    from stereo_slam_env.policies.ppo import train as train_network
    from stereo_slam_env.policies.registered_task import VALIDATION_SEEDS, evaluate
    from stereo_slam_env.report.charts.policies import plot_learning
    from stereo_slam_env.report.console import progress_bar

    looks = {
        **{"filter": filter_name, "reward": reward, "criterion": criterion, "belief": belief},
        "nees_gate": nees_gate,
    }
    task = _task(environment, _arguments(arguments), {name: v for name, v in looks.items() if v is not None})
    directory = out or new_directory("train")
    require_writable(directory)
    given = {"decisions": decisions, "environments": environments, "discount": discount, "validation": validation}
    settings = settings_for(
        task,
        seed=seed,
        threads=threads,
        **{name: value for name, value in given.items() if value is not None},
    )
    try:
        with progress_bar(console(stderr=True), "decisions") as progress:
            network = train_network(task, settings, directory, minutes=minutes, progress=progress)
    except KeyboardInterrupt:
        typer.echo(f"interrupted: to go on, run the same command with --out {directory}", err=True)
        raise typer.Exit(130) from None
    idle = dataclasses.asdict(evaluate(None, task, VALIDATION_SEEDS[: settings.validation]))
    curve = LearningCurve(directory / "learning_curve.csv")
    rows = curve.rows
    plot_learning([rows], idle, merit).save(directory / "learning_curve.png")
    best, held_against = curve.best, "straight ahead" if environment in GAZE else "action 0"
    for name, value in idle.items():
        typer.echo(f"{name:<24} network {best[name]:8.3f}   {held_against} {value:8.3f}")
    decisions_made = int(rows[-1]["decisions"])
    if decisions_made < settings.decisions:
        typer.echo(
            f"stopped after {decisions_made:,} of {settings.decisions:,} decisions; "
            f"to go on: the same command, --out {directory}"
        )
    typer.echo(f"network: {network.resolve()} (the best so far, after {int(best['decisions']):,} decisions)")


def _task(environment: str, arguments: dict[str, Any], looks: dict[str, Any]) -> Any:
    """Policy that is learnt in an environment."""
    import gymnasium as gym

    from filters.contract.validation import require_known
    from stereo_slam_env.envs.active_gaze import GazeTask, gaze_task
    from stereo_slam_env.policies.registered_task import RegisteredTask

    if environment == "StereoSlam/Gaze-v0":
        return GazeTask(environment, arguments, **looks)
    if environment in GAZE:
        field_names = ["level", *(each.name for each in dataclasses.fields(GazeTask))]
        require_known(f"--arguments: {environment} has no argument", arguments, field_names)
        return gaze_task(**{**gym.spec(environment).kwargs, **arguments, **looks})
    if looks:
        name = next(iter(looks))
        raise ValueError(
            f"--{name.replace('_', '-')} is of where to look ({', '.join(GAZE)}), and {environment!r} has its own "
            "reward: give --arguments"
        )
    module, _, name = environment.rpartition(":")
    if module:
        try:
            import_module(module)
        except ImportError as error:
            raise ValueError(f"--environment must name a module to import, got {environment!r}: {error}") from None
    return RegisteredTask(name, arguments)


def _arguments(text: str) -> dict[str, object]:
    try:
        arguments = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"--arguments must be JSON, got {text!r}: {error}") from None
    if not isinstance(arguments, dict):
        raise ValueError(f"--arguments must be a JSON object, got {text!r}")
    return arguments
