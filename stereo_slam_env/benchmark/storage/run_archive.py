"""Files of a run: `FilterRun` and bound as npz and back."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.foreign_text import first_line
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.landmark_statistics import SERIES as _LANDMARK_SERIES
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.files.opening import NotOpened
from stereo_slam_env.files.readers import read_arrays
from stereo_slam_env.recording.archive import reference_of

FORMAT = 3
_TEXT = ("filter_name", "recording_name", "options", "not_given", "seed", "failure")
_PARTS = ("counts", "traces", "memory_mb", "landmark_statistics", "truth_from")
_SERIES = tuple(f.name for f in dataclasses.fields(FilterRun) if f.name not in (*_TEXT, *_PARTS))
_DAMAGE = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)
_TRACE_SERIES = ("frames", "depth", "sigma", "true_depth", "measured_depth")


def packed_run(run: FilterRun, provenance: Mapping[str, Any]) -> bytes:
    """Bytes of the npz file of a run and of its JSON-able provenance; `load_run` gives both back."""
    arrays: dict[str, Any] = {name: getattr(run, name) for name in _SERIES}
    arrays |= {f"count.{name}": values for name, values in run.counts.items()}
    for i, trace in enumerate(run.traces):
        arrays |= {f"trace.{i}.{name}": getattr(trace, name) for name in _TRACE_SERIES}
    arrays |= {f"landmarks.{name}": getattr(run.landmark_statistics, name) for name in _LANDMARK_SERIES}
    arrays["memory_mb"] = np.array(run.memory_mb)
    about = {
        "format": FORMAT,
        "run": {name: getattr(run, name) for name in _TEXT}
        | {"options": dict(run.options), "not_given": dict(run.not_given)},
        "traces": [[trace.landmark_id, trace.label] for trace in run.traces],
        "truth_from": dataclasses.asdict(run.truth_from),
        "provenance": dict(provenance),
    }
    arrays["about"] = np.array(json.dumps(about, allow_nan=False))
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


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


def load_provenance(path: Path, *, inside: Path | None = None) -> dict[str, Any]:
    """The provenance alone, without reading the series; raises as `load_run`."""
    with damage_named(path):
        provenance: dict[str, Any] = _checked(read_arrays(path, ["about"], inside=inside))["provenance"]
        return provenance


def load_run(path: Path, *, inside: Path | None = None) -> tuple[FilterRun, dict[str, Any]]:
    """Read a run and its provenance; a `ValueError` names a file that is damaged, of another format, or outside."""
    with damage_named(path):
        arrays: dict[str, Any] = read_arrays(path, inside=inside)
        about = _checked(arrays)
        run = FilterRun(
            **about["run"],
            **{name: arrays[name] for name in _SERIES},
            counts={name.removeprefix("count."): arrays[name] for name in arrays if name.startswith("count.")},
            traces=tuple(
                LandmarkTrace(landmark_id, label, *(arrays[f"trace.{i}.{name}"] for name in _TRACE_SERIES))
                for i, (landmark_id, label) in enumerate(about["traces"])
            ),
            memory_mb=float(arrays["memory_mb"]),
            landmark_statistics=LandmarkStatistics(*(arrays[f"landmarks.{name}"] for name in _LANDMARK_SERIES)),
            truth_from=reference_of(about),
        )
        return run, about["provenance"]


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Raise a `ValueError` that names the file and the remedy where what is read from it is damaged."""
    try:
        yield
    except (FileNotFoundError, NotOpened):
        raise
    except _DAMAGE as error:
        raise ValueError(
            f"{path} is damaged ({first_line(error)}): delete it and run the same command again"
        ) from error


def _checked(arrays: Mapping[str, Any]) -> dict[str, Any]:
    about: dict[str, Any] = json.loads(str(arrays["about"]))
    if about["format"] != FORMAT:
        raise ValueError(f"format {about['format']}, this version reads {FORMAT}")
    return about
