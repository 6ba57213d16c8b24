"""Parts that the commands share: console, one-line errors, help."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console


FiltersOption = Annotated[str | None, typer.Option("--filters", help="Names, separated by commas.", metavar="A,B")]
JobsOption = Annotated[int, typer.Option("--jobs", help="Processes, one BLAS thread each.", min=1)]
OutOption = Annotated[
    Path | None, typer.Option("--out", help="Run directory; an interrupted run in it is resumed.", show_default="new")
]


class Interrupted(Exception):
    """Ctrl-C during a run."""

    def __init__(self, directory: Path) -> None:
        super().__init__(f"interrupted, results so far are in {directory}")
        self.directory = directory
        self.kept = len(list(directory.glob("**/trials/*/*.npz")))


def console(*, stderr: bool = False) -> Console:
    """Console for tables and progress."""
    from rich.console import Console

    return Console(stderr=stderr)


def refuse(message: str) -> int:
    """Say what is wrong in one line on stderr; returns the exit code."""
    line = " ".join(message.split())
    # Names of files and fields may come from anybody, and a terminal obeys control characters.
    typer.echo("error: " + "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line), err=True)
    return 2


def rig_from(text: str) -> str | dict[str, Any]:
    """The rig that `--rig` says: NAME, KEY=NUMBER,... or NAME,KEY=NUMBER,... ."""
    rig: dict[str, Any] = {}
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            key, value = "name", key
        try:
            number = value if key == "name" else int(value) if value.lstrip("+-").isdecimal() else float(value)
        except ValueError:
            raise ValueError(f"--rig must be a name, numbers or both, as vga,baseline=0.2, got {text!r}") from None
        if key in rig:
            raise ValueError(f"--rig must give each number and the name once, got {text!r}")
        rig[key] = number
    return text.strip() if set(rig) == {"name"} else rig


def show_place(page: Path) -> None:
    """Say where results are."""
    typer.echo(f"tables and time series: {page.parent.resolve()}")
    typer.echo(f"report: {page.resolve()}")


def group(about: str, **options: Any) -> typer.Typer:
    """A group of commands, which shows its help where it is called without one."""
    return typer.Typer(help=about, callback=_help_without_command, invoke_without_command=True, **options)


def _help_without_command(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def show_lines(lines: Mapping[str, str], width: int = 0) -> None:
    """Names, and one line on each."""
    width = max(width, *map(len, lines))
    for name, line in lines.items():
        typer.echo(f"{name:<{width}}  {line}")


def new_directory(name: str) -> Path:
    """Run directory that is named after the command or scenario and the time."""
    return Path("runs") / f"{name}-{datetime.datetime.now():%Y%m%d-%H%M%S}"
