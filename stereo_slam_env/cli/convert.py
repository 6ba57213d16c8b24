"""The command `stereo-slam convert`: a recording in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from stereo_slam_env.cli.parts import ImagesOptions, console, show_lines, with_options


@with_options(ImagesOptions, "images")
def convert(
    path: Annotated[
        str | None, typer.Argument(help="What 'replay' takes: a folder, a bag, an archive.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Argument(
            help="NAME.mcap: images for Foxglove and ROS 2; NAME.npz: measured tracks; else a folder for "
            "sequences/NAME and poses/NAME.txt, as KITTI has them.",
            show_default=False,
        ),
    ] = None,
    name: Annotated[str, typer.Option("--name", help="Of the KITTI sequence.")] = "00",
    skip_broken: Annotated[
        bool, typer.Option("--skip-broken", help="Leave out pairs with missing or damaged images, and count them.")
    ] = False,
    show_list: Annotated[bool, typer.Option("--list", help="List the layouts that can be read and stop.")] = False,
    *,
    images: ImagesOptions,
) -> None:
    """Write a recording as MCAP, as a KITTI sequence, or as one file of measured tracks."""
    from stereo_slam_env.datasets import available_recordings, load, open_image_sequence, write_kitti_sequence
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.recording.archive import save_recording
    from stereo_slam_env.report.console import progress_bar

    if show_list:
        show_lines(available_recordings())
        return
    if path is None or out is None:
        raise ValueError("convert needs a recording and where it goes: stereo-slam convert RECORDING OUT")
    require_writable(out.parent if out.suffix in (".mcap", ".npz") else out)
    options: dict[str, Any] = {**images.given(), **({"on_broken": "skip"} if skip_broken else {})}
    with progress_bar(console(stderr=True), "pairs") as progress:
        if out.suffix == ".npz":
            save_recording(out, load(path, **options))
            written = out
        elif out.suffix == ".mcap":
            from stereo_slam_env.datasets.bag_writer import write_mcap

            written = write_mcap(open_image_sequence(path, **options), out, on_pair=progress)
        else:
            written = write_kitti_sequence(open_image_sequence(path, **options), out, name, on_pair=progress)
    typer.echo(str(written.resolve()))
