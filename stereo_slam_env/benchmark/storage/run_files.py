"""Files of a run: its settings, `FilterRun` with its figures and bound as npz and back, and trajectories.

They tell what is a run, and what may change where it is resumed.

The file of a run is whole, or it has what a summary over runs needs: figures, and the series of one number a frame that
are pooled or averaged over runs. A campaign keeps the first runs whole and so much of the others.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.validation import first_line
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.streams import seed_description
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.figures import trial_columns
from stereo_slam_env.evaluation.landmark_statistics import SERIES as _LANDMARK_SERIES
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.evaluation.results import BodyScores, FilterRun
from stereo_slam_env.evaluation.run_figures import RunScore
from stereo_slam_env.evaluation.trajectory_metrics import SegmentErrors
from stereo_slam_env.evaluation.trial import estimate_of, truth_of
from stereo_slam_env.evaluation.trial import reference_of as reference_of_run
from stereo_slam_env.files.folders import is_occupied
from stereo_slam_env.files.opening import NotOpened
from stereo_slam_env.files.readers import read_arrays, read_json
from stereo_slam_env.files.record_files import DAMAGE, packed, unpacked
from stereo_slam_env.recording.archive import reference_of
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import save_trajectory

SETTINGS, STUDY = "settings.json", "study.json"


def refuse_foreign(out: Path) -> None:
    """Raise a `ValueError` where `out` holds something that is no run."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    if out.is_dir() and not holds_run(out) and is_occupied(out):
        raise ValueError(f"output {out} is not empty and holds no run: choose another directory")


def holds_run(out: Path) -> bool:
    """Whether a directory holds a study or settings of ours.

    Other programs have files of these names, too. A `ValueError` says that one is no JSON.
    """
    settings = _content(out / SETTINGS)
    is_ours = isinstance(settings.get("scenario"), dict) and ("kind" in settings["scenario"] or "versions" in settings)
    return is_ours or isinstance(_content(out / STUDY).get("cells"), list)


def _content(path: Path) -> dict[str, Any]:
    content = read_json(path) if path.exists() else None
    return content if isinstance(content, dict) else {}


def why_no_run(out: Path) -> str:
    """Error message where there is no run to read, with a suggestion."""
    if not out.is_dir():
        what = "is a file" if out.exists() else "does not exist"
        return f"{out} {what}: give the directory of a run"
    inside = sorted({path.parent for name in (SETTINGS, STUDY) for path in out.glob(f"*/{name}")})
    if inside:
        return f"{out} holds no run itself, but {len(inside)}: give one of them, such as {inside[-1]}"
    return f"{out} holds no run: it has no settings.json, give the directory of a run"


def refuse_other_settings(out: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raise a `ValueError` where anything but seeds, filters or limits differs from the settings of the run."""
    may_change = {"filters", "policies", "seeds", "divergence_percent", "frame_time_limit", "recording_time_limit"}
    may_change |= {"kept_seeds"}
    for key in sorted(before.keys() - may_change, key=lambda key: (key == "name", key)):
        was, is_now = before[key], now[key]
        if was == is_now:
            continue
        if isinstance(was, Mapping) and isinstance(is_now, Mapping):  # name the entry, not the lot
            entry = min(entry for entry in {**was, **is_now} if was.get(entry) != is_now.get(entry))
            key, was, is_now = f"{key}.{entry}", was.get(entry), is_now.get(entry)
        raise ValueError(
            f"output {out} holds a run with {key} = {json.dumps(was)}, now it is {json.dumps(is_now)}: "
            f"choose another output directory"
        )


Given = dict[int | None, dict[str, dict[str, Any]]]
"""Descriptions of the recordings, by seed, then label of the filter."""


def descriptions(out: Path, given: Given) -> list[dict[str, Any]]:
    """One description of each recording; a `ValueError` says that they were drawn by different renderers."""
    recordings = [{"seed": seed, **seed_description(of_seed)} for seed, of_seed in given.items()]
    # The same renderer of another version or device draws other pictures, too.
    drawn = {json.dumps(about.get("source", {}).get("renderer"), sort_keys=True) for about in recordings}
    if len(drawn) > 1:
        raise ValueError(
            f"{out}: its recordings were drawn by different renderers, {' and '.join(sorted(drawn))}, and are "
            f"not to be compared: choose another output directory"
        )
    return recordings


WRITTEN = 10
"""Recordings whose trajectories are written with the results; of more they are on demand."""


def seed_name(seed: int | None) -> str:
    """Name of files of one recording."""
    return "recording" if seed is None else f"seed-{seed:04d}"


def write_trajectories(out: Path, scenario: Scenario, runs: Iterable[FilterRun]) -> None:
    """Write the trajectories of runs of a scenario into its run directory `out`."""
    for run in runs:
        folder = out / "trajectories" / seed_name(run.seed)
        # A camera that looks elsewhere is elsewhere, by the arm of the head: each policy has its own truth.
        truth = f"{run.filter_name}-truth" if scenario.policies else "truth"
        _write(folder / run.filter_name, estimate_of(run), estimate_of(run))
        _write(folder / truth, truth_of(run), reference_of_run(run))


def _write(path: Path, poses: Trajectory | None, claimed: Trajectory | None) -> None:
    """Write poses as .tum and .kitti, and with what is claimed of them as .square; those that are not known are not."""
    for ending, trajectory in ((".tum", poses), (".kitti", poses), (".square", claimed)):
        if trajectory is not None:
            save_trajectory(path.with_name(path.name + ending), trajectory)


FORMAT = 4
_TEXT = ("filter_name", "recording_name", "options", "not_given", "seed", "failure")
_PARTS = ("counts", "traces", "memory_mb", "landmark_statistics", "truth_from", "final_map", "bodies")
_SERIES = tuple(f.name for f in dataclasses.fields(FilterRun) if f.name not in (*_TEXT, *_PARTS))
_TRACE_SERIES = ("frames", "depth", "sigma", "true_depth", "measured_depth")
_SEGMENT_SERIES = tuple(f.name for f in dataclasses.fields(SegmentErrors))
_BODY_SERIES = tuple(f.name for f in dataclasses.fields(BodyScores))
_SHAPES = {
    **dict.fromkeys(("positions", "true_positions", "linear_velocities", "angular_velocities"), (3,)),
    **dict.fromkeys(("true_linear_velocities", "true_angular_velocities"), (3,)),
    **dict.fromkeys(("orientations", "true_orientations"), (4,)),
    **dict.fromkeys(("pose_covariances", "velocity_covariances"), (6, 6)),
    "pose_errors": (6,),
}
"""Series of more than one number a frame: only a file that is whole has them."""
_NUMBERS = tuple(name for name in _SERIES if name not in _SHAPES)
MOST_FRAMES = 10_000_000
"""Of a run: more are damage."""
MOST_COUNTED = 1_000_000
"""Measurements or landmarks counted in one frame: more are damage."""
_LANDMARK_SHAPES = tuple(getattr(LandmarkStatistics(), name).shape for name in _LANDMARK_SERIES)


@dataclass(frozen=True, eq=False)
class StoredRun:
    """Content of the file of a run."""

    run: FilterRun  # where it is not whole, without counts and traces, and the series of vectors are NaN
    provenance: dict[str, Any]
    score: RunScore | None  # None where no figures were packed
    is_whole: bool


def packed_run(
    run: FilterRun, provenance: Mapping[str, Any], score: RunScore | None = None, *, whole: bool = True
) -> bytes:
    """Bytes of the npz file of a run, its JSON-able provenance and its figures; `load_run` gives all back."""
    arrays: dict[str, Any] = _whole(run) if whole else {}
    names = [] if whole else [name for name in _NUMBERS if np.isfinite(getattr(run, name)).any()]
    numbers = [
        [run.memory_mb],
        *(getattr(run.landmark_statistics, name).ravel() for name in _LANDMARK_SERIES),
        *([] if score is None else [getattr(score.segments, name) for name in _SEGMENT_SERIES]),
        *(getattr(run, name) for name in names),
    ]
    arrays["numbers"] = np.concatenate(numbers).astype(np.float64)  # one array is read far faster than many
    about = {
        "figures": None if score is None else dict(score.figures),
        "segments": None if score is None else len(score.segments),
        "series": None if whole else names,
        "frames": len(run),
        "run": {name: getattr(run, name) for name in _TEXT}
        | {"options": dict(run.options), "not_given": dict(run.not_given)},
        "traces": [[trace.landmark_id, trace.label] for trace in run.traces],
        "truth_from": dataclasses.asdict(run.truth_from),
        "provenance": dict(provenance),
    }
    return packed(FORMAT, about, arrays, compress=True)


def _whole(run: FilterRun) -> dict[str, Any]:
    arrays: dict[str, Any] = {name: getattr(run, name) for name in _SERIES}
    arrays |= {f"count.{name}": values for name, values in run.counts.items()}
    if run.bodies is not None:
        arrays |= {f"body.{name}": getattr(run.bodies, name) for name in _BODY_SERIES}
    for i, trace in enumerate(run.traces):
        arrays |= {f"trace.{i}.{name}": getattr(trace, name) for name in _TRACE_SERIES}
    return arrays


def packed_bound(bound: Bound | None, code: str) -> bytes:
    """Bytes of the npz file of a bound (None: there is none), and of the version of the code that made it."""
    stream = io.BytesIO()
    np.savez_compressed(stream, pose=np.zeros((0, 6, 6)) if bound is None else bound.pose, code=np.array(code))
    return stream.getvalue()


def load_bound(path: Path, *, inside: Path | None = None) -> tuple[Bound | None, str]:
    """Read what `packed_bound` packed; arguments and errors as of `load_run`."""
    with damage_named(path):
        arrays = read_arrays(path, ["pose", "code"], inside=inside)
        return Bound(arrays["pose"]) if len(arrays["pose"]) else None, str(arrays["code"])


def load_provenance(path: Path, *, inside: Path | None = None) -> tuple[dict[str, Any], bool]:
    """The provenance alone, without reading the series, and whether the run is whole; raises as `load_run`."""
    with damage_named(path):
        about, _ = unpacked(path, FORMAT, (), inside=inside)
        return about["provenance"], about["series"] is None


def load_run(path: Path, *, inside: Path | None = None) -> StoredRun:
    """Read a run; a `ValueError` names a file that is damaged, of another format, or outside."""
    with damage_named(path):
        about, arrays = unpacked(path, FORMAT, inside=inside)
        full, segments = about["series"] is None, about["segments"]
        numbers = _Numbers(arrays["numbers"])
        memory = float(numbers.next(())[()])
        landmarks = LandmarkStatistics(*map(numbers.next, _LANDMARK_SHAPES))
        score = None
        if segments is not None:
            errors = SegmentErrors(*(numbers.next((segments,)) for _ in _SEGMENT_SERIES))
            columns = {figure.name: figure.is_optional for figure in trial_columns()}
            if all(columns.get(name) for name in columns.keys() ^ about["figures"].keys()):  # else of another version
                score = RunScore(about["figures"], errors)
        run = FilterRun(
            **about["run"],
            **({name: arrays[name] for name in _SERIES} if full else numbers.series(about["series"], about["frames"])),
            counts={name.removeprefix("count."): _count(arrays[name]) for name in arrays if name.startswith("count.")},
            traces=tuple(
                LandmarkTrace(landmark_id, label, *(arrays[f"trace.{i}.{name}"] for name in _TRACE_SERIES))
                for i, (landmark_id, label) in enumerate(about["traces"] if full else ())
            ),
            memory_mb=memory,
            landmark_statistics=landmarks,
            truth_from=reference_of(about),
            bodies=BodyScores(*(arrays[f"body.{name}"] for name in _BODY_SERIES)) if "body.frames" in arrays else None,
        )
        return StoredRun(run, about["provenance"], score, full)


def _count(values: IntArray) -> IntArray:
    if values.dtype.kind != "i" or np.any((values < 0) | (values > MOST_COUNTED)):
        raise ValueError(f"counts must be integers from 0 to {MOST_COUNTED}")
    return values


class _Numbers:
    """Arrays that lie one behind the other in one."""

    def __init__(self, numbers: FloatArray) -> None:
        self._numbers, self._at = numbers, 0

    def next(self, shape: tuple[int, ...]) -> FloatArray:
        """The next of them."""
        first, self._at = self._at, self._at + math.prod(shape)
        return self._numbers[first : self._at].reshape(shape)

    def series(self, names: Sequence[str], frames: int) -> dict[str, FloatArray]:
        """All series of a run, of which these are there; the others are NaN."""
        if type(frames) is not int or not 0 <= frames <= MOST_FRAMES:
            raise ValueError(f"frames must be 0 to {MOST_FRAMES}, got {frames!r}")
        series = {**_nothing_known(frames), **{name: self.next((frames,)) for name in names}}
        return {**series, "nis_dof": np.nan_to_num(series["nis_dof"]).astype(np.int64)}


@lru_cache(maxsize=16)
def _nothing_known(frames: int) -> dict[str, FloatArray]:
    return {name: np.broadcast_to(np.nan, (frames, *_SHAPES.get(name, ()))) for name in _SERIES}


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Raise a `ValueError` that names the file and the remedy where what is read from it is damaged."""
    try:
        yield
    except (FileNotFoundError, NotOpened):
        raise
    except DAMAGE as error:
        raise ValueError(
            f"{path} is damaged ({first_line(error)}): delete it and run the same command again"
        ) from error
