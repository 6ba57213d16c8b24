"""The commands `stereo-slam scenes ...`: list, render and record simulated scenes, measure their noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from stereo_slam_env.cli.shared_options import JsonOption, console, group, rig_from, show_json, show_lists, with_options

app = group("The simulated scenes: list, render, record, noise.")

SeedOption = Annotated[int, typer.Option("--seed", help="Random seed.", min=0)]
FramesOption = Annotated[int | None, typer.Option("--frames", help="Stop after so many.", min=2)]


def _scene(
    route: Annotated[str, typer.Argument(help="A route, see 'scenes list', or a KITTI pose file.", metavar="ROUTE")],
    surroundings: Annotated[str, typer.Option("--surroundings", help="Surroundings of the route.")] = "street",
    renderer: Annotated[str, typer.Option("--renderer", help="'tiny', everywhere, or 'gl', fast.")] = "tiny",
    rig: Annotated[
        str,
        typer.Option(
            "--rig",
            help="'reference' 1344x391, 'vga', 'kitti', 'euroc', 'zed2', ...; a calibration file; numbers of your own: "
            "vga,baseline=0.2.",
        ),
    ] = "reference",
    moving_cars: Annotated[int, typer.Option("--moving-cars", help="Cars that drive.", min=0)] = 0,
    pedestrians: Annotated[int, typer.Option("--pedestrians", help="People that walk.", min=0)] = 0,
    randomise: Annotated[
        bool, typer.Option("--randomise", help="Textures, light, air and cameras by the seed too.")
    ] = False,
) -> dict[str, Any]:
    """Arguments of the environment; a renderer that cannot draw here is refused."""
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


@app.command("list")
def list_scenes(as_json: JsonOption = False) -> None:
    """List routes, surroundings, renderers and presets."""
    from stereo_slam_env.benchmark import presets
    from stereo_slam_env.rendering.renderers import RENDERERS
    from stereo_slam_env.world.routes import available_routes
    from stereo_slam_env.world.surroundings import available_scenes

    lists = {
        "routes (or a KITTI pose file)": available_routes(),
        "surroundings": available_scenes(),
        "renderers": RENDERERS,
        "presets of bench": dict(presets()),
    }
    if as_json:
        show_json({title.split()[0]: entries for title, entries in lists.items()})
        return
    show_lists(lists)


@app.command("render")
@with_options(_scene, "scene")
def render_scene(
    out: Annotated[Path, typer.Option("--out", help="PNG file to write.")],
    seed: SeedOption = 0,
    frame: Annotated[int, typer.Option("--frame", help="Drive so many frames first.", min=0)] = 0,
    *,
    scene: dict[str, Any],
) -> None:
    """Draw both views, with the observed landmarks."""
    import cv2
    import gymnasium as gym
    import numpy as np

    from stereo_slam_env.files.folders import require_writable, write_atomically

    if out.suffix.lower() != ".png":
        raise ValueError(f"--out must be a file name ending in .png, got {str(out)!r}")
    require_writable(out.parent)
    env: Any = gym.make("StereoSlam/Drive-v0", policy="route", render_mode="rgb_array", **scene)
    try:
        env.reset(seed=seed)
        for k in range(frame):
            _, _, terminated, truncated, _ = env.step(np.zeros(2, dtype=np.float32))
            if terminated or truncated:
                raise ValueError(f"--frame must be less than {k + 1} on route {scene['route']}, got {frame}")
        image = env.render()
    finally:
        env.close()
    out.parent.mkdir(parents=True, exist_ok=True)
    picture = bytes(cv2.imencode(".png", image[..., ::-1])[1])
    write_atomically(out, lambda stream: stream.write(picture))
    typer.echo(str(out.resolve()))


@app.command("record")
@with_options(_scene, "scene")
def record_scene(
    out: Annotated[Path, typer.Option("--out", help="Folder for the drive; with --seeds for one folder a seed.")],
    format_name: Annotated[
        str,
        typer.Option("--format", help="'kitti', 'euroc', 'tum-vi'; 'mcap', 'db3' (ROS 2), 'bag' (ROS 1)."),
    ] = "kitti",
    name: Annotated[str, typer.Option("--name", help="Name of a KITTI sequence, two digits for its tools.")] = "00",
    seed: SeedOption = 0,
    seeds: Annotated[
        int | None, typer.Option("--seeds", help="So many drives, from --seed on, for Monte Carlo.", min=1)
    ] = None,
    frames: FramesOption = None,
    imu: Annotated[
        str | None,
        typer.Option("--imu", help="Inertial unit, about 200 Hz: 'adis16448', 'bmi088', 'car'.", show_default="none"),
    ] = None,
    scale_errors: Annotated[
        bool, typer.Option("--scale-errors", help="The unit has errors of scale and alignment, too.")
    ] = False,
    imu_offset: Annotated[
        float, typer.Option("--imu-offset", help="Stamps of the unit less those of the cameras, s.")
    ] = 0.0,
    vehicle: Annotated[
        str | None,
        typer.Option("--vehicle", help="'smooth' or 'kinematic'.", show_default="smooth with --imu"),
    ] = None,
    rate: Annotated[
        float | None, typer.Option("--rate", help="Pairs a second of a flight; a drive has 10.", show_default="20")
    ] = None,
    compressed: Annotated[bool, typer.Option("--compressed", help="Images in bags as PNG.")] = False,
    *,
    scene: dict[str, Any],
) -> None:
    """Write rendered drives that other programs read.

    With images, calibration, truth and, where the format has a place for them, inertial samples and wheel odometry;
    beside them settings for Kalibr, OpenVINS, VINS-Fusion, ORB-SLAM3, Basalt and ROS. As ROUTE, 'flight' is a camera
    that is carried to and fro in six degrees of freedom. What was interrupted goes on with the same command.
    """
    from stereo_slam_env.datasets.writing import FORMATS, write_recording
    from stereo_slam_env.datasets.written_frame import STATES, STEPS
    from stereo_slam_env.envs.recorder import RenderedDrive
    from stereo_slam_env.envs.rendered_flight import RenderedFlight
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.report.console import progress_bar

    require_writable(out)
    is_flight = scene["route"] == "flight"
    if rate is not None and not is_flight:
        raise ValueError(f"--rate needs the route 'flight', got {scene['route']!r}: a drive has 10 pairs a second")
    for option, value in (("--imu-offset", imu_offset), ("--scale-errors", scale_errors)):
        if value and imu is None:
            raise ValueError(f"{option} is of an inertial unit: give --imu, too")
    arguments = {**scene, "imu": imu, "imu_calibrated": not scale_errors}
    arguments["vehicle"] = vehicle or ("smooth" if imu is not None else "kinematic")
    if is_flight:
        arguments["route"] = "straight"
    errors = "as --scale-errors was given, also of scale and alignment" if scale_errors else "none but these"
    about = {"Errors of the unit that settings cannot state": errors} if imu is not None else {}
    for number in range(seed, seed + (seeds or 1)):
        drive: Any
        if is_flight:
            drive = RenderedFlight(arguments, number, frames or 400, rate=20.0 if rate is None else rate)
        else:
            drive = RenderedDrive(arguments, number, frames)
        place = out if seeds is None else out / f"{number:03d}"
        try:
            with progress_bar(console(stderr=True), f"frames of seed {number}") as progress:
                folder = write_recording(
                    drive,
                    place,
                    format_name,
                    name=name,
                    time_offset=imu_offset,
                    compressed=compressed,
                    may_lose={STEPS, STATES} - FORMATS[format_name].keeps if format_name in FORMATS else (),
                    about={**about, "Seed": str(number)},
                    keep_same=seeds is not None,
                    on_pair=progress,
                )
        except KeyboardInterrupt:
            typer.echo("interrupted: the same command goes on from here, but for a bag, which begins anew", err=True)
            raise typer.Exit(130) from None
        typer.echo(str(folder.resolve()))


@app.command("noise")
@with_options(_scene, "scene")
def scene_noise(
    seed: SeedOption = 0,
    frames: FramesOption = None,
    front_end: Annotated[
        str | None,
        typer.Option(
            "--front-end",
            help="Front end: 'active-search', 'klt', 'sift', or an installed one.",
            show_default="active-search",
        ),
    ] = None,
    tracks: Annotated[
        Path | None,
        typer.Option(
            "--tracks",
            help="Tracks or matches of another program in the pairs that `record` writes: frame, id, u, v, d, "
            "and what it claims.",
            metavar="FILE",
            show_default="of the front end",
        ),
    ] = None,
    as_json: JsonOption = False,
    *,
    scene: dict[str, Any],
) -> None:
    """Measure the noise of a front end, ours or any other's, against the render."""
    from stereo_slam_env.benchmark.scenarios.recording_description import measurement_errors, noise_figures
    from stereo_slam_env.datasets.measured_tracks import read_measured_tracks
    from stereo_slam_env.envs.recorder import record, record_measurements
    from stereo_slam_env.report.console import progress_bar, show_noise

    if tracks is not None and front_end is not None:
        raise ValueError(f"--tracks {tracks} are measured already: leave --front-end out")
    measured = None if tracks is None else read_measured_tracks(tracks)
    with progress_bar(console(stderr=True), "frames") as progress:

        def on_frame(done: int, wanted: int | None) -> None:
            progress(done, wanted or done)

        if measured is None:
            images = {**scene, "sensor": "images", "front_end_name": front_end or "active-search"}
            recording = record(images, seed, frames, progress=on_frame)
        else:
            recording = record_measurements(scene, seed, measured, frames, progress=on_frame)
    errors = measurement_errors(recording, claims=measured is None or measured.claims)
    if as_json:
        show_json(noise_figures(recording.name, errors))
    else:
        show_noise(console(), recording.name, errors)
