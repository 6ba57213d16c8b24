"""Figures that must not change while the code is rearranged, against those kept in `same.json`: `make same`.

    python benchmarks/same.py                               # every part: three minutes
    python benchmarks/same.py filters                       # one part
    python benchmarks/same.py presets --write               # keep today's figures of a part: an intended change
    STEREO_SLAM_DATA=FOLDER python benchmarks/same.py       # where other people's trajectories lie

Observations, rewards and infos of every environment, beliefs of every filter, figures of benchmarks, scores of
trajectories, checks of parts, and numbers of pages are compared to the bit. What differs is named, with its size; the
exit code is 1. The bits are those of one kind of processor: where the first run on another machine differs by rounding,
write them anew before a change, not after it.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from html import unescape
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import stereo_slam_env as sse
from filters import available_filters, available_parts, check_part, make_part
from harness import arguments
from stereo_slam_env.benchmark import preset_study, run_benchmark
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_drive, inertial_flight
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.envs import BeliefObservation, GazeTask, InformationGain
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.trajectory_score import TrajectoryScore
from stereo_slam_env.paper import PaperSettings, run_paper
from stereo_slam_env.report.trajectory_report import write_trajectory_report

KEPT = Path(__file__).with_name("same.json")
STEPS, ROWS = 100, 8
SLOW, FEW_STEPS = ("Branches", "Revisit"), {1: 25, ROWS: 5}
"""Tasks whose steps run for many frames, and how many steps one row and eight rows of them take."""
Figure = tuple[str, Any]
"""Name and value: a number, a text, or the digest of arrays with the sum of their finite numbers."""
NOT_COMPARED = re.compile(r"(^|[_.])(ms|milliseconds|seconds|memory|versions?|cpu|time_per|rate_hz|started|ended)")
"""Names of figures that are of the machine."""
PRESETS: Mapping[str, dict[str, Any]] = {
    "quick": {"seeds": (0, 1)},
    "turn": {"seeds": (0, 1)},
    "reference-turn": {"seeds": (0, 1, 2)},
    "baseline": {"seeds": (0,), "frames": 60},
    "anchored": {"seeds": (0,), "frames": 60},
    "limits": {"seeds": (0,), "frames": 40},
}
HEADLINES = ("position_rmse_m", "pose_anees", "nis")
"""Figures that are kept beside the digest of all, so that the size of a change is seen."""
PAIRS: Mapping[str, tuple[str, str]] = {
    "cnspy_mc": ("ID1-pose-est-posorient-cov-run6.csv", "ID1-pose-gt.csv"),
    "euroc_v102": ("V102.txt", "V102_groundtruth.csv"),
    "kitti_13_columns": ("09_estimate.txt", "09_truth.txt"),
    "openvins_mh04": ("mh04_openvins.txt", "MH_04_difficult.txt"),
    "rpg_stereo_vio": ("vio_stereo_MH_03.txt", "MH_03_medium.txt"),
    "smfeval_fast_lio2": ("est.smfeval", "ref.tum"),
    "tum_fr1_xyz": ("freiburg1_xyz-rgbdslam.txt", "freiburg1_xyz-groundtruth.txt"),
    "tum_fr2_desk": ("fr2_desk_ORB.txt", "fr2_desk_groundtruth.txt"),
}


def digest(*values: Any) -> list[Any]:
    """Digest of arrays, texts and numbers, and the sum of what is finite in them."""
    sha, total = hashlib.sha256(), 0.0
    for value in values:
        array = np.asarray(value)
        sha.update(f"{array.dtype}{array.shape}".encode())
        sha.update(np.ascontiguousarray(array).tobytes() if array.dtype != object else repr(value).encode())
        if array.dtype.kind in "fiub":
            numbers = array.astype(np.float64)
            total += float(numbers[np.isfinite(numbers)].sum())
    return [sha.hexdigest()[:16], total]


def environments(data: Path) -> Iterator[Figure]:
    """Observations, rewards and infos of random actions: every id, one row and eight, and with a belief."""
    for name in sorted(found for found in gym.registry if found.startswith("StereoSlam/")):
        slow = any(task in name for task in SLOW)
        for rows in (1, ROWS):
            env = gym.make(name) if rows == 1 else gym.make_vec(name, num_envs=rows)
            yield f"{name} x {rows}", _episode(env, FEW_STEPS[rows] if slow else STEPS)
    with_belief = BeliefObservation(gym.make("StereoSlam/Gaze-v0"), options=GazeTask().filter_options)
    yield "StereoSlam/Gaze-v0 with belief and gain", _episode(InformationGain(with_belief))


def _episode(env: Any, steps: int = STEPS) -> list[Any]:
    several = isinstance(env, gym.vector.VectorEnv)
    env.action_space.seed(7)
    seen: list[Any] = list(_leaves(env.reset(seed=7)))
    try:
        for _ in range(steps):
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
            seen += _leaves((observation, reward, terminated, truncated, info))
            if not several and (terminated or truncated):
                seen += _leaves(env.reset())
    finally:
        env.close()
    return digest(*seen)


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, Mapping):
        for key in sorted(value):
            yield str(key)
            yield from _leaves(value[key])
    elif isinstance(value, tuple):
        for one in value:
            yield from _leaves(one)
    else:
        yield value


def filters(data: Path) -> Iterator[Figure]:
    """Poses and covariances of every named filter on four recordings, two of them inertial."""
    recordings = {
        "points": long_drive(0, frames=40),
        "street": sse.record(seed=0, route="right-turn", frames=40),
        "inertial drive": inertial_drive(0, frames=40),
        "inertial flight": inertial_flight(0, frames=40),
    }
    for where, recording in recordings.items():
        for name in (*available_filters(), "shared-anchor", "hybrid"):
            run = run_filter(recording, name, score_map=False, seed=0)
            beliefs = run.positions, run.orientations, run.pose_covariances, run.velocity_covariances, run.nis
            yield f"{name} on {where}", digest(*beliefs, str(run.failure))


def presets(data: Path) -> Iterator[Figure]:
    """Figures of six presets with few seeds, as in `summary.json`."""
    for name, changes in PRESETS.items():
        study = preset_study(name)
        cells = tuple(cell.replaced(scenario=cell.scenario.replaced(**changes)) for cell in study.cells)
        with tempfile.TemporaryDirectory() as folder:
            run_benchmark(study.replaced(cells=cells), Path(folder) / "run", jobs=2)
            for path in sorted(Path(folder).rglob("summary.json")):
                summary = json.loads(path.read_text(encoding="utf-8"))
                for label, filter_figures in summary.get("filters", {}).items():
                    where = f"{name} {path.parent.name} {label}"
                    yield where, digest(*(part for figure in _numbers("", filter_figures) for part in figure))
                    yield from ((f"{where} {key}", filter_figures[key]) for key in HEADLINES)


def _numbers(name: str, value: Any) -> Iterator[Figure]:
    if NOT_COMPARED.search(name):
        return
    if isinstance(value, Mapping):
        for key in sorted(value):
            yield from _numbers(f"{name}.{key}", value[key])
    elif isinstance(value, list | tuple):
        for number, one in enumerate(value):
            yield from _numbers(f"{name}.{number}", one)
    elif isinstance(value, int | float):
        yield name, float(value)


def trajectories(data: Path) -> Iterator[Figure]:
    """Scores of trajectories that other people estimated, where they are at hand, and of a made-up one."""
    yield from _numbers("made up", asdict(_made_up_score()))
    for name, files in PAIRS.items():
        both = [data / "field" / "trajectories" / name / file for file in files]
        if all(path.exists() for path in both):
            yield from _numbers(name, asdict(sse.evaluate_trajectory(*both)))


def _made_up_score() -> TrajectoryScore:
    run = run_filter(long_drive(0, frames=60), "inverse-depth", score_map=False, seed=0)
    estimate = sse.Trajectory(run.positions, run.orientations, run.timestamps, run.pose_covariances)
    return sse.evaluate_trajectory(estimate, sse.Trajectory(run.true_positions, run.true_orientations, run.timestamps))


def parts(data: Path) -> Iterator[Figure]:
    """Results of the checks of every named part."""
    for slot in ("landmark", "measurement", "motion", "error"):
        for name in available_parts(slot):
            report = check_part(make_part(slot, name), raise_on_failure=False)
            yield f"{slot} {name}", digest(*report.passed, *report.failed)


def pages(data: Path) -> Iterator[Figure]:
    """Numbers that two pages show: the score of a trajectory, and the paper's section 4.1."""
    with tempfile.TemporaryDirectory() as folder:
        score = write_trajectory_report(Path(folder) / "score", [_made_up_score()])
        paper = run_paper(Path(folder) / "paper", PaperSettings(samples=500), figure="2").report
        for name, path in (("score", score), ("paper", paper)):
            page = re.sub(r"(?s)<(script|style|svg)\b.*?</\1>|<[^>]*>", " ", Path(path).read_text(encoding="utf-8"))
            yield f"page {name}", digest(*re.findall(r"[-−]?\d[\d.,]*", unescape(page)))


PARTS: Mapping[str, Callable[[Path], Iterator[Figure]]] = {
    part.__name__: part for part in (environments, filters, presets, trajectories, parts, pages)
}


def difference(kept: Any, now: Any) -> str:
    """What changed, with its size where both have one; empty where nothing did."""
    if kept == now or (isinstance(kept, float) and isinstance(now, float) and math.isnan(kept) and math.isnan(now)):
        return ""
    pair = [value[1] if isinstance(value, list) else value for value in (kept, now)]
    if all(isinstance(value, float) for value in pair):
        change = abs(pair[1] - pair[0]) / max(abs(pair[0]), 1e-300)
        of = "sum " if isinstance(kept, list) else ""
        return f"{of}{pair[0]!r} -> {pair[1]!r} ({change:.1e} of it)" if change else f"other bits, {of}{pair[0]!r}"
    return f"{kept!r} -> {now!r}"


def main() -> int:
    """Compute the figures, compare or keep them; 1 where one differs."""
    given = arguments(__doc__, "parts?", parts=list(PARTS), write=False)
    data = Path(os.environ.get("STEREO_SLAM_DATA", KEPT.parents[2] / "shared" / "data"))
    stored: dict[str, dict[str, Any]] = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    changed = compared = 0
    for name in [given.parts] if isinstance(given.parts, str) else given.parts:
        now = json.loads(json.dumps(dict(PARTS[name](data))))
        kept = stored.get(name, {})
        if given.write:
            stored[name] = {**kept, **now} if name == "trajectories" else now
            continue
        for figure in sorted(kept.keys() | now.keys()):
            compared += 1
            if figure not in now:
                missing = name == "trajectories"  # other people's files are not at hand
                changed += not missing
                print(f"{name}: {figure}: {'not at hand' if missing else 'is gone'}")
            elif figure not in kept:
                changed += 1
                print(f"{name}: {figure}: is new")
            elif said := difference(kept[figure], now[figure]):
                changed += 1
                print(f"{name}: {figure}: {said}")
        print(f"{name}: {len(now)} figures")
    if given.write:
        KEPT.write_text(json.dumps(stored, indent=0, sort_keys=True) + "\n", encoding="utf-8")
        return 0
    print(f"{changed} of {compared} figures differ" if changed else f"{compared} figures, all the same")
    return int(changed > 0)


if __name__ == "__main__":
    sys.exit(main())
