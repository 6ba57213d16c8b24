"""Trajectories of transforms: the pose of one frame in another, through a tree of transforms over time (ROS tf).

Rows of trajectories as they come: which of them are data, and what 36 covariances of ROS claim.

Systems that lost their way, and recorders without an orientation, write fillers: NaN, zero quaternions, variances that
no pose has. A row that claims nothing is left out of all figures and counted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from filters import Pose
from filters.contract.validation import plain
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.motions.motion_model import POSE_SIZE, ROTATION
from stereo_slam_env.recording.trajectory import Trajectory, transformed

OPTICAL_TO_BASE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""R that takes vectors of x right, y down, z forward to those of x forward, y left, z up (REP 103)."""
_SHOWN = 8
"""Pairs of frames that a message lists."""


@dataclass(frozen=True, eq=False)
class Link:
    """The pose of a frame in its parent."""

    parent: str
    """Name of the parent."""
    rows: FloatArray
    """(K, 8): t, x, y, z, qx, qy, qz, qw; ascending in time, each time once."""
    is_static: bool
    """Whether it holds at all times; then it has one row."""
    rivals: tuple[str, ...] = ()
    """All its parents, where there are several: no chain leads over it."""

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (N, 3) and orientations (N, 4) at times (N,), between the rows."""
        if self.is_static or len(self.rows) == 1:
            return np.tile(self.rows[-1, 1:4], (len(times), 1)), np.tile(self.rows[-1, 4:], (len(times), 1))
        t = self.rows[:, 0]
        positions = np.column_stack([np.interp(times, t, axis) for axis in self.rows[:, 1:4].T])
        return positions, Slerp(t, Rotation.from_quat(self.rows[:, 4:]))(times).as_quat()


def links_of(transforms: Iterable[tuple[str, str, bool, list[float]]]) -> dict[str, Link]:
    """Links by the name of the child, from (parent, child, whether it is static, row of t, p, q) in any order.

    A frame with two parents, as a thing that is taken up and put down has, ends the tree above it: it is no chain's.
    """
    rows: dict[str, dict[tuple[str, bool], list[list[float]]]] = {}
    for parent, child, is_static, row in transforms:
        rows.setdefault(child, {}).setdefault((parent, is_static), []).append(row)
    links = {}
    for child, by_parent in rows.items():
        parents = sorted({parent for parent, _ in by_parent})
        (parent, is_static), table_rows = next(iter(by_parent.items()))
        table = np.array([row for some in by_parent.values() for row in some] if len(parents) == 1 else table_rows)
        table = table[np.unique(table[:, 0], return_index=True)[1]]
        links[child] = Link(parent, table, is_static, tuple(parents[1:] and parents))
    return links


def poses_between(links: Mapping[str, Link], pair: str) -> FloatArray:
    """Poses (K, 8) of frame CHILD in frame PARENT, for the pair "PARENT.CHILD": t, x, y, z, qx, qy, qz, qw.

    They are at the times of the link of the chain that is told most often, as far as all links are known; the others
    are taken between their rows.

    Raises
    ------
    ValueError
        No such chain, or its links have no time in common.
    """
    chain = next(
        (
            way
            for child in links
            for parent in _ancestors(links, child)
            if f"{parent}.{child}" == pair and (way := _chain(links, parent, child))
        ),
        None,
    )
    if chain is None:
        forks = [
            f"{plain(child)} has the parents {' and '.join(map(plain, link.rivals))}"
            for child, link in links.items()
            if link.rivals and pair.endswith(f".{child}")
        ]
        why = f" ({forks[0]}, which is no tree)" if forks else ""
        raise ValueError(f"no chain of transforms for {plain(pair)}{why}: ask for PARENT.CHILD ({listed(links)})")
    moving = [link for link in chain if not link.is_static]
    if not moving:
        raise ValueError(f"{plain(pair)} is static: ask for another pair ({listed(links)})")
    times = max(moving, key=lambda link: len(link.rows)).rows[:, 0]
    first, last = max(link.rows[0, 0] for link in moving), min(link.rows[-1, 0] for link in moving)
    times = times[(times >= first) & (times <= last)]
    if not len(times):
        raise ValueError(f"the transforms between {plain(pair)} have no time in common")
    positions, orientations = chain[0].at(times)
    for link in chain[1:]:
        step, turn = link.at(times)
        positions = positions + rotations.turned(rotations.matrix(orientations), step)
        orientations = rotations.multiply(orientations, turn)
    return np.column_stack([times, positions, orientations])


def fixed_pose(links: Mapping[str, Link], parent: str, child: str) -> Pose | None:
    """The pose of frame `child` in frame `parent` by static transforms alone; None where none lead there."""
    ways = [_in_fixed_ancestors(links, frame) for frame in (parent, child)]
    common = next((name for name in ways[0] if name in ways[1]), None)
    return None if common is None else ways[0][common].inverse() @ ways[1][common]


def _in_fixed_ancestors(links: Mapping[str, Link], frame: str) -> dict[str, Pose]:
    """Poses of a frame in itself and in the frames above it that it is fixed to."""
    pose_by_frame, name = {frame: Pose()}, frame
    while (
        name in links and not links[name].rivals and links[name].is_static and links[name].parent not in pose_by_frame
    ):
        link = links[name]
        pose_by_frame[link.parent] = Pose(link.rows[-1, 1:4], link.rows[-1, 4:]) @ pose_by_frame[name]
        name = link.parent
    return pose_by_frame


def listed(links: Mapping[str, Link]) -> str:
    """Pairs of frames that move in each other, the roots first, for messages."""
    moving = [child for child, link in links.items() if not link.is_static]
    pairs = [f"{plain(parent)}.{plain(child)}" for child in moving for parent in reversed(_ancestors(links, child))]
    return ", ".join(pairs[:_SHOWN]) + (", ..." if len(pairs) > _SHOWN else "") if pairs else "none move"


def _ancestors(links: Mapping[str, Link], child: str) -> list[str]:
    """Names of the parents of a frame, from its own to the root."""
    names: list[str] = []
    while child in links and not links[child].rivals and links[child].parent not in names:
        child = links[child].parent
        names.append(child)
    return names


def _chain(links: Mapping[str, Link], parent: str, child: str) -> list[Link]:
    """Links from a frame down to one below it."""
    way = [links[child]]
    while way[0].parent != parent:
        way.insert(0, links[way[0].parent])
    return way


UNKNOWN = -1.0
"""The first variance of a message of ROS whose covariance is not known."""
_SAYS_NOTHING = np.array([1e3, 1e3, 1e3, 10.0, 10.0, 10.0])
"""m^2 and rad^2: variances from these on are written by those who do not estimate an axis, or have lost it."""
_JUMP = 10.0
"""The least of such variances by the largest of the others: one that has grown so large is a claim."""
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")
_IN_PLANE = np.array([0, 1, 5])
_ASYMMETRY = 0.01
"""Of a covariance, as a correlation; more is no rounding."""
_SERIES = ("timestamps", "frame_numbers", "covariances", "tracks")


def assembled(
    what: str, positions: FloatArray, orientations: FloatArray | None, *, by_ros: bool = False, **about: Any
) -> Trajectory:
    """The trajectory of those of K rows that are data; its notes count the others.

    Parameters
    ----------
    what : str
        What errors are named by, as a file.
    positions, orientations : (K, 3) and (K, 4) arrays
        As of `Trajectory`, NaN and zero quaternions among them; orientations None: not recorded.
    by_ros : bool
        Whether the covariances are those of ROS: the rotation about fixed axes, -1 and zero for what is not known.
    **about
        Further arguments of `Trajectory`, `covariances` as they stand in the file.

    Raises
    ------
    ValueError
        No row is data, or the rows are no trajectory: one line that opens with `what`.
    """
    notes = list(about.pop("notes", ()))
    about["is_oriented"] = orientations is not None and bool(np.nan_to_num(orientations).any())
    if orientations is None or not about["is_oriented"]:
        notes.append(
            f"it has {'no' if orientations is None else 'only zero'} quaternions: its positions alone are read"
        )
        orientations = np.tile([0.0, 0.0, 0.0, 1.0], (len(positions), 1))
    states = about.pop("states", {})
    covariances = about.get("covariances")
    if covariances is not None and (np.isnan(covariances).any(axis=(1, 2)) | _is_unknown(covariances)).all():
        about["covariances"] = covariances = None
        notes.append("its covariances are marked as not known")
    nothing: BoolArray = np.asarray(
        ~np.isfinite(positions).all(axis=1) | ~np.isfinite(orientations).all(axis=1) | ~orientations.any(axis=1)
    )
    if covariances is not None:
        nothing |= _claims_nothing(covariances, by_ros)
    if nothing.all():
        raise ValueError(f"{what}: none of its {len(nothing)} rows holds a pose: give the rows that do")
    if lost := int(np.count_nonzero(nothing)):
        notes.append(f"{lost} of {len(nothing)} rows claim nothing (NaN, a zero quaternion, or no variance): left out")
    about |= {name: about[name][~nothing] for name in _SERIES if about.get(name) is not None}
    positions, orientations = positions[~nothing], orientations[~nothing]
    states = {name: belief.rows(~nothing) for name, belief in states.items()}
    if about.get("covariances") is not None:
        claim: dict[str, Any] = {"covariances": about["covariances"]}
        try:
            claim["covariances"] = _symmetric(claim["covariances"])
        except ValueError as error:
            raise ValueError(f"{what}: {error}") from error
        if (bad := np.argwhere(np.diagonal(claim["covariances"], axis1=1, axis2=2) < 0.0)).size:
            value = claim["covariances"][bad[0, 0], bad[0, 1], bad[0, 1]]
            notes.append(f"pose {bad[0, 0]} has a variance of {value:.3g}, which none can be: correct it")
        if by_ros:
            claim = claim_of_ros(orientations, claim["covariances"])
        notes += claim.pop("notes", [])
        about |= {"covariances": None} | claim
    along = next((about[name] for name in ("timestamps", "frame_numbers") if about.get(name) is not None), None)
    if along is not None:
        first = np.concatenate([[True], np.diff(along) != 0])
        if repeated := int(np.count_nonzero(~first)):
            series = "time" if about.get("timestamps") is not None else "frame number"
            notes.append(f"{repeated} of {len(first)} rows repeat the {series} of the row before: the first counts")
        about |= {name: about[name][first] for name in _SERIES if about.get(name) is not None}
        positions, orientations = positions[first], orientations[first]
        states = {name: belief.rows(first) for name, belief in states.items()}
    try:
        return Trajectory(positions, orientations, **about, states=states, notes=tuple(notes))
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error


def about_fixed_axes(orientations: FloatArray, covariances: FloatArray) -> FloatArray:
    """Covariances (K, 6, 6) whose rotation is about the axes of the world, as ROS has it, for that in the body."""
    J = np.tile(np.eye(POSE_SIZE), (len(orientations), 1, 1))
    J[:, ROTATION, ROTATION] = rotations.matrix(orientations).swapaxes(-1, -2)
    return transformed(J, covariances)


def in_fixed_axes(orientations: FloatArray, covariances: FloatArray) -> FloatArray:
    """Covariances (K, 6, 6) whose rotation is in the body, for that about the axes of the world, as ROS has it."""
    return about_fixed_axes(orientations * [-1.0, -1.0, -1.0, 1.0], covariances)


def claim_of_ros(orientations: FloatArray, covariances: FloatArray) -> dict[str, Any]:
    """Claim of 36 covariances of ROS (K, 6, 6): `covariances`, `plane` and `notes` of the trajectory.

    All zero, they are not known. Those of a robot in the plane are zero, or too large to say anything, for z, roll and
    pitch: what is claimed is x, y and yaw, and the others are given the size of these.
    """
    if not covariances.any():
        return {"notes": ["its covariances are all zero, which says that they are not known"]}
    variances = np.abs(np.diagonal(covariances, axis1=1, axis2=2))
    unknown = (variances == 0.0).all(axis=0) | (variances >= _SAYS_NOTHING).all(axis=0)
    axes = [axis for axis, is_unknown in zip(_AXES, unknown.tolist(), strict=True) if is_unknown]
    if not axes:
        return {"covariances": about_fixed_axes(orientations, covariances)}
    words = f"its covariances are zero, or too large to say anything, for {', '.join(axes)}"
    if tuple(axes) != _AXES[2:5]:
        return {"notes": [f"{words}, so there is none of a pose: not judged"]}
    filled = np.zeros_like(covariances)
    filled[:, _IN_PLANE[:, None], _IN_PLANE] = covariances[:, _IN_PLANE[:, None], _IN_PLANE]
    filled[:, 2, 2] = 0.5 * (variances[:, 0] + variances[:, 1])
    filled[:, 3, 3] = filled[:, 4, 4] = variances[:, 5]
    return {
        "covariances": about_fixed_axes(orientations, filled),
        "plane": np.eye(3),
        "notes": [f"{words}: it is judged in the plane, by x, y and yaw"],
    }


def _is_unknown(covariances: FloatArray) -> BoolArray:
    return np.asarray(covariances[:, 0, 0] == UNKNOWN)


def _claims_nothing(covariances: FloatArray, by_ros: bool) -> BoolArray:
    """Rows (K,) whose covariance says that their pose is not known; an axis without a claim anywhere is not counted."""
    finite: BoolArray = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    variances = np.diagonal(np.where(finite[:, None, None], covariances, 0.0), axis1=1, axis2=2)
    large = variances >= _SAYS_NOTHING
    never = large[finite].all(axis=0)
    usual = np.where(large, 0.0, variances).max(axis=0, initial=0.0)
    jumps = np.where(large, variances, np.inf).min(axis=0, initial=np.inf) > _JUMP * usual
    nothing = ~finite | _is_unknown(covariances) | large[:, ~never & jumps].any(axis=1)
    if by_ros:  # zero after poses with a claim is not known; zero before them is a start that is given
        zero = ~variances.any(axis=1)
        nothing |= zero & (np.cumsum(~zero & finite) > 0)
    return np.asarray(nothing)


def _symmetric(covariances: FloatArray) -> FloatArray:
    """Covariances (K, 6, 6) mirrored where one triangle alone is filled in; a `ValueError` where the two contradict."""
    lower, upper = np.tril(covariances, -1), np.triu(covariances, 1)
    if not (lower.any() and upper.any()):
        return covariances + (lower + upper).swapaxes(1, 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.sqrt(np.abs(np.diagonal(covariances, axis1=1, axis2=2)))
        apart = np.abs(covariances - covariances.swapaxes(1, 2)) / (size[:, :, None] * size[:, None, :])
    if (bad := np.argwhere(apart > _ASYMMETRY)).size:
        k, i, j = bad[0].tolist()
        raise ValueError(
            f"the covariance of pose {k} is not symmetric ({covariances[k, i, j]:.3g} in row {i + 1}, column {j + 1}, "
            f"{covariances[k, j, i]:.3g} in row {j + 1}, column {i + 1}): correct it"
        )
    return covariances
