"""Random numbers of B rows: those of their generators, drawn ahead in blocks, as the kernels need them."""

from __future__ import annotations

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.simulator.motion import CHOICE
from stereo_slam_env.simulator.state import Fleet, Kept


class Streams(Kept):
    """Four streams for each row: of the motion, the odometry, the noise, and the choice of landmarks.

    Parameters
    ----------
    count : int
        Number of rows.
    needed : (4,)
        Most numbers of each stream that a frame can use.
    """

    changes = ("needed", "_generators")

    def __init__(self, count: int, needed: IntArray) -> None:
        self.needed = needed
        self._generators: list[list[np.random.Generator]] = [[] for _ in range(count)]

    def begin(self, fleet: Fleet, b: int, generators: list[np.random.Generator]) -> None:
        """Use other generators from now on, in the order of the streams."""
        self._generators[b] = generators
        for stream, generator in enumerate(generators):
            block = _block(fleet, b, stream)
            block[:] = _drawn(generator, stream, len(block))
        fleet.used[b] = 0

    def refill(self, fleet: Fleet, which: BoolArray) -> None:
        """Draw numbers for those that might run out of them in the next frame."""
        size = np.array([fleet.normals.shape[2]] * CHOICE + [fleet.exponentials.shape[1]])
        rows, streams = np.nonzero((fleet.used + self.needed > size) & which[:, None])
        for b, stream in zip(rows.tolist(), streams.tolist(), strict=True):
            block, used = _block(fleet, b, stream), int(fleet.used[b, stream])
            block[: len(block) - used] = block[used:]
            block[len(block) - used :] = _drawn(self._generators[b][stream], stream, used)
            fleet.used[b, stream] = 0


def _block(fleet: Fleet, b: int, stream: int) -> FloatArray:
    block: FloatArray = fleet.exponentials[b] if stream == CHOICE else fleet.normals[b, stream]
    return block


def _drawn(generator: np.random.Generator, stream: int, count: int) -> FloatArray:
    """The next numbers; a generator gives the same ones whether it is asked for all at once or for some at a time."""
    return generator.standard_exponential(count) if stream == CHOICE else generator.standard_normal(count)
