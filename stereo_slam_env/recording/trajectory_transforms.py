"""Trajectories of transforms: the pose of one frame in another, through a tree of transforms over time (ROS tf)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from filters import Pose
from filters.contract.validation import plain
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray

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
    found, name = {frame: Pose()}, frame
    while name in links and not links[name].rivals and links[name].is_static and links[name].parent not in found:
        link = links[name]
        found[link.parent] = Pose(link.rows[-1, 1:4], link.rows[-1, 4:]) @ found[name]
        name = link.parent
    return found


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
