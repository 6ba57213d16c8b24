"""The commands `stereo-slam scenes ...`: list, render and record simulated scenes, measure their noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from stereo_slam_env.cli.parts import console, help_without_command, one_line_errors, rig_from

app = typer.Typer(help="The simulated scenes: list, render, record, noise.")

RouteArgument = Annotated[
    str, typer.Argument(help="A route, see 'scenes list', or a KITTI pose file.", metavar="ROUTE")
]
SeedOption = Annotated[int, typer.Option("--seed", help="Of scene and drive.", min=0)]
FramesOption = Annotated[int | None, typer.Option("--frames", help="Stop after so many.", min=2)]
SurroundingsOption = Annotated[str, typer.Option("--surroundings", help="What stands along the route.")]
RendererOption = Annotated[str, typer.Option("--renderer", help="'tiny', everywhere, or 'gl', fast.")]
RigOption = Annotated[
    str, typer.Option("--rig", help="'reference' 1344x391, 'vga' or 'qvga'; numbers of your own: vga,baseline=0.2.")
]
CarsOption = Annotated[int, typer.Option("--moving-cars", help="Cars that drive.", min=0)]
PedestriansOption = Annotated[int, typer.Option("--pedestrians", help="People that walk.", min=0)]
RandomiseOption = Annotated[bool, typer.Option("--randomise", help="Textures, light, air and cameras by the seed too.")]


@app.callback(invoke_without_command=True)
def _start(context: typer.Context) -> None:
    help_without_command(context)


@app.command("list")
def list_scenes() -> None:
    """Routes, surroundings and renderers, and the ready-made scenarios of `bench`."""
    from stereo_slam_env.benchmark import presets
    from stereo_slam_env.rendering.backends import RENDERERS
    from stereo_slam_env.world.routes import available_routes
    from stereo_slam_env.world.surroundings import available_scenes

    lists = {
        "routes (or a KITTI pose file)": available_routes(),
        "surroundings": available_scenes(),
        "renderers": RENDERERS,
        "presets of bench": dict(presets()),
    }
    for title, entries in lists.items():
        typer.echo(f"{title}:")
        for name, text in entries.items():
            typer.echo(f"  {name:<16} {text}")


@app.command("render")
def render_scene(
    route: RouteArgument,
    out: Annotated[Path, typer.Option("--out", help="PNG file to write.")],
    seed: SeedOption = 0,
    frame: Annotated[int, typer.Option("--frame", help="Drive so many frames first.", min=0)] = 0,
    surroundings: SurroundingsOption = "street",
    renderer: RendererOption = "tiny",
    rig: RigOption = "reference",
    moving_cars: CarsOption = 0,
    pedestrians: PedestriansOption = 0,
    randomise: RandomiseOption = False,
) -> None:
    """Draw both views, with the observed landmarks."""
    with one_line_errors():
        import cv2
        import gymnasium as gym
        import numpy as np

        if out.suffix.lower() != ".png":
            raise ValueError(f"--out must be a file name ending in .png, got {str(out)!r}")
        arguments = _arguments(route, surroundings, renderer, rig, moving_cars, pedestrians, randomise)
        env: Any = gym.make("StereoSlam/Drive-v0", policy="route", render_mode="rgb_array", **arguments)
        try:
            env.reset(seed=seed)
            for k in range(frame):
                _, _, terminated, truncated, _ = env.step(np.zeros(2, dtype=np.float32))
                if terminated or truncated:
                    raise ValueError(f"--frame must be less than {k + 1} on route {route}, got {frame}")
            image = env.render()
        finally:
            env.close()
        out.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(out), image[..., ::-1]):
            raise OSError(f"{out} cannot be written")
        typer.echo(str(out.resolve()))


@app.command("record")
def record_scene(
    route: RouteArgument,
    out: Annotated[Path, typer.Option("--out", help="Folder for sequences/NAME and poses/NAME.txt.")],
    name: Annotated[str, typer.Option("--name", help="Of the sequence, two digits for KITTI tools.")] = "00",
    seed: SeedOption = 0,
    frames: FramesOption = None,
    surroundings: SurroundingsOption = "street",
    renderer: RendererOption = "tiny",
    rig: RigOption = "reference",
    moving_cars: CarsOption = 0,
    pedestrians: PedestriansOption = 0,
    randomise: RandomiseOption = False,
) -> None:
    """Write a rendered drive as a KITTI odometry sequence, for other people's SLAM systems (and `replay`)."""
    with one_line_errors():
        from stereo_slam_env.datasets import write_kitti_sequence
        from stereo_slam_env.envs.recorder import RenderedDrive
        from stereo_slam_env.report.console import progress_bar

        arguments = _arguments(route, surroundings, renderer, rig, moving_cars, pedestrians, randomise)
        drive = RenderedDrive(arguments, seed, frames)
        with progress_bar(console(stderr=True), "frames") as progress:
            folder = write_kitti_sequence(drive, out, name, on_pair=progress)
        typer.echo(str(folder.resolve()))


@app.command("noise")
def scene_noise(
    route: RouteArgument,
    seed: SeedOption = 0,
    frames: FramesOption = None,
    surroundings: SurroundingsOption = "street",
    renderer: RendererOption = "tiny",
    rig: RigOption = "reference",
    moving_cars: CarsOption = 0,
    pedestrians: PedestriansOption = 0,
    randomise: RandomiseOption = False,
) -> None:
    """Measure the noise of the front end: bias, spread and outliers of u, v and d by range, against the render."""
    with one_line_errors():
        from stereo_slam_env.benchmark.scenarios.streams import noise_by_range
        from stereo_slam_env.envs.recorder import record
        from stereo_slam_env.report.console import progress_bar, show_noise

        arguments = _arguments(route, surroundings, renderer, rig, moving_cars, pedestrians, randomise)
        with progress_bar(console(stderr=True), "frames") as progress:

            def on_frame(done: int, wanted: int | None) -> None:
                progress(done, wanted or done)

            recording = record({**arguments, "sensor": "images"}, seed, frames, progress=on_frame)
        show_noise(console(), recording.name, noise_by_range(recording))


def _arguments(
    route: str, surroundings: str, renderer: str, rig: str, moving_cars: int, pedestrians: int, randomise: bool
) -> dict[str, Any]:
    """Keyword arguments of the environment; a renderer that cannot draw here is refused."""
    from stereo_slam_env.benchmark.recordings.sources import require_renderer

    require_renderer(renderer)
    return {
        "route": route,
        "surroundings": surroundings,
        "renderer": renderer,
        "rig": rig_from(rig),
        "moving_cars": moving_cars,
        "pedestrians": pedestrians,
        "randomise": randomise,
    }
