"""An inactive submap: the distribution of its own blocks given those that it shares with the next one.

The error state is linear Gaussian and future measurements touch the blocks at rest only through the common ones. So
p(own | common) is fixed for good: own = values + gain (common - values) + N(0, covariance). Whatever is learnt of the
common blocks later is carried over by the gain, exactly. (Pinies and Tardos 2008, back-propagation: K = P_AC P_C^-1,
P_A + K (P_C' - P_C) K^T; kept here as gain and P_A - K P_C K^T, which needs no P_C and cannot lose definiteness.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import blas, lapack

from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.joint_state import JointState

NEGLIGIBLE = 1e-12
"""Share of its variance below which a number counts as known from the others: what is left is rounding."""


@dataclass(frozen=True, eq=False)
class Relation:
    """Blocks as a linear function of the common blocks, plus noise: how they are handed on to the next submap."""

    values: FloatArray
    """(E, s): where the blocks are when the common blocks are at `reference`."""
    first: FloatArray
    """(E, s): blocks as first estimated."""
    scale: FloatArray
    """(E, s): standard deviations before anything was known of the common blocks."""
    reference: FloatArray
    """(c, s): values of the common blocks."""
    gain: FloatArray
    """(s E, s c), by the common blocks."""
    covariance: FloatArray
    """(s E, s E), of the noise."""

    def at(self, common: FloatArray) -> FloatArray:
        """Values where the common blocks are `common` (c, s)."""
        shifted: FloatArray = self.values + (self.gain @ (common - self.reference).ravel()).reshape(self.values.shape)
        return shifted


@dataclass(frozen=True, eq=False)
class Submap:
    """p(own blocks | common blocks), and the landmarks at rest in it."""

    values: FloatArray
    """(B, s): blocks as they were when the submap came to rest."""
    first: FloatArray
    """(B, s): blocks as first estimated."""
    scale: FloatArray
    """(B, s): standard deviations when the submap came to rest: what is tiny beside them is rounding."""
    own: IntArray
    """(a,): blocks that are only here or shared with earlier submaps."""
    common: IntArray
    """(c,): blocks in common with the next submap."""
    gain: FloatArray
    """(s a, s c), of the own blocks by the common ones."""
    covariance: FloatArray
    """(s a, s a), of the own blocks, given the common ones."""
    ids: IntArray
    """(N,): landmarks at rest here."""
    parameter_block: IntArray
    """(N,): blocks of the landmarks."""
    anchor_block: IntArray
    """(N,): blocks of their anchors; -1 where there is none."""

    def without(self, gone: BoolArray) -> Submap:
        """The same blocks with fewer landmarks at rest; (N,)."""
        stays = ~gone
        return replace(
            self,
            ids=self.ids[stays],
            parameter_block=self.parameter_block[stays],
            anchor_block=self.anchor_block[stays],
        )

    def receive(self, handed: Relation, link: IntArray) -> tuple[Submap, IntArray]:
        """Take blocks from the previous submap as own ones.

        Parameters
        ----------
        handed : Relation
            In terms of the common blocks of the previous submap.
        link : (c,) int64
            Which blocks of this one those are.

        Returns
        -------
        Submap
            With the new blocks.
        (E,) int64
            Which they are.
        """
        here = np.zeros((len(handed.gain), self.values.size))
        here[:, self._rows(link)] = handed.gain
        by_own, by_common = here[:, self._rows(self.own)], here[:, self._rows(self.common)]
        cross = by_own @ self.covariance
        covariance = np.block([[self.covariance, cross.T], [cross, cross @ by_own.T + handed.covariance]])
        new = np.arange(len(self.values), len(self.values) + len(handed.values))
        received = replace(
            self,
            values=np.vstack([self.values, handed.at(self.values[link])]),
            first=np.vstack([self.first, handed.first]),
            scale=np.vstack([self.scale, handed.scale]),
            own=np.concatenate([self.own, new]),
            gain=np.vstack([self.gain, by_own @ self.gain + by_common]),
            covariance=covariance,
        )
        return received, new

    def share(self, blocks: IntArray) -> tuple[Submap, Relation]:
        """Make own blocks common ones: p(own | common) = p(stay | shared, common) p(shared | common).

        Returns
        -------
        Submap
            Its common blocks are the old ones, then `blocks`.
        Relation
            The blocks in terms of the old common ones, for the next submap.
        """
        shared = self._among(blocks)[self.own]
        leaving, staying = self._rows(np.flatnonzero(shared)), self._rows(np.flatnonzero(~shared))
        by_shared, covariance = regression(self.covariance, self.scale[self.own].ravel(), staying, leaving)
        remaining = replace(
            self,
            own=self.own[~shared],
            common=np.concatenate([self.common, self.own[shared]]),
            gain=np.hstack([self.gain[staying] - by_shared @ self.gain[leaving], by_shared]),
            covariance=covariance,
        )
        return remaining, self._relation(shared)

    def absorb(self, earlier: Submap, link: IntArray) -> tuple[Submap, IntArray]:
        """This submap and the previous one as one: p(own, own of the earlier | common).

        Parameters
        ----------
        earlier : Submap
            The previous one.
        link : (c,) int64
            Which blocks of this one its common blocks are.

        Returns
        -------
        Submap
            With the landmarks of both.
        (B + 1,) int64
            What the blocks of the earlier one are in it; the last entry is -1, for the block -1.
        """
        merged, new = self.receive(earlier._relation(np.ones(len(earlier.own), dtype=bool)), link)
        numbers = np.full(len(earlier.values) + 1, -1)
        numbers[earlier.common], numbers[earlier.own] = link, new
        merged = replace(
            merged,
            ids=np.concatenate([self.ids, earlier.ids]),
            parameter_block=np.concatenate([self.parameter_block, numbers[earlier.parameter_block]]),
            anchor_block=np.concatenate([self.anchor_block, numbers[earlier.anchor_block]]),
        )
        return merged, numbers

    def thinned(self, needed: IntArray) -> Submap:
        """Without the own blocks that are not `needed`: marginalised out."""
        stays = self._among(needed)[self.own]
        rows = self._rows(np.flatnonzero(stays))
        return replace(self, own=self.own[stays], gain=self.gain[rows], covariance=self.covariance[np.ix_(rows, rows)])

    def own_among(self, blocks: IntArray) -> IntArray:
        """Own ones among `blocks`."""
        return blocks[self._among(self.own)[blocks]]

    def _rows(self, blocks: IntArray) -> IntArray:
        """Rows of blocks in their order, where there is no camera before them; (M,) -> (s M,)."""
        size = self.values.shape[1]
        rows: IntArray = (size * blocks[:, None] + np.arange(size)).ravel()
        return rows

    def _among(self, blocks: IntArray) -> BoolArray:
        """Mask (B,) of all blocks: those among `blocks`."""
        marked = np.zeros(len(self.values), dtype=bool)
        marked[blocks] = True
        return marked

    def _relation(self, which: BoolArray) -> Relation:
        """The own blocks marked in `which` (a,), by the common ones."""
        blocks, rows = self.own[which], self._rows(np.flatnonzero(which))
        return Relation(
            self.values[blocks],
            self.first[blocks],
            self.scale[blocks],
            self.values[self.common],
            self.gain[rows],
            self.covariance[np.ix_(rows, rows)],
        )

    def seen_from(self, later: JointState, link: IntArray) -> JointState:
        """The camera and the blocks of this submap, given all that is known in the next one.

        Parameters
        ----------
        later : JointState
            Camera and blocks of the next submap.
        link : (c,) int64
            Which blocks of the next submap the common ones are.
        """
        leading = later.layout.size
        known_rows = np.concatenate([later.layout.rows, later.block_rows(link)])
        P_known = symmetric.rows(later.P, known_rows)[:, known_rows]
        cross = self.gain @ P_known[leading:]
        shift = (later.blocks[link] - self.values[self.common]).ravel()
        blocks = self.values.copy()
        blocks[self.own] += (self.gain @ shift).reshape(-1, self.values.shape[1])
        blocks[self.common] = later.blocks[link]
        rows = np.concatenate([later.layout.rows, leading + self._rows(self.common)])
        own_rows = leading + self._rows(self.own)
        P = np.empty((leading + self.values.size,) * 2, order="F")
        P[np.ix_(rows, rows)] = P_known
        P[np.ix_(own_rows, rows)] = cross
        P[np.ix_(rows, own_rows)] = cross.T
        P[np.ix_(own_rows, own_rows)] = self.covariance + cross[:, leading:] @ self.gain.T
        return JointState(
            later.layout,
            later.camera,
            P,
            later.model,
            later.predicted,
            blocks,
            self.first,
            self.ids,
            self.parameter_block,
            self.anchor_block,
        )


def regression(P: FloatArray, scale: FloatArray, own: IntArray, common: IntArray) -> tuple[FloatArray, FloatArray]:
    """Gain and covariance of the rows `own` given the rows `common` of a Gaussian.

    Common rows may depend on each other (an anchor is a copy of a camera position): the pivoted Cholesky factor takes
    rows in the order of what they add, and leaves out those that add nothing.

    Parameters
    ----------
    P : (n, n)
        Joint covariance, lower triangle.
    scale : (n,)
        Standard deviations beside which `NEGLIGIBLE` is to be judged.
    own, common : (a,), (c,) int64
        Rows of P, ascending.

    Returns
    -------
    gain : (a, c) ndarray
        P_ac P_cc^-1.
    covariance : (a, a) ndarray
        P_aa - P_ac P_cc^-1 P_ca.
    """
    unit_own, unit_common = 1.0 / scale[own], 1.0 / scale[common]
    among = symmetric.keep(P, common) * unit_common[:, None] * unit_common
    factor, pivots, rank, _ = lapack.dpstrf(np.asfortranarray(among), tol=NEGLIGIBLE, lower=1, overwrite_a=1)
    telling, L = pivots[:rank] - 1, factor[:rank, :rank]
    mine = symmetric.rows(P, own) * unit_own[:, None]
    cross = np.asfortranarray(mine[:, common[telling]] * unit_common[telling])
    whitened = blas.dtrsm(1.0, L, cross, side=1, lower=1, trans_a=1, overwrite_b=1)
    covariance = mine[:, own] * unit_own - whitened @ whitened.T
    negligible = covariance.diagonal() <= NEGLIGIBLE
    covariance[negligible] = covariance[:, negligible] = 0.0
    gain = np.zeros((len(own), len(common)))
    gain[:, telling] = blas.dtrsm(1.0, L, whitened, side=1, lower=1, overwrite_b=1)
    return gain * unit_common / unit_own[:, None], covariance / unit_own[:, None] / unit_own


def units(P: FloatArray) -> FloatArray:
    """Standard deviations of all rows, 1 where there is no variance; (n, n) -> (n,)."""
    variances = P.diagonal()
    scale: FloatArray = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    return scale
