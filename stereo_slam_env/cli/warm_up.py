"""`stereo-slam warm-up`: all machine code, made before it is needed, by two processes."""

from __future__ import annotations

import subprocess
import sys
import time

import typer

_FILTERS = """
import stereo_slam_env as sse
recording = sse.make_recording("reference-turn", 0)
for name in ("inverse-depth", "dual-bearing", "euclidean", "right-invariant", "coloured-noise"):
    sse.evaluate(name, recording)
"""
_WORLDS = """
import gymnasium as gym
import stereo_slam_env
for name in [name for name in gym.registry if name.startswith("StereoSlam/")]:
    with gym.make(name) as env:
        env.reset(seed=0)
        env.step(env.action_space.sample())
"""


def warm_up() -> None:
    """Compile filters and worlds, once: for images and classrooms."""
    began = time.monotonic()
    typer.echo("compiling filters and worlds: about a minute on two cores", err=True)
    quiet = "import logging; logging.getLogger('filters').setLevel(logging.ERROR)"
    workers = [subprocess.Popen([sys.executable, "-c", quiet + program]) for program in (_FILTERS, _WORLDS)]
    try:
        failed = [worker.wait() for worker in workers]
    finally:
        for worker in workers:
            worker.kill()
    if any(failed):
        raise typer.Exit(1)
    typer.echo(f"everything is compiled: {time.monotonic() - began:.0f} s", err=True)
