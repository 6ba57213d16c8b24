"""Chain of inactive submaps behind the active map: p(all) = p(active) p(last | active) ... p(first | second).

Each has blocks in common with the next; the held blocks of the active map are those of the last submap. The chain says
what moves along it: landmarks that come to rest, landmarks brought forward at a loop, corrections carried back.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, IntArray
from filters.state.joint_state import JointState
from filters.submaps.submap import Relation, Submap, regression, units


class SubmapChain:
    """Submaps at rest, oldest first. Methods that take the active state change it in place."""

    def __init__(self) -> None:
        self._submaps: list[Submap] = []
        self._links: list[IntArray] = []  # blocks of submap i + 1 that are the common ones of submap i
        self._ids = np.zeros(0, dtype=np.int64)  # all landmarks at rest, ascending
        self._homes = np.zeros(0, dtype=np.int64)  # the submap of each

    def __len__(self) -> int:
        return len(self._submaps)

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """Oldest first."""
        return tuple(self._submaps)

    @property
    def ids(self) -> IntArray:
        """All landmarks at rest, ascending; (N,)."""
        return self._ids.copy()

    def at_rest(self, ids: IntArray) -> BoolArray:
        """Which landmarks are at rest; (M,)."""
        return self._homes_of(ids) >= 0

    def rest(self, active: JointState, gone: BoolArray) -> None:
        """Put the landmarks marked in `gone` (N,) to rest: with whatever the next map does not need, a new submap.

        They are independent of all that follows given the camera of now and the landmarks that stay.
        """
        stays = ~gone
        shared_before, clone = active.held, active.hold_variables()
        used = _blocks_of(active.parameter_block, active.anchor_block)
        needed = _blocks_of(active.parameter_block[stays], active.anchor_block[stays])
        blocks, common = np.union1d(used, active.held), np.union1d(needed, clone)
        own = np.setdiff1d(blocks, common, assume_unique=True)
        scale = units(active.P)
        gain, covariance = regression(active.P, scale, active.block_rows(own), active.block_rows(common))
        numbers = np.full(len(active.blocks) + 1, -1)  # the last entry is that of the block -1: none
        numbers[blocks] = np.arange(len(blocks))
        if self._submaps:
            self._links.append(numbers[shared_before])
        self._submaps.append(
            Submap(
                active.blocks[blocks],
                active.first_blocks[blocks],
                scale[active.block_rows(blocks)].reshape(-1, active.size),
                numbers[own],
                numbers[common],
                gain,
                covariance,
                active.ids[gone],
                numbers[active.parameter_block[gone]],
                numbers[active.anchor_block[gone]],
            )
        )
        self._settle(active.ids[gone], len(self._submaps) - 1)
        active.rest(gone, common)

    def bring(self, active: JointState, ids: IntArray) -> None:
        """Bring landmarks at rest into the active map: on the way each becomes common to all submaps it passes.

        Parameters
        ----------
        active : JointState
            Where they go.
        ids : (M,) int64
            Landmarks at rest.
        """
        homes = self._homes_of(ids)
        brought, parameter_block, anchor_block = np.zeros((3, 0), dtype=np.int64)
        for number in range(int(homes.min()), len(self._submaps)):
            submap = self._submaps[number]
            if (homes == number).any():
                leaving = np.isin(submap.ids, ids)
                brought = np.concatenate([brought, submap.ids[leaving]])
                parameter_block = np.concatenate([parameter_block, submap.parameter_block[leaving]])
                anchor_block = np.concatenate([anchor_block, submap.anchor_block[leaving]])
                submap = submap.without(leaving)
            new = submap.own_among(_blocks_of(parameter_block, anchor_block))
            if len(new):
                submap, handed = submap.share(new)
                self._hand_on(active, number, handed)
            self._submaps[number] = submap
            link = self._link(active, number)
            numbers = np.full(len(submap.values) + 1, -1)
            numbers[submap.common] = link
            parameter_block, anchor_block = numbers[parameter_block], numbers[anchor_block]
        active.adopt(brought, parameter_block, anchor_block)
        self._unsettle(ids)
        self._fold()

    def seen_from(self, active: JointState) -> Iterator[JointState]:
        """The submaps, newest first, each with the present camera and with all that is known now."""
        later = active
        for number in reversed(range(len(self._submaps))):
            later = self._submaps[number].seen_from(later, self._link(active, number))
            yield later

    def forget(self, ids: IntArray) -> None:
        """Take landmarks out of the map; those not at rest here are ignored."""
        gone = ids[self.at_rest(ids)]
        for number in np.unique(self._homes_of(gone)):
            submap = self._submaps[number]
            self._submaps[number] = submap.without(np.isin(submap.ids, gone))
        self._unsettle(gone)
        self._fold()

    def _fold(self) -> None:
        """Join submaps without a landmark at rest with those before them, so that laps do not lengthen the chain."""
        for number in reversed(range(len(self._submaps))):
            submap = self._submaps[number]
            if len(submap.ids):
                continue
            place = max(number - 1, 0)
            if number > 0:
                submap, numbers = submap.absorb(self._submaps[place], self._links[place])
                self._submaps[place : number + 1] = [submap]
                if place > 0:
                    self._links[place - 1] = numbers[self._links[place - 1]]
            else:
                del self._submaps[0]
            del self._links[place : place + 1]
            self._homes[self._homes >= number] -= 1
            if place < len(self._submaps):
                submap = self._submaps[place]
                before = self._links[place - 1] if place > 0 else np.zeros(0, dtype=np.int64)
                needed = np.concatenate([_blocks_of(submap.parameter_block, submap.anchor_block), before])
                self._submaps[place] = submap.thinned(needed)

    def _link(self, active: JointState, number: int) -> IntArray:
        return active.held if number == len(self._submaps) - 1 else self._links[number]

    def _hand_on(self, active: JointState, number: int, handed: Relation) -> None:
        """Give blocks of submap `number` to the next one, or to the active map."""
        if number < len(self._submaps) - 1:
            link = self._links[number]
            self._submaps[number + 1], new = self._submaps[number + 1].receive(handed, link)
            self._links[number] = np.concatenate([link, new])
            return
        rows = active.block_rows(active.held)
        cross = handed.gain @ symmetric.rows(active.P, rows)
        own = cross[:, rows] @ handed.gain.T + handed.covariance
        active.append(handed.at(active.blocks[active.held]), handed.first, cross, own)

    def _homes_of(self, ids: IntArray) -> IntArray:
        """The submap in which each landmark is at rest, -1 for none; (M,)."""
        if len(self._ids) == 0:
            return np.full(len(ids), -1)
        place = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
        return np.where(self._ids[place] == ids, self._homes[place], -1)

    def _settle(self, ids: IntArray, home: int) -> None:
        ids = np.sort(ids)
        place = np.searchsorted(self._ids, ids)
        self._ids = np.insert(self._ids, place, ids)
        self._homes = np.insert(self._homes, place, home)

    def _unsettle(self, ids: IntArray) -> None:
        place = np.searchsorted(self._ids, ids)
        self._ids = np.delete(self._ids, place)
        self._homes = np.delete(self._homes, place)


def _blocks_of(parameter_block: IntArray, anchor_block: IntArray) -> IntArray:
    """All blocks that landmarks use, ascending."""
    return np.unique(np.concatenate([parameter_block, anchor_block[anchor_block >= 0]]))
