"""Pictures of finished runs: the report, Rerun's viewer, the paper's figures, learning curves.

`small` asks for a short run, to see that the picture can be drawn.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import stereo_slam_env as sse
from filters import StereoNoise
from stereo_slam_env.benchmark import preset_study, run_benchmark
from stereo_slam_env.benchmark.scenarios.streams import without_measurements
from stereo_slam_env.cli.app import main as stereo_slam
from stereo_slam_env.frontend import ActiveSearch
from stereo_slam_env.paper import NOISES, convergence, plots
from stereo_slam_env.viewer import Drive, RerunView

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
REPORT_SIZE, RERUN_SIZE = (1280, 1180), (1120, 860)
MOVING_WIDTH, LEFT_VIEW = 880, 428
"""Width of the moving picture, and rows of the film of the search that its left view takes, px."""
BODY_COLOURS = ((60, 60, 240), (230, 120, 30), (40, 200, 240), (200, 60, 200), (80, 190, 60))
HEADINGS, MILLISECONDS = "headings", "milliseconds"
"""Texts in the PNG of the report: headings of its first table, and time a frame by filter, as JSON."""


class NoBrowser(RuntimeError):
    """There is none on this machine."""


def drive(path: Path, work: Path, *, small: bool) -> None:
    """A moving picture: search ellipses in the left view, above the map, the path and NEES of the filter."""
    run, search, film = work / "run", work / "search.mp4", work / "film.mp4"
    drive_of = ["--preset", "turn", "--seeds", "1", "--frames", "10" if small else "80", "--filters", "inverse-depth"]
    made = stereo_slam(["bench", *drive_of, "--sensor", "images", "--record", str(search), "--out", str(run)])
    if made or stereo_slam(["view", str(run), "--film", str(film)]):
        raise RuntimeError("the drive cannot be filmed")
    pictures = [
        Image.fromarray(np.concatenate([_wide(views[:LEFT_VIEW]), _wide(panels)])[..., ::-1])
        for views, panels in zip(_pictures(search), _pictures(film), strict=True)
    ]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=100, loop=0, quality=55, method=6)


def bodies(path: Path, work: Path, *, small: bool) -> None:
    """A moving picture: landmarks on the cars in the state of a filter, and how fast it believes these to be."""
    traffic = {"route": "town", "renderer": "gl", "moving_cars": 14, "pedestrians": 4}
    frames, views = 12 if small else 70, list[NDArray[np.uint8]]()
    drive, pairs = sse.RenderedDrive(traffic, seed=1, frames=frames), []
    settings = replace(drive.front_end, method="klt")
    looks = ActiveSearch(drive, settings, watch=lambda pair, tracked: pairs.append((pair.left, tracked.observation)))
    recorded = sse.record("StereoSlam/Drive-v0", seed=1, policy="route", frames=frames, **traffic)
    noise = {"noise": StereoNoise.independent_pixels(0.3), "observe": looks.observe}
    for moment in sse.run("moving-bodies", without_measurements(recorded), **noise):
        left, observation = pairs[-1]
        view, belief = cv2.cvtColor(left, cv2.COLOR_GRAY2BGR), moment.slam.bodies
        for number, velocity, ids in zip(belief.ids.tolist(), belief.linear, belief.landmarks, strict=True):
            colour = BODY_COLOURS[number % len(BODY_COLOURS)]
            points = observation.uvd[np.isin(observation.ids, ids), :2]
            for point in points:
                cv2.circle(view, (round(point[0]), round(point[1])), 6, colour, 2, cv2.LINE_AA)
            if len(points):
                corner = int(points[:, 0].min()), int(points[:, 1].min()) - 14
                speed = f"body-{number}: {np.linalg.norm(velocity):.1f} m/s"
                cv2.putText(view, speed, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.8, colour, 2, cv2.LINE_AA)
        views.append(_wide(np.asarray(view, dtype=np.uint8)))
    pictures = [Image.fromarray(view[..., ::-1]) for view in views]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=100, loop=0, quality=60, method=6)


def _pictures(film: Path) -> Iterator[NDArray[np.uint8]]:
    video = cv2.VideoCapture(str(film))
    while (read := video.read())[0]:
        yield np.asarray(read[1], dtype=np.uint8)
    video.release()


def _wide(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    size = MOVING_WIDTH, round(MOVING_WIDTH * picture.shape[0] / picture.shape[1])
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def report(path: Path, work: Path, *, small: bool) -> None:
    """The upper end of the page of `stereo-slam bench`; the file says in words what a test compares."""
    study = preset_study("quick")
    if small:
        study = study.with_scenarios(lambda one: one.replaced(seeds=(0, 1), frames=20))
    result = run_benchmark(study, work / "quick", jobs=1, write_report=sse.write_report_of)
    assert result.report is not None
    with page_in_browser(result.report.as_uri(), REPORT_SIZE) as page:
        page.wait_for_timeout(3_000)  # ms: charts are drawn when they come into view
        page.screenshot(path=path)
        headings = page.eval_on_selector("table", "table => [...table.querySelectorAll('th')].map(th => th.innerText)")
    (cell,) = result.cells
    about = PngInfo()
    about.add_text(HEADINGS, json.dumps(headings))
    about.add_text(MILLISECONDS, json.dumps({one.filter_name: one.ms_per_frame for one in cell.summaries}))
    with Image.open(path) as picture:
        picture.load()
    picture.save(path, pnginfo=about)


def rerun(path: Path, work: Path, *, small: bool) -> None:
    """A drive in Rerun's viewer, in a browser."""
    drive = Drive.of(sse.make_recording("turn", 0), "inverse-depth")
    file = work / "drive.rrd"
    with RerunView(drive.camera, [drive.label], save=file, landmarks=drive.landmarks) as view:
        for moment, _ in zip(drive.moments(), range(5 if small else 20), strict=False):
            view.show(drive.label, moment)
    viewer, ports = Path(sys.executable).with_name("rerun"), [_free_port(), _free_port()]
    serve = ["--serve-web", "--bind", "127.0.0.1", "--port", str(ports[0]), "--web-viewer-port", str(ports[1])]
    # `rerun` is a script that starts the viewer: both end with their session.
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    server = subprocess.Popen([viewer, *serve, file], start_new_session=True, **quiet)
    try:
        _wait_for(ports[1])
        _wait_for(ports[0])
        source = f"rerun%2Bhttp://127.0.0.1:{ports[0]}/proxy"
        with page_in_browser(f"http://127.0.0.1:{ports[1]}/?url={source}&hide_welcome_screen=1", RERUN_SIZE) as page:
            page.wait_for_timeout(25_000)  # ms: its drawing in software is slow, and nothing says when it is done
            page.screenshot(path=path, type="jpeg", quality=88)
    finally:
        os.killpg(server.pid, signal.SIGTERM)
        server.wait(timeout=20)


def paper_depth(path: Path, work: Path, *, small: bool) -> None:
    """Figure 4 of the paper."""
    drives = 4 if small else 200
    turns = convergence.experiments(dict.fromkeys(NOISES, drives), {})
    plots.figure_4({name: make() for name, make in turns.items()}).save(path)


def paper_cloud(path: Path, work: Path, *, small: bool) -> None:
    """Figure 1 of the paper."""
    plots.figure_1(500 if small else 10_000).save(path)


@contextmanager
def page_in_browser(address: str, size: tuple[int, int]) -> Iterator[Any]:
    """The page of playwright at that address; `NoBrowser` where there is none."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise NoBrowser("playwright is not installed (extra dev)") from error
    if browser is None:
        raise NoBrowser(f"none of {', '.join(BROWSERS)} is installed (apt install chromium)")
    with sync_playwright() as driver:
        switches = ["--no-sandbox", "--enable-unsafe-swiftshader"]  # as root; WebGL without a graphics card
        chromium = driver.chromium.launch(executable_path=browser, args=switches)
        try:
            page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
            page.set_default_timeout(120_000)  # ms
            page.goto(address)
            yield page
        finally:
            chromium.close()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait_for(port: int, seconds: float = 30.0) -> None:
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.2)
    raise TimeoutError(f"nothing listens on port {port} after {seconds:g} s")
