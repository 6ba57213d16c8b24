"""Parts that the commands share: console, one-line errors, help."""

from __future__ import annotations

import datetime
import inspect
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from filters import Pose


FiltersOption = Annotated[
    str | None,
    typer.Option(
        "--filters", help="Names, or tables such as {name = 'hybrid', options = {gate = 0.9}}.", metavar="A,B"
    ),
]
JobsOption = Annotated[int, typer.Option("--jobs", help="Processes, one BLAS thread each.", min=1)]
BodyOption = Annotated[
    Path | None,
    typer.Option(
        "--body",
        help="Pose of the reference's body in the estimate's: JSON with R (9 numbers) and t (m).",
        metavar="T.json",
        show_default="the same body",
    ),
]
BodyEstimatedOption = Annotated[
    bool, typer.Option("--body-estimated", help="Take the pose of the body that fits best.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead, for other programs.")]
TruthOption = Annotated[
    list[Path], typer.Option("--truth", help="A reference for each, in the same order, or one.", metavar="REF...")
]
OutOption = Annotated[
    Path | None, typer.Option("--out", help="Run directory; an interrupted run in it is resumed.", show_default="new")
]


@dataclass
class ImagesOptions:
    """Options of the commands that read stereo images."""

    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            help="Calibration file of the images, raw or rectified (KITTI, EuRoC, Kalibr, ROS, OpenCV), or numbers.",
            show_default="that of the recording",
        ),
    ] = None
    truth: Annotated[
        str | None,
        typer.Option(
            "--truth", help="Poses of the left camera: a TUM file or another trajectory.", show_default="its own"
        ),
    ] = None
    truth_body: Annotated[
        Path | None,
        typer.Option(
            "--truth-body",
            help="Pose of the left camera in the body of --truth: JSON with R (9 numbers) and t (m).",
            metavar="T.json",
            show_default="the left camera",
        ),
    ] = None
    image_topics: Annotated[
        str | None,
        typer.Option(
            "--image-topics",
            help="Images of a bag, where CameraInfo does not tell them.",
            metavar="LEFT,RIGHT",
            show_default="those of the only pair",
        ),
    ] = None
    imu_topic: Annotated[
        str | None,
        typer.Option(
            "--imu-topic", help="Inertial unit of a bag.", show_default="the only one with a place on the rig"
        ),
    ] = None
    odometry_topic: Annotated[
        str | None, typer.Option("--odometry-topic", help="Wheels of a bag, not an odometry from its pictures.")
    ] = None
    rate: Annotated[
        float | None, typer.Option("--rate", help="Frames a second of tracks without times.", metavar="HZ")
    ] = None

    def given(self) -> dict[str, Any]:
        """Arguments of `open_image_sequence`, JSON-able."""
        from stereo_slam_env.sensing.rigs import Rig, calibration_of

        options: dict[str, Any] = {}
        if self.rig is not None:
            rig: Rig = rig_from(self.rig)
            calibration_of(rig)  # refused before any work
            options["rig"] = rig
        if self.truth is not None:
            options["truth"] = self.truth
        if self.truth_body is not None:
            options["body"] = str(self.truth_body)
        if self.image_topics is not None:
            options["left"], comma, options["right"] = self.image_topics.partition(",")
            if not comma:
                raise ValueError(f"--image-topics needs two topics, LEFT,RIGHT, got {self.image_topics!r}")
        topics = {"imu": self.imu_topic, "odometry": self.odometry_topic}
        options |= {name: topic for name, topic in topics.items() if topic is not None}
        return options if self.rate is None else {**options, "rate": self.rate}


def body_from(path: Path | None, estimated: bool) -> Pose | Literal["estimated"] | None:
    """The pose of the reference's body that `--body` and `--body-estimated` say."""
    from stereo_slam_env.evaluation.body_frames import read_body

    if path is not None and estimated:
        raise ValueError("--body gives what --body-estimated looks for: leave one of them out")
    return "estimated" if estimated else None if path is None else read_body(path)


ADVANCED = "Advanced"
COMMAND_GROUPS = {
    "Commands": ("bench", "replay", "evaluate", "report", "paper", "view", "filters"),
    ADVANCED: (*("calibrate", "claim", "convert", "submit", "verify"), *("scenes", "train", "policies", "warm-up")),
}


class PanelledOptions(TyperCommand):
    """A command that lists the options of its panel "Advanced" after the others."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the lists."""
        records: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": [], ADVANCED: []}
        for one in self.get_params(ctx):
            usual = "Arguments" if one.param_type_name == "argument" else "Options"
            if record := one.get_help_record(ctx):
                records[getattr(one, "rich_help_panel", None) or usual].append(record)
        for title, lines in records.items():
            if lines:
                with formatter.section(title):
                    formatter.write_dl(lines)


class GroupedCommands(TyperGroup):
    """The commands, those for every day first."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section a group: each command and the first sentence of its help."""
        for title, names in COMMAND_GROUPS.items():
            commands = {name: self.get_command(ctx, name) for name in names}
            with formatter.section(title):
                formatter.write_dl([(n, c.get_short_help_str(limit=200)) for n, c in commands.items() if c])


class TakesTruths(TyperCommand):
    """A command whose `--truth` takes all files up to the next option, as a shell writes out `--truth *.csv`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat the option before each of its files."""
        spelled: list[str] = []
        taking = False
        for argument, following in zip(args, [*args[1:], "-"], strict=False):
            taking = argument == "--truth" or (taking and not argument.startswith("-"))
            if argument == "--truth" and not following.startswith("-"):
                continue
            spelled += ["--truth", argument] if taking and argument != "--truth" else [argument]
        return super().parse_args(ctx, spelled)


class Interrupted(Exception):
    """Ctrl-C during a run."""

    def __init__(self, directory: Path) -> None:
        super().__init__(f"interrupted, results so far are in {directory}")
        self.directory = directory
        self.kept = len(list(directory.glob("**/trials/*/*.npz")))


def console(*, stderr: bool = False) -> Console:
    """Console for tables and progress, where what strangers have named does not control the terminal."""
    from rich.console import Console

    class PlainConsole(Console):
        def render_str(self, text: str, **options: Any) -> Text:
            from filters.contract.validation import plain

            return super().render_str(plain(text), **options)

    return PlainConsole(stderr=stderr)


def refuse(message: str) -> int:
    """Say what is wrong in one line on stderr; returns the exit code."""
    from filters.contract.validation import plain

    typer.echo(f"error: {plain(' '.join(message.split()))}", err=True)
    return 2


def rig_from(text: str) -> str | dict[str, Any]:
    """The rig that `--rig` says: NAME or FILE, KEY=NUMBER,..., both, left=FILE,right=FILE, or a table as JSON."""
    if text.lstrip().startswith("{"):
        return _table("--rig", text.strip())
    rig: dict[str, Any] = {}
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            key, value = "name", key
        try:
            number = (
                value
                if key in ("name", "left", "right")
                else int(value)
                if value.lstrip("+-").isdecimal()
                else float(value)
            )
        except ValueError:
            raise ValueError(f"--rig must be a name, numbers or both, as vga,baseline=0.2, got {text!r}") from None
        if key in rig:
            raise ValueError(f"--rig must give each number and the name once, got {text!r}")
        rig[key] = number
    return text.strip() if set(rig) == {"name"} else rig


def settings_from(texts: Iterable[str]) -> dict[str, Any]:
    """Values by dotted keys that KEY=VALUE give: as TOML has them, else as text; "none" is none."""
    from stereo_slam_env.files.readers import parse_toml

    settings: dict[str, Any] = {}
    for text in texts:
        key, equals, value = (piece.strip() for piece in text.partition("="))
        if not (equals and value and all(key.split("."))):
            raise ValueError(f"--set must be KEY=VALUE, as noise.independent_pixels=0.5, got {text!r}")
        try:
            settings[key] = parse_toml(f"value = {value}")["value"]
        except ValueError:
            settings[key] = None if value == "none" else value
    return settings


def listed(option: str, text: str) -> list[str | dict[str, Any]]:
    """Names and tables, as TOML or JSON has them, separated by commas: A,{name = "B", options = {gate = 0.9}}.

    Raises
    ------
    ValueError
        A table is written as neither of them has it.
    """
    pieces, depth = [""], 0
    for character in text:
        depth += {"{": 1, "}": -1}.get(character, 0)
        if character == "," and depth == 0:
            pieces.append("")
        else:
            pieces[-1] += character
    entries = [piece.strip() for piece in pieces if piece.strip()]
    return [_table(option, entry) if entry.startswith("{") else entry for entry in entries]


def _table(option: str, text: str) -> dict[str, Any]:
    from stereo_slam_env.files.readers import parse_toml

    try:
        table: dict[str, Any] = json.loads(text)
    except (json.JSONDecodeError, RecursionError):
        pass
    else:
        return table
    try:
        table = parse_toml(f"table = {text}")["table"]
    except ValueError as error:
        usual = '{name = "hybrid", options = {gate = 0.9}}'
        raise ValueError(f"{option} must be names, or tables such as {usual}, got {text}: {error}") from None
    return table


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


def show_json(data: Mapping[str, Any]) -> None:
    """Print plain data as JSON."""
    from stereo_slam_env.files.folders import json_text

    typer.echo(json_text(data), nl=False)


def show_lines(lines: Mapping[str, str], width: int = 0, *, as_json: bool = False) -> None:
    """Names, and one line on each; or the same as one JSON object."""
    if as_json:
        show_json(lines)
        return
    width = max(width, *map(len, lines))
    for name, line in lines.items():
        typer.echo(f"{name:<{width}}  {line}")


FILTER_GROUPS: Mapping[str, tuple[str, ...]] = {
    "the paper's": ("inverse-depth", "dual-bearing", "euclidean"),
    "other choices": ("right-invariant", "unscented", "monocular", "submaps", "moving-bodies"),
    "for real drives": ("coloured-noise", "coloured-noise-causal"),
    "inertial": ("inertial", "msckf"),
    "baselines": ("dead-reckoning", "frame-to-frame", "fixed-lag", "batch", "filterpy-ekf"),
}
PRESET_GROUPS: Mapping[str, tuple[str, ...]] = {
    "streets": ("quick", "town", "turn", "straight"),
    "the paper's, pure geometry": ("reference-drive", "reference-turn"),
    "what makes the difference": ("attribution", "anchored", "baseline", "mismatch", "limits"),
    "sensors and systems": ("front-ends", "inertial", "systems", "real"),
    "where to look": ("gaze",),
}


def show_groups(lines: Mapping[str, str], groups: Mapping[str, tuple[str, ...]], *, as_json: bool = False) -> None:
    """Names in groups, and one line on each; those of no group at the end; or all as one JSON object."""
    if as_json:
        show_json(lines)
        return
    lists = {title: {name: lines[name] for name in names if name in lines} for title, names in groups.items()}
    grouped = {name for names in groups.values() for name in names}
    show_lists({**lists, "installed": {name: line for name, line in lines.items() if name not in grouped}})


def show_lists(lists: Mapping[str, Mapping[str, str]]) -> None:
    """Names and one line on each, in lists under their titles; an empty list has none."""
    width = 2 + max(len(name) for entries in lists.values() for name in entries)
    for title, entries in lists.items():
        if entries:
            typer.echo(f"{title}:")
            show_lines({f"  {name}": line for name, line in entries.items()}, width)


def new_directory(name: str) -> Path:
    """Run directory that is named after the command or scenario and the time."""
    return Path("runs") / f"{name}-{datetime.datetime.now():%Y%m%d-%H%M%S}"


def with_options(of: Callable[..., Any], name: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator of commands that share options: those of `of`, whose result they get as the parameter `name`."""

    def of_both(command: Callable[..., None]) -> Callable[..., None]:
        shared, own_parameters = (inspect.signature(function, eval_str=True).parameters for function in (of, command))
        options = [*(about for key, about in own_parameters.items() if key != name), *shared.values()]

        def run(**given: Any) -> None:
            result = of(**{key: given.pop(key) for key in shared})
            command(**given, **{name: result})

        run.__name__, run.__doc__ = command.__name__, command.__doc__
        run.__annotations__ = {about.name: about.annotation for about in options}
        parameters = [about.replace(kind=inspect.Parameter.KEYWORD_ONLY) for about in options]
        vars(run)["__signature__"] = inspect.Signature(parameters)
        return run

    return of_both
