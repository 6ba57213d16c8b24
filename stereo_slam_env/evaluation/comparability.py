"""Obstacles to a comparison of estimate and reference: fillers, clock, reading, body, scale, blocks, divergence.

Nobody is condemned before the input is: where a clock, a frame, a scale or the order of blocks explains the errors, the
covariance is not judged, and what fits best is named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from filters import nees
from filters.checks.consistency import are_definite
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.body_frames import find_body_offset, seen_from, swapped_reading
from stereo_slam_env.evaluation.claims import PARTS, claimed_numbers, nees_of
from stereo_slam_env.evaluation.gauges import UP, AlignedPair, AlignmentKind, aligned_pair, find_alignment, own_gauge
from stereo_slam_env.evaluation.results import ConsistencyFigure, FilterRun
from stereo_slam_env.evaluation.synchronisation import PosePairs, find_time_offset, paired, share_at_risk, shifted
from stereo_slam_env.evaluation.trial import estimate_of, reference_of
from stereo_slam_env.recording.trajectory import Tangent, Trajectory, transformed

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
_CONSTANT = 1e-6
"""rad: quaternions that differ by less, digits of a text, are the same."""
_TURNS, _TURNS_MUCH, _BENDS = np.deg2rad([3.0, 20.0, 10.0])
"""Beside orientations that never change: another trajectory that turns, on a path that bends, or on any; and a path."""
_ELSEWHERE = 100.0
"""A start whose NEES is so many times too large is in another world."""
_AS_CLAIMED = 2.0
"""Innovations within this factor of their claim, by their NIS, show that the noise is as the filter assumes."""
_BEYOND_NOISE = 100.0
"""... and a NEES of more for each degree of freedom beside them is no matter of noise."""
_RUNS = 3
"""Runs that are looked at for what explains their errors; all have to agree."""


@dataclass(frozen=True)
class Findings:
    """Findings before the claim is judged."""

    diverged_at_s: float | None
    """Time from the first pair after which the estimate is no trajectory of this drive; None where it is one."""
    obstacles: Mapping[str, str]
    """Why a claim, "pose", "position" or "rotation", is not judged; empty text where it is."""
    notes: tuple[str, ...]
    """What is to be known beside the figures, each in a sentence."""

    @property
    def verdicts(self) -> dict[str, str]:
        """The verdict on each claim that is not judged; empty text where it is."""
        kind = "calibration, frames or truth" if self.diverged_at_s is None else "not judged"
        return {part: f"{kind}: {why}" if why else "" for part, why in self.obstacles.items()}


def gauge_of(estimate: Trajectory, reference: Trajectory) -> tuple[AlignmentKind, str]:
    """The alignment of paired trajectories that the file of the estimate asks for, and what is to be said of it."""
    how = own_gauge(estimate)
    if how != "none" or estimate.gauge is not None or estimate.covariances is None:
        return how, ""
    first, truth = estimate.rows(slice(0, 1)), reference.rows(slice(0, 1))
    turned = (truth if first.is_oriented else first).orientations
    assert first.covariances is not None
    numbers = next(iter(claimed_numbers(first).values()))
    apart = nees_of(numbers, first.errors(truth.positions, turned), first.covariances)[0]
    if not apart > numbers.shape[-2] * _ELSEWHERE:
        return how, ""
    kind: AlignmentKind = "start" if estimate.is_oriented else "rigid"
    return (
        kind,
        f"the world of {estimate.name} is not that of the reference, and no header says which: aligned by {kind}",
    )


def without_fillers(estimate: Trajectory, reference: Trajectory) -> tuple[Trajectory, Trajectory, list[str]]:
    """Paired trajectories, both marked as positions alone where the orientations of one are no data; and notes.

    Orientations that never change are a filler where the path or the other trajectory turns.
    """
    notes = []
    if estimate.is_oriented and reference.is_oriented:
        bends = max(_turn_of_path(estimate), _turn_of_path(reference)) > _BENDS
        spread = [_spread(estimate), _spread(reference)]
        for one, own, other in ((estimate, spread[0], spread[1]), (reference, spread[1], spread[0])):
            other_turns = other > _TURNS_MUCH or (bends and other > _TURNS)
            if own < _CONSTANT and (other_turns or (bends and other < _CONSTANT)):
                notes.append(f"all quaternions of {one.name} are equal, which is a filler: positions alone are judged")
        if not notes:
            return estimate, reference, []
    return replace(estimate, is_oriented=False), replace(reference, is_oriented=False), notes


def _spread(trajectory: Trajectory) -> float:
    """Angle from the first orientation that a tenth of the others exceed, rad."""
    R = rotations.matrix(trajectory.orientations)
    return float(np.quantile(np.linalg.norm(rotations.log(R[0].T @ R), axis=1), 0.9))


def _turn_of_path(trajectory: Trajectory) -> float:
    """Angle between directions of the path, twentieths of its poses apart, that a tenth of them exceed, rad."""
    steps = np.diff(trajectory.positions[:: max(1, len(trajectory) // _PIECES)], axis=0)
    length = np.linalg.norm(steps, axis=1)
    moving = length > 0.1 * length.max(initial=0.0)
    if np.count_nonzero(moving) < 2:
        return 0.0
    ahead = steps[moving] / length[moving, None]
    return float(np.quantile(np.arccos(np.clip(ahead @ ahead[0], -1.0, 1.0)), 0.9))


def explanation(bands: Mapping[str, tuple[float, float]], pair: AlignedPair) -> str:
    """A reading of the estimate under which its claim would be true where it seems too tight or too loose.

    Blocks of the covariances in the other order; a constant turn or lever arm of the body, seen in one world. `bands`
    are those of the mean NEES of "position" and "rotation". Empty text where there is none.
    """
    estimate, covariances = pair.estimate, pair.covariances
    if (
        covariances is None
        or estimate.plane is not None
        or not estimate.is_oriented
        or not _HALVES.keys() <= bands.keys()
    ):
        return ""
    usable = are_definite(covariances)
    errors, R = pair.errors[usable], rotations.matrix(estimate.orientations[usable])
    covariances, R_inverse = covariances[usable], R.swapaxes(1, 2)
    readings = [
        (_EXCHANGED, errors, transformed(_exchange(first, second), covariances), 1.0)
        for first, second in ((np.eye(3), np.eye(3)), (R, R_inverse))  # as given; or about the axes of the world
    ]
    for words, errors_left in _constant_offsets(estimate.tangent, R, errors):
        readings.append((words, errors_left, covariances, _MUCH**2))
    if _fits(errors, covariances, bands):
        return ""
    as_written = float(np.mean(nees(errors, covariances)))
    for words, e, P, factor in readings:
        # Exchanged blocks have the same determinant, so the smaller NEES is the likelier reading.
        if _fits(e, P, bands) and factor * float(np.mean(nees(e, P))) < as_written:
            return words
    return ""


_HALVES = {name: PARTS[name] for name in ("position", "rotation")}
_EXCHANGED = "the covariances fit where the rotation block stands first: exchange the blocks"


def _fits(errors: FloatArray, covariances: FloatArray, bands: Mapping[str, tuple[float, float]]) -> bool:
    """Whether the mean NEES of position and rotation are both in their bands."""
    means = {name: float(np.mean(nees(errors[:, p], covariances[:, p, p]))) for name, p in _HALVES.items()}
    return all(bands[name][0] <= mean <= bands[name][1] for name, mean in means.items())


def _exchange(first: FloatArray, second: FloatArray) -> FloatArray:
    """(..., 6, 6) matrix that takes `first` times the rotation for the position, `second` times that for the other."""
    S = np.zeros((*first.shape[:-2], POSE_SIZE, POSE_SIZE))
    S[..., POSITION, ROTATION], S[..., ROTATION, POSITION] = first, second
    return S


def _constant_offsets(tangent: Tangent, R: FloatArray, errors: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Constant turn and lever arm of the body, each and both: in words, and the errors (K, 6) that they leave."""
    if tangent == "left":
        return
    inside = np.array(errors)
    if tangent != "right":
        inside[:, POSITION] = seen_from(R, errors[:, POSITION])
    offset = np.median(inside, axis=0)
    turn = f"a constant turn of {np.rad2deg(np.linalg.norm(offset[ROTATION])):.3g}°"
    lever = f"a constant lever arm of {_length(float(np.linalg.norm(offset[POSITION])))}"
    for words, parts in ((turn, [ROTATION]), (lever, [POSITION]), (f"{turn} and {lever}", [ROTATION, POSITION])):
        errors_left = np.array(inside)
        for part in parts:
            errors_left[:, part] -= offset[part]
        if tangent != "right":
            errors_left[:, POSITION] = rotations.turned(R, errors_left[:, POSITION])
        yield (
            f"{words} between the bodies explains the errors: give it by --body, or let --body-estimated apply what is "
            "found",
            errors_left,
        )


def find_obstacles(pairs: PosePairs, whole: tuple[Trajectory, Trajectory], pair: AlignedPair) -> Findings:
    """Look for what keeps paired trajectories from being compared; `whole` are the two before they were paired."""
    aligned, truth, kind = pair.estimate, pairs.reference, pair.alignment.kind
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
    if clock := _of_clocks(whole, rigid):
        return Findings(None, dict.fromkeys(obstacles, clock), (clock,))
    if not pairs.estimate.is_oriented:
        pass
    elif reading := swapped_reading(pairs.estimate, truth):
        obstacles = dict.fromkeys(obstacles, reading)
        notes.append(reading)
    elif (offset := find_body_offset(pairs.estimate, truth)).words:
        notes.append(offset.words)
        for part, is_hit in (("rotation", offset.turned), ("position", offset.apart), ("pose", True)):
            obstacles[part] = offset.words if is_hit else ""
    scale, _, _ = metrics.similarity(pairs.estimate.positions, truth.positions)
    scaled = metrics.ate_scaled(pairs.estimate.positions, truth.positions)
    if scale > 0.0 and kind != "sim3" and scaled * _MUCH < rigid:
        why = f"the estimate has a scale of its own, {1.0 / scale:.3g} m for a metre: --align sim3 takes it off"
        obstacles = dict.fromkeys(obstacles, why)
        notes.append(why)
    elif kind == "none" and rigid * _MUCH < error:
        notes.append(
            f"the error is {_length(rigid)} after a rigid alignment: if the estimate has a world of its own, "
            "say so by --align start, gravity-yaw or rigid"
        )
    if (risk := share_at_risk(pairs)) > _WORTH:
        notes.append(
            f"at {100.0 * risk:.0f} % of the poses the time to the reference's pose could explain a third of a claimed "
            "deviation or more: --interpolate takes the reference in between"
        )
    return Findings(None, obstacles, tuple(notes))


def doubt_of_runs(runs: Sequence[FilterRun], figures: Mapping[str, ConsistencyFigure]) -> str:
    """An explanation of the errors of overconfident runs of a filter other than its claim; empty where there is none.

    Clock, body, scale and reading of the truth, as for any trajectory; or innovations that are as claimed beside errors
    that are far from it, which is what wrong calibrations look like. `figures` are those of the same runs.
    """
    pose, nis = figures.get("pose"), figures.get("nis")
    if pose is None or pose.mean <= pose.band[1]:
        return ""
    bands = {name: figures[name].band for name in _HALVES if name in figures}
    doubts = [_doubt_of(run, bands) for run in runs[:_RUNS]]
    if doubts and all(doubts):
        return doubts[0]
    excess = pose.mean / pose.dof
    if nis is None or excess < _BEYOND_NOISE or not 1.0 / _AS_CLAIMED < nis.mean / nis.dof < _AS_CLAIMED:
        return ""
    return (
        f"the innovations are as claimed, NIS / dof {nis.mean / nis.dof:.2f}, beside a pose NEES / 6 of {excess:,.0f}"
    )


def _doubt_of(run: FilterRun, bands: Mapping[str, tuple[float, float]]) -> str:
    estimate, truth = estimate_of(run), reference_of(run)
    if estimate is None or truth is None:
        return ""
    try:
        pairs = paired(estimate, truth)
    except ValueError:  # too few poses have a truth
        return ""
    matched, reference, fillers = without_fillers(pairs.estimate, pairs.reference)
    if fillers:
        return fillers[0].partition(":")[0]
    alignment = find_alignment("none", matched, reference, np.ones(len(matched), dtype=bool), UP["z"])
    pair = aligned_pair(matched, reference, alignment)
    findings = find_obstacles(pairs, (estimate, truth), pair)
    if findings.diverged_at_s is not None:
        return ""
    pair = pair.rows(slice(1, None))  # the first frame is given
    why = next(filter(None, findings.obstacles.values()), "") or explanation(bands, pair)
    return why.partition(":")[0]  # the remedy behind it is that of files of trajectories


def _diverged_at(aligned: Trajectory, reference: Trajectory, path: float) -> float | None:
    """Time at which an estimate left the drive, s from its first pose; None where it did not.

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
        distances = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(reference.positions, axis=0), axis=1))])
        ends = np.searchsorted(distances, np.linspace(0.0, path * (1.0 - 1e-9), _PIECES + 1))
        ours, theirs = (np.linalg.norm(np.diff(one.positions[ends], axis=0), axis=1) for one in (aligned, reference))
        well = np.flatnonzero(np.abs(ours - theirs) <= path / _PIECES)
        first_bad = int(well[-1]) + 1 if len(well) else 0
        if not _PIECES // 2 <= first_bad < _PIECES - 1 or len(well) < first_bad:
            return None
        row = int(ends[first_bad])
    times = reference.timestamps if reference.timestamps is not None else aligned.timestamps
    return float(row) if times is None else float(times[row] - times[0])


def _of_clocks(whole: tuple[Trajectory, Trajectory], rigid: float) -> str:
    """Difference of the clocks where that explains most of the error, in a sentence; empty where it does not."""
    try:
        offset = find_time_offset(*whole)
        matched = paired(shifted(whole[0], offset), whole[1], interpolate=True)
    except ValueError:  # without times, or on a path that fits anywhere, none is to be had
        return ""
    if metrics.ate_rigid(matched.estimate.positions, matched.reference.positions) * _MUCH < rigid:
        return f"the clocks seem to differ by {offset:+.3f} s: --time-offset auto applies what fits best"
    return ""


def _length(metres: float) -> str:
    return f"{metres / 1000.0:.3g} km" if metres >= 1000.0 else f"{metres:.3g} m"
