"""Files of a run: a `FilterRun` as npz and back, its trajectory in the formats of TUM and KITTI."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from filters import rotations
from filters.validation import FloatArray
from stereo_slam_env.evaluation.landmark_statistics import SERIES as _LANDMARK_SERIES
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.files.atomic import write_atomically
from stereo_slam_env.files.readers import read_arrays
from stereo_slam_env.recording.archive import reference_of

FORMAT = 2
_TEXT = ("filter_name", "recording_name", "options", "not_given", "seed", "failure")
_PARTS = ("counts", "traces", "memory_mb", "landmark_statistics", "truth_from")
_SERIES = tuple(f.name for f in dataclasses.fields(FilterRun) if f.name not in (*_TEXT, *_PARTS))
_DAMAGE = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)
_TRACE_SERIES = ("frames", "depth", "sigma", "true_depth", "measured_depth")


def save_run(path: Path, run: FilterRun, provenance: Mapping[str, Any]) -> None:
    """Write `run` and where it came from; the file appears complete or not at all.

    Parameters
    ----------
    path : Path
        The npz file; its folder is made.
    run : FilterRun
        What to keep.
    provenance : mapping
        JSON-able; `load_run` gives it back.
    """
    content = packed_run(run, provenance)
    write_atomically(path, lambda stream: stream.write(content))


def packed_run(run: FilterRun, provenance: Mapping[str, Any]) -> bytes:
    """What `save_run` writes."""
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


def load_provenance(path: Path) -> dict[str, Any]:
    """The provenance alone, without reading the series.

    Raises
    ------
    ValueError
        See `load_run`.
    """
    try:
        about = _checked(json.loads(str(read_arrays(path, ["about"])["about"])))
        provenance: dict[str, Any] = about["provenance"]
        return provenance
    except _DAMAGE as error:
        raise _damaged(path, error) from error


def load_run(path: Path) -> tuple[FilterRun, dict[str, Any]]:
    """Read a run and its provenance.

    Raises
    ------
    ValueError
        The file is damaged, or of a format this version does not know: the message names it and says what to do.
    """
    try:
        arrays: dict[str, Any] = read_arrays(path)
        about = _checked(json.loads(str(arrays["about"])))
        counts = {name.removeprefix("count."): arrays[name] for name in arrays if name.startswith("count.")}
        traces = tuple(
            LandmarkTrace(landmark_id, label, *(arrays[f"trace.{i}.{name}"] for name in _TRACE_SERIES))
            for i, (landmark_id, label) in enumerate(about["traces"])
        )
        series = {name: arrays[name] for name in _SERIES}
        run = FilterRun(
            **about["run"],
            **series,
            counts=counts,
            traces=traces,
            memory_mb=float(arrays["memory_mb"]),
            landmark_statistics=LandmarkStatistics(*(arrays[f"landmarks.{name}"] for name in _LANDMARK_SERIES)),
            truth_from=reference_of(about),
        )
        return run, about["provenance"]
    except _DAMAGE as error:
        raise _damaged(path, error) from error


def _checked(about: dict[str, Any]) -> dict[str, Any]:
    if about["format"] != FORMAT:
        raise ValueError(f"format {about['format']}, this version reads {FORMAT}")
    return about


def _damaged(path: Path, error: Exception) -> Exception:
    if isinstance(error, FileNotFoundError):
        return error
    reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    return ValueError(f"{path} is damaged ({reason}): delete it and run the same command again")


def write_tum(path: Path, timestamps: FloatArray, positions: FloatArray, orientations: FloatArray) -> None:
    """Rows `t x y z qx qy qz qw` of the poses that are known.

    Parameters
    ----------
    path : Path
        The file.
    timestamps, positions, orientations : (K,), (K, 3), (K, 4)
        s, m in W, q^WC xyzw.
    """
    rows = np.column_stack([timestamps, positions, orientations])
    _write_rows(path, rows[np.isfinite(rows).all(axis=1)])


def write_kitti(path: Path, positions: FloatArray, orientations: FloatArray) -> None:
    """Rows of the 3x4 matrix T_wc, row-major, of the poses that are known.

    The format has no times: where poses are missing, the rows are no longer those of the frames.
    """
    known = np.isfinite(positions).all(axis=1) & np.isfinite(orientations).all(axis=1)
    T_wc = np.concatenate([rotations.matrix(orientations[known]), positions[known][:, :, None]], axis=2)
    _write_rows(path, T_wc.reshape(-1, 12))


def _write_rows(path: Path, rows: FloatArray) -> None:
    write_atomically(path, lambda stream: np.savetxt(stream, rows, fmt="%.9f"))
