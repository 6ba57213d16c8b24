"""The commands `convert`, a recording in another format, and `view`, a drive in Rerun, as a still or as a film."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereo_slam_env.cli.shared_options import ImagesOptions, console, show_lines, with_options

if TYPE_CHECKING:
    from stereo_slam_env.viewer.drive_picture import Progress
    from stereo_slam_env.viewer.watched_drive import Drive


@with_options(ImagesOptions, "images")
def convert(
    path: Annotated[
        str | None, typer.Argument(help="A folder, a bag, an archive, as for 'replay'.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Argument(
            help="NAME.mcap (ROS 2), NAME.bag (ROS 1), NAME.npz (measured tracks), else a folder.",
            show_default=False,
        ),
    ] = None,
    format_name: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="'kitti', 'euroc', 'tum-vi'; 'mcap', 'db3' (ROS 2), 'bag' (ROS 1).",
            show_default="by the ending, else kitti",
        ),
    ] = None,
    name: Annotated[str, typer.Option("--name", help="Name of a KITTI sequence.")] = "00",
    lossy: Annotated[
        bool, typer.Option("--lossy", help="Leave out what the format has no place for; otherwise it is refused.")
    ] = False,
    compressed: Annotated[bool, typer.Option("--compressed", help="Images in bags as PNG.")] = False,
    skip_broken: Annotated[
        bool, typer.Option("--skip-broken", help="Leave out pairs with missing or damaged images, and count them.")
    ] = False,
    show_list: Annotated[bool, typer.Option("--list", help="List the layouts that can be read and stop.")] = False,
    *,
    images: ImagesOptions,
) -> None:
    """Write a recording in another format, or its tracks."""
    from stereo_slam_env.datasets import available_recordings, load, open_image_sequence
    from stereo_slam_env.datasets.writing import write_recording
    from stereo_slam_env.datasets.written_frame import KINDS
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.recording.archive import save_recording
    from stereo_slam_env.report.console import progress_bar

    if show_list:
        show_lines(available_recordings())
        return
    if path is None or out is None:
        raise ValueError("convert needs a recording and where it goes: stereo-slam convert RECORDING OUT")
    require_writable(out.parent if out.suffix in (".mcap", ".bag", ".npz") else out)
    options: dict[str, Any] = {**images.given(), **({"on_broken": "skip"} if skip_broken else {})}
    if out.suffix == ".npz" and out.exists():
        raise ValueError(f"{out} is there already: choose another name, or remove it")
    with progress_bar(console(stderr=True), "pairs") as progress:
        if out.suffix == ".npz":
            save_recording(out, load(path, **options))
            written = out
        else:
            written = write_recording(
                open_image_sequence(path, **options),
                out,
                format_name,
                name=name,
                compressed=compressed,
                may_lose=KINDS if lossy else (),
                on_pair=progress,
            )
    typer.echo(str(written.resolve()))


def view(
    run: Annotated[Path, typer.Argument(help="Directory of a run, or of a cell of a grid.")],
    filter_name: Annotated[
        str | None, typer.Option("--filter", help="Filter, as the report calls it.", show_default="the first")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Seed to show.", show_default="the first")] = None,
    save: Annotated[
        Path | None, typer.Option("--save", help="Write a file for Rerun's viewer.", metavar="OUT.rrd")
    ] = None,
    still: Annotated[Path | None, typer.Option("--still", help="Write a picture.", metavar="OUT.png")] = None,
    frame: Annotated[
        int | None, typer.Option("--frame", help="Frame of the still, from 0.", show_default="the last", min=0)
    ] = None,
    film: Annotated[Path | None, typer.Option("--film", help="Write a film.", metavar="OUT.mp4")] = None,
    connect: Annotated[
        str | None, typer.Option("--connect", help="Show it in a Rerun viewer that runs there.", metavar="ADDRESS")
    ] = None,
) -> None:
    """Watch a filter drive through a finished run.

    Without an option it opens Rerun's viewer (extra viewer) and shows the drive while the filter computes it. Pictures
    and films need the extra pictures.
    """
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.report.console import progress_bar
    from stereo_slam_env.viewer.watched_drive import revisit

    if frame is not None and still is None:
        raise ValueError("--frame needs --still OUT.png: it says what the picture shows")
    if still is not None or film is not None:  # before the drive: known at once where Matplotlib is missing
        from stereo_slam_env.viewer.drive_picture import save_film, save_still
    for path in (save, still, film):
        if path is not None:
            require_writable(path.parent)
    drive = revisit(run, filter_name, seed)
    typer.echo(f"{drive.title}, {drive.frames} frames")
    try:
        with progress_bar(console(stderr=True), "frames") as progress:
            if still is not None:
                save_still(drive, still, frame, progress)
            if film is not None:
                save_film(drive, film, progress)
            if save is not None or connect is not None or (still is None and film is None):
                _show_in_rerun(drive, save, connect, progress)
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        raise typer.Exit(130) from None
    for what, path in (("picture", still), ("film", film), ("for Rerun", save)):
        if path is not None:
            typer.echo(f"{what}: {path.resolve()}")


def _show_in_rerun(drive: Drive, save: Path | None, connect: str | None, progress: Progress) -> None:
    from stereo_slam_env.viewer.rerun_view import RerunView

    shown = RerunView(
        drive.camera, [drive.label], save=save, connect=connect, landmarks=drive.landmarks, title=drive.title
    )
    with shown:
        for number, moment in enumerate(drive.moments()):
            shown.show(drive.label, moment)
            progress(number + 1, drive.frames)
