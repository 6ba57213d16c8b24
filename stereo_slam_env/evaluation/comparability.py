"""Obstacles to a comparison of estimate and reference: body, world, scale, clock, reading, divergence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from filters import nees
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.body_frames import find_body_offset, swapped_reading
from stereo_slam_env.evaluation.gauges import Alignment, AlignmentKind, own_gauge
from stereo_slam_env.evaluation.synchronisation import PosePairs, find_time_offset, paired, share_at_risk, shifted
from stereo_slam_env.recording.trajectory import Trajectory

_ASTRAY = 0.1
"""Share of the reference's path; the last time that the error was below it is when an estimate diverged."""
_PIECES = 20
"""Pieces of the path, of the same length, that a divergence is looked for in."""
_MUCH = 3.0
"""An alignment, a scale or an offset in time is mentioned where it makes the error so many times smaller."""
_LEAST = 1e-6
"""m: smaller errors are rounding, and nothing is looked for in them."""
_WORTH = 0.1
"""Share of poses at risk by their time above which that is said."""
_ELSEWHERE = 100.0
"""A start whose NEES is so many times too large is in another world."""


@dataclass(frozen=True)
class Findings:
    """What was found before the claim was judged."""

    diverged_at_s: float | None
    """Time from the first pair after which the estimate is no trajectory of this drive; None where it is one."""
    obstacles: Mapping[str, str]
    """Why a claim, "pose", "position" or "rotation", is not judged; empty text where it is."""
    notes: tuple[str, ...]
    """What is to be known beside the figures, each in a sentence."""


def gauge_of(estimate: Trajectory, reference: Trajectory) -> tuple[AlignmentKind, str]:
    """The alignment of paired trajectories that the file of the estimate asks for, and what is to be said of it."""
    how = own_gauge(estimate)
    if how != "none" or estimate.gauge is not None or estimate.covariances is None:
        return how, ""
    first, truth = estimate.rows(slice(0, 1)), reference.rows(slice(0, 1))
    assert first.covariances is not None
    apart = nees(first.errors(truth.positions, truth.orientations), first.covariances)[0]
    if not apart > 6.0 * _ELSEWHERE:
        return how, ""
    return (
        "start",
        f"the world of {estimate.name} is not that of the reference, and no header says which: aligned by start",
    )


def find_obstacles(pairs: PosePairs, whole: tuple[Trajectory, Trajectory], alignment: Alignment) -> Findings:
    """What keeps paired trajectories from being compared; `whole` are the two before they were paired."""
    aligned, truth = alignment.apply(pairs.estimate), pairs.reference
    path = metrics.path_length(truth.positions)
    obstacles = dict.fromkeys(("pose", "position", "rotation"), "")
    notes: list[str] = []
    if (at := _diverged_at(aligned, truth, path)) is not None:
        end = float(np.linalg.norm(aligned.positions[-1] - aligned.positions[0]))
        why = f"the estimate diverged {at:.3g} s after its first pose, and ends {_length(end)} from its start"
        why += f", on a path of {_length(path)}"
        return Findings(at, dict.fromkeys(obstacles, why), (why,))
    rigid = metrics.ate_rigid(pairs.estimate.positions, truth.positions)
    error = metrics.ate_unaligned(aligned.positions, truth.positions)
    if error < _LEAST:
        return Findings(None, obstacles, ())
    if reading := swapped_reading(pairs.estimate, truth):
        obstacles = dict.fromkeys(obstacles, reading)
        notes.append(reading)
    elif (offset := find_body_offset(pairs.estimate, truth)).words:
        notes.append(offset.words)
        for part, is_hit in (("rotation", offset.turned), ("position", offset.apart), ("pose", True)):
            obstacles[part] = offset.words if is_hit else ""
    scale, _, _ = metrics.similarity(pairs.estimate.positions, truth.positions)
    if alignment.kind != "sim3" and metrics.ate_scaled(pairs.estimate.positions, truth.positions) * _MUCH < rigid:
        why = f"the estimate has a scale of its own, {1.0 / scale:.3g} m for a metre: --align sim3 takes it off"
        obstacles = dict.fromkeys(obstacles, why)
        notes.append(why)
    elif alignment.kind == "none" and rigid * _MUCH < error:
        notes.append(
            f"the error is {_length(rigid)} after a rigid alignment: where the estimate has a world of its own, "
            "--align start, gravity-yaw or rigid says so"
        )
    notes += _of_time(pairs, whole, rigid)
    return Findings(None, obstacles, tuple(notes))


def _diverged_at(aligned: Trajectory, reference: Trajectory, path: float) -> float | None:
    """When an estimate left the drive, s from its first pose; None where it did not.

    Its distance from its own start becomes wrong by more than the whole path, which no world and no body of its own can
    do; or it goes well over the first half of the path, and from some piece of it on to the end each is wrong by more
    than its length.
    """
    if path == 0.0:
        return None
    ours, theirs = (np.linalg.norm(one.positions - one.positions[0], axis=1) for one in (aligned, reference))
    off = np.abs(ours - theirs)
    if off.max() > path:
        row = int(np.flatnonzero(off <= _ASTRAY * path)[-1])
    else:
        gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(reference.positions, axis=0), axis=1))])
        ends = np.searchsorted(gone, np.linspace(0.0, path * (1.0 - 1e-9), _PIECES + 1))
        ours, theirs = (np.linalg.norm(np.diff(one.positions[ends], axis=0), axis=1) for one in (aligned, reference))
        well = np.flatnonzero(np.abs(ours - theirs) <= path / _PIECES)
        first_bad = int(well[-1]) + 1 if len(well) else 0
        if not _PIECES // 2 <= first_bad < _PIECES - 1 or len(well) < first_bad:
            return None
        row = int(ends[first_bad])
    times = reference.timestamps if reference.timestamps is not None else aligned.timestamps
    return float(row) if times is None else float(times[row] - times[0])


def _of_time(pairs: PosePairs, whole: tuple[Trajectory, Trajectory], rigid: float) -> list[str]:
    notes = []
    if (risk := share_at_risk(pairs)) > _WORTH:
        notes.append(
            f"at {100.0 * risk:.0f} % of the poses the time to the reference's pose could explain a third of a claimed "
            "deviation or more: --interpolate takes the reference in between"
        )
    try:
        offset = find_time_offset(*whole)
        found = paired(shifted(whole[0], offset), whole[1], interpolate=True)
    except ValueError:  # without times, or on a straight path, none is found
        return notes
    if metrics.ate_rigid(found.estimate.positions, found.reference.positions) * _MUCH < rigid:
        notes.append(f"the clocks seem to differ by {offset:+.3g} s: --time-offset auto applies what fits best")
    return notes


def _length(metres: float) -> str:
    return f"{metres / 1000.0:.3g} km" if metres >= 1000.0 else f"{metres:.3g} m"
