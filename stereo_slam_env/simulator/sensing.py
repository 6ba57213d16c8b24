"""Kernels of the landmark sensor: what is in view, not hidden and tracked, its noise; random numbers drawn ahead."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.rotations import Three
from filters.kernels.compilation import kernel
from stereo_slam_env.simulator.motion import CHOICE, NOISE, back, rotation_of
from stereo_slam_env.simulator.rays import is_seen
from stereo_slam_env.simulator.scene_arrays import Bodies, bodies_of, is_behind_body, is_present
from stereo_slam_env.simulator.state import Fleet, Kept, Rules, Sensed


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


@kernel(fastmath={"contract", "nnan"})
def mark_in_view(rules: Rules, landmarks: FloatArray, count: int, pose: FloatArray, inside: NDArray[np.uint8]) -> None:
    """Mask of landmarks (3, N) within range and inside both images; without branches, for vector instructions."""
    fx, fy, cx, cy, scale, _, width, height = rules.camera
    nearest, farthest, margin = rules.limits
    left, right, top, bottom = cx - margin, width - 1.0 - margin - cx, cy - margin, height - 1.0 - margin - cy
    R, x, y, z = rotation_of(pose), landmarks[0], landmarks[1], landmarks[2]
    p0, p1, p2 = pose[0], pose[1], pose[2]
    for i in range(count):
        a, b, c = x[i] - p0, y[i] - p1, z[i] - p2
        depth = R[2] * a + R[5] * b + R[8] * c
        # Pixels from the centre, times the depth.
        u, v = fx * (R[0] * a + R[3] * b + R[6] * c), fy * (R[1] * a + R[4] * b + R[7] * c)
        inside[i] = (
            (depth >= nearest)
            & (depth <= farthest)
            & (u + left * depth >= 0.0)
            & (u - right * depth <= 0.0)
            & (u - scale + left * depth >= 0.0)
            & (u - scale - right * depth <= 0.0)
            & (v + top * depth >= 0.0)
            & (v - bottom * depth <= 0.0)
        )


class RowView(NamedTuple):
    """Surroundings of the cameras of one row, in the scene frame, as the solids are."""

    exact: bool
    seen: BoolArray
    height: float
    left: Three
    right: Three
    points: FloatArray
    """Landmarks, (3, L), in W."""
    solids: FloatArray
    bounds: NDArray[np.float32]
    links: IntArray
    nodes: int
    bodies: Bodies


@kernel
def view_of(rules: Rules, fleet: Fleet, b: int) -> RowView:
    """Solids around the cameras of a row."""
    pose, baseline, height = fleet.pose[b], rules.camera[5], rules.camera_height
    R = rotation_of(pose)
    left = (pose[2], -pose[0], height - pose[1])
    right = (pose[2] + baseline * R[6], -pose[0] - baseline * R[0], height - pose[1] - baseline * R[3])
    solids, bounds, links, nodes = fleet.solids[b], fleet.bounds[b], fleet.links[b], fleet.sizes[b, 1]
    bodies, points = bodies_of(fleet, b), fleet.landmarks[b]
    return RowView(rules.exact, fleet.seen[b], height, left, right, points, solids, bounds, links, nodes, bodies)


@kernel(forceinline=True)  # called for each landmark, and its arguments are many
def is_visible(around: RowView, waiting: IntArray, landmark: int) -> bool:
    """Whether nothing hides a landmark from both cameras."""
    if not around.exact:
        return bool(around.seen[landmark])
    points, left, right = around.points, around.left, around.right
    to = (points[2, landmark], -points[0, landmark], around.height - points[1, landmark])
    if not is_seen(around.solids, around.bounds, around.links, around.nodes, waiting, left, right, to):
        return False
    return around.bodies.number == 0 or not is_behind_body(around.bodies, left, right, to)


_TRACKED = 2
"""Mark in `Fleet.inside` of a landmark on a moving body that is tracked in this frame."""


@kernel
def hide_far_sides(rules: Rules, fleet: Fleet, b: int) -> None:
    """Take landmarks on moving bodies whose surface is turned away from a camera out of `fleet.inside`.

    So are those on bodies that come or go in this step.
    """
    around, first = view_of(rules, fleet, b), fleet.sizes[b, 0]
    points, inside = around.points, fleet.inside[b]
    for q in range(fleet.sizes[b, 4]):
        i, point = first + q, fleet.surface[b, q]
        if inside[i] == 1:
            m = int(point[6])
            if not is_present(fleet, b, m):
                inside[i] = 0
            at = fleet.tracks[b, m, min(fleet.step[b], fleet.shares[b, m, 2] - 1)]
            x, y, z = at[3] * point[3] - at[4] * point[4], at[4] * point[3] + at[3] * point[4], point[5]
            to = (points[2, i], -points[0, i], around.height - points[1, i])
            for eye in (around.left, around.right):
                if (eye[0] - to[0]) * x + (eye[1] - to[1]) * y + (eye[2] - to[2]) * z <= 0.0:
                    inside[i] = 0


@kernel
def track_bodies(
    rules: Rules, fleet: Fleet, around: RowView, waiting: IntArray, b: int, ids: IntArray, number: int
) -> int:
    """Fill up what is tracked of each moving body, append all of it to the first `number` ids, and count these."""
    inside, first = fleet.inside[b], fleet.sizes[b, 0]
    for m in range(fleet.sizes[b, 2]):
        start, end, missing_count = first + fleet.shares[b, m, 3], first + fleet.shares[b, m, 4], fleet.shares[b, m, 5]
        for i in range(start, end):
            missing_count -= inside[i] == _TRACKED
        for i in range(start, end):
            if missing_count > 0 and inside[i] == 1 and not fleet.lost[b, i] and is_visible(around, waiting, i):
                inside[i] = _TRACKED
                missing_count -= 1
            if inside[i] == _TRACKED and number < rules.room:
                ids[number] = i
                number += 1
    return number


@kernel
def observe(
    rules: Rules, fleet: Fleet, sensed: Sensed, waiting: IntArray, b: int, fresh: IntArray, keys: FloatArray
) -> None:
    """Track landmarks to this frame and measure them; `fleet.inside` says which are in view.

    A landmark is kept as long as both cameras see it. New ones are drawn with a probability proportional to their
    disparity: sorting by exponential variates over the weights is that draw, and only as many as needed are tested by
    rays. The last two arguments are room for all landmarks.
    """
    count, points, pose, ids = fleet.sizes[b, 0], fleet.landmarks[b], fleet.pose[b], sensed.ids[b]
    inside, kept_count, around = fleet.inside[b], 0, view_of(rules, fleet, b)
    for k in range(sensed.number[b]):
        landmark = ids[k]
        is_kept = inside[landmark] == 1 and is_visible(around, waiting, landmark)
        inside[landmark] = 0  # those that were tracked are not drawn
        if is_kept and landmark >= count:
            inside[landmark] = _TRACKED
        elif is_kept:
            ids[kept_count] = landmark
            kept_count += 1
        elif not rules.revisit:
            fleet.lost[b, landmark] = True
    if kept_count < rules.refill_below:
        R, used, number = rotation_of(pose), fleet.used[b, CHOICE], 0
        for i in range(count):
            if inside[i] == 1 and not fleet.lost[b, i]:
                _, _, z = back(R, points[0, i] - pose[0], points[1, i] - pose[1], points[2, i] - pose[2])
                fresh[number] = i
                keys[number] = fleet.exponentials[b, used + number] * z  # over the disparity, but for a factor
                number += 1
        fleet.used[b, CHOICE] = used + number
        wanted_count = rules.most - kept_count
        drawn = draw(around, waiting, fresh[:number], keys[:number], wanted_count, ids[kept_count:])
        kept_count += drawn
        for k in range(kept_count - drawn, kept_count):  # into those that are tracked, which are in order
            drawn_id, place = ids[k], k
            while place > 0 and ids[place - 1] > drawn_id:
                ids[place] = ids[place - 1]
                place -= 1
            ids[place] = drawn_id
    standing_count = kept_count
    if fleet.sizes[b, 4] > 0:
        kept_count = track_bodies(rules, fleet, around, waiting, b, ids, kept_count)
    ids[kept_count:] = -1
    sensed.number[b], sensed.moving[b] = kept_count, kept_count - standing_count
    project(rules, fleet, sensed, b, kept_count)
    if rules.lasting[0] > 0.0:
        add_lasting_errors(rules, fleet, sensed, b, kept_count)
    add_noise(rules, fleet, sensed, b, kept_count)


@kernel
def draw(
    around: RowView,
    waiting: IntArray,
    fresh: IntArray,
    keys: FloatArray,
    wanted: int,
    drawn: IntArray,
) -> int:
    """Put up to `wanted` visible ones of the landmarks with the least keys into `drawn`; how many."""
    left, number = len(keys), 0
    for k in range(left // 2 - 1, -1, -1):
        _sift_down(keys, fresh, k, left)
    while left > 0 and number < wanted:
        if is_visible(around, waiting, fresh[0]):
            drawn[number] = fresh[0]
            number += 1
        left -= 1
        keys[0], fresh[0] = keys[left], fresh[left]
        _sift_down(keys, fresh, 0, left)
    return number


@kernel
def _sift_down(keys: FloatArray, values: IntArray, place: int, count: int) -> None:
    """Restore the heap of `count` keys, the least one first, below a place; values move with their keys."""
    key, value = keys[place], values[place]
    while True:
        child = 2 * place + 1
        if child + 1 < count and keys[child + 1] < keys[child]:
            child += 1
        if child >= count or keys[child] >= key:
            break
        keys[place], values[place] = keys[child], values[child]
        place = child
    keys[place], values[place] = key, value


@kernel
def project(rules: Rules, fleet: Fleet, sensed: Sensed, b: int, count: int) -> None:
    """True (u, v, d) of the tracked landmarks, and the row in the right image."""
    fx, fy, cx, cy, scale, _, _, _ = rules.camera
    points, pose = fleet.landmarks[b], fleet.pose[b]
    R = rotation_of(pose)
    for k in range(count):
        i = sensed.ids[b, k]
        x, y, z = back(R, points[0, i] - pose[0], points[1, i] - pose[1], points[2, i] - pose[2])
        u, v, d = fx * x / z + cx, fy * y / z + cy, scale / z
        sensed.uvd[b, k, 0], sensed.uvd[b, k, 1], sensed.uvd[b, k, 2], sensed.v_right[b, k] = u, v, d, v


@kernel
def add_lasting_errors(rules: Rules, fleet: Fleet, sensed: Sensed, b: int, count: int) -> None:
    """Errors of each landmark that last: a Gauss-Markov process of first order in each coordinate of both images.

    It is drawn from its stationary distribution when the landmark is first measured, and goes on over the frames in
    which it is not.
    """
    sigma, left_after_frame = rules.lasting
    normals, used, errors = fleet.normals[b, NOISE], fleet.used[b, NOISE], fleet.lasting[b]
    for k in range(count):
        i = sensed.ids[b, k]
        since = fleet.step[b] - fleet.measured_at[b, i]
        share_left = left_after_frame**since if fleet.measured_at[b, i] >= 0 else 0.0
        fresh = math.sqrt(1.0 - share_left * share_left)
        for a in range(4):
            errors[i, a] = share_left * errors[i, a] + fresh * normals[used + 4 * k + a]
        fleet.measured_at[b, i] = fleet.step[b]
        sensed.uvd[b, k, 0] += sigma * errors[i, 0]
        sensed.uvd[b, k, 1] += sigma * errors[i, 1]
        sensed.uvd[b, k, 2] += sigma * (errors[i, 0] - errors[i, 2])
        sensed.v_right[b, k] += sigma * errors[i, 3]
    fleet.used[b, NOISE] = used + 4 * count


@kernel
def add_noise(rules: Rules, fleet: Fleet, sensed: Sensed, b: int, count: int) -> None:
    """The noise models of `sensing.pixel_noise` that need only normal numbers."""
    normals, used, sigma = fleet.normals[b, NOISE], fleet.used[b, NOISE], rules.sigma
    if rules.noise == 2:  # u, v, d
        for k in range(count):
            for a in range(3):
                sensed.uvd[b, k, a] += sigma * normals[used + 3 * k + a]
        fleet.used[b, NOISE] = used + 3 * count
    elif rules.noise < 2:  # u, v of the left image, u, v of the right one
        for k in range(count):
            left, row = sigma * normals[used + k], sigma * normals[used + count + k]
            right, right_row = sigma * normals[used + 2 * count + k], sigma * normals[used + 3 * count + k]
            u, v = sensed.uvd[b, k, 0] + left, sensed.uvd[b, k, 1] + row
            d, v_right = sensed.uvd[b, k, 2] + (left - right), sensed.v_right[b, k] + right_row
            if rules.noise == 1:  # whole pixels
                d, u, v, v_right = np.rint(u) - np.rint(u - d), np.rint(u), np.rint(v), np.rint(v_right)
            sensed.uvd[b, k, 0], sensed.uvd[b, k, 1], sensed.uvd[b, k, 2], sensed.v_right[b, k] = u, v, d, v_right
        fleet.used[b, NOISE] = used + 4 * count
