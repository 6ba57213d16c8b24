"""Parts that the commands share: console, one-line errors, help."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console


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


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Wrong input is the user's business, not a crash: one line on stderr, exit code 2."""
    try:
        yield
    except BrokenPipeError:  # who reads has seen enough (`... | head`): typer ends without a word
        raise
    except (ValueError, OSError, ImportError) as error:
        raise typer.Exit(refuse(str(error))) from error


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


def help_without_command(context: typer.Context) -> None:
    """The help of a group of commands that is called without one."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
