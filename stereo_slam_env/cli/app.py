"""The command `stereo-slam`. Heavy modules are imported where they are used, so that `--help` is quick."""

from __future__ import annotations

import _thread
import shlex
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereo_slam_env.cli import bench as cli_bench
from stereo_slam_env.cli import evaluate as cli_evaluate
from stereo_slam_env.cli import recordings as cli_recordings
from stereo_slam_env.cli import reports as cli_reports
from stereo_slam_env.cli import scenes as cli_scenes
from stereo_slam_env.cli import train as cli_train
from stereo_slam_env.cli import warm_up as cli_warm_up
from stereo_slam_env.cli.shared_options import (
    FILTER_GROUPS,
    GroupedCommands,
    Interrupted,
    JsonOption,
    PanelledOptions,
    TakesTruths,
    group,
    refuse,
    show_groups,
    show_json,
    show_lines,
)

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

INTERRUPTED = 130
_MOVED = {
    **dict.fromkeys(("--sigma-px", "--sigma"), "noise.independent_pixels=PX"),
    "--gate": "gate=PROBABILITY, or gate=none",
    "--search": "search=forecast",
    **dict.fromkeys(("--consensus", "--no-consensus"), "consensus=true, or consensus=false"),
    "--reference": "options.reference.kind=surveyed",
    "--skip-broken": "options.on_broken=skip",
}
"""Options that `bench` and `replay` once had, and what `--set` takes in their place."""

app = typer.Typer(
    cls=GroupedCommands,
    help="Compare stereo EKF-SLAM filters on identical measurements, simulated or real.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
filters_app = group("List and check filters, installed ones of others included.")
app.add_typer(filters_app, name="filters")
policies_app = group("List the policies that decide where to look.")
app.add_typer(policies_app, name="policies")
app.add_typer(cli_scenes.app, name="scenes")
app.command(cls=PanelledOptions)(cli_bench.bench)
app.command(cls=PanelledOptions)(cli_bench.replay)
app.command(cls=TakesTruths)(cli_evaluate.evaluate)
app.command(cls=TakesTruths)(cli_evaluate.calibrate)
app.command()(cli_evaluate.claim)
app.command()(cli_reports.report)
app.command()(cli_reports.submit)
app.command()(cli_reports.verify)
app.command()(cli_recordings.convert)
app.command()(cli_reports.paper)
app.command()(cli_train.train)
app.command()(cli_warm_up.warm_up)
app.command()(cli_recordings.view)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code. Wrong use gets one line on stderr and exit code 2."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    for option in (argument.partition("=")[0] for argument in arguments if arguments[0] in ("bench", "replay")):
        if option in _MOVED:
            return refuse(f"there is no option {option} any more: give --set {_MOVED[option]}")
    try:
        with _no_interruption_is_lost():
            code = app(args=arguments, prog_name="stereo-slam", standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt):  # the latter from outside of what Typer guards
        return INTERRUPTED
    except Interrupted as stopped:
        resume = [*arguments, *([] if "--out" in shlex.join(arguments) else ["--out", str(stopped.directory)])]
        typer.echo(f"interrupted: {stopped.kept} finished trials are kept in {stopped.directory}", err=True)
        typer.echo(f"to go on: stereo-slam {shlex.join(resume)}", err=True)
        return INTERRUPTED
    except ModuleNotFoundError as error:
        from filters.contract.extras import explained

        return refuse(str(explained(error)))
    except (ValueError, OSError, ImportError) as error:  # wrong input is the user's business, not a crash
        return refuse(str(error))
    except Exception as error:
        # Usage errors of typer have no public base class in every version; what they share is this method.
        explain = getattr(error, "format_message", None)
        if explain is None:
            raise
        return refuse(explain())
    return code if isinstance(code, int) else 0


@contextmanager
def _no_interruption_is_lost() -> Iterator[None]:
    """Interrupt again where Python drops what is raised: in destructors, and in functions that machine code calls.

    What was half made when the interruption came may complain as it is destroyed: that is not printed.
    """
    before, interrupted = signal.getsignal(signal.SIGINT), False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        raise KeyboardInterrupt

    def unraisable(dropped: UnraisableHookArgs) -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            threading.Timer(0.05, _thread.interrupt_main).start()
        elif not interrupted:
            sys.__unraisablehook__(dropped)

    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield
        return
    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if not interrupted:
            sys.unraisablehook = hook


@app.callback(invoke_without_command=True)
def _start(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    if version:
        from stereo_slam_env.files.package_versions import __version__

        typer.echo(f"stereo-slam {__version__}")
        raise typer.Exit()
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@filters_app.command("list")
def list_filters(as_json: JsonOption = False) -> None:
    """List all filters."""
    from filters import available_filters

    show_groups(available_filters(), FILTER_GROUPS, as_json=as_json)


@policies_app.command("list")
def list_policies(as_json: JsonOption = False) -> None:
    """List all policies."""
    from stereo_slam_env.policies import available_policies

    show_lines(available_policies(), as_json=as_json)


def _filter_names(incomplete: str) -> list[str]:
    from filters import available_filters

    return [name for name in available_filters() if name.startswith(incomplete)]


@filters_app.command("check")
def check(
    name: Annotated[
        str, typer.Argument(help="Name of a filter, or MODULE:CLASS of your own.", autocompletion=_filter_names)
    ],
    as_json: JsonOption = False,
) -> None:
    """Check that a filter is right; exit code 1 if it is not."""
    from filters import check_filter

    checked: Any = name
    if ":" in name:
        from stereo_slam_env.benchmark.recordings.sources import resolve_callable

        sys.path.insert(0, "")  # modules of the working directory
        checked = resolve_callable("name must be a filter or MODULE:CLASS", name)
    result = check_filter(checked, raise_on_failure=False)
    if as_json:
        show_json({"filter": name, "passed": list(result.passed), "failed": list(result.failed)})
    else:
        typer.echo(str(result))
    if result.failed:
        raise typer.Exit(1)
