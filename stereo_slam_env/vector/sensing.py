"""Kernels of the landmark sensor: what is in view and not hidden, what is tracked, and its noise."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from filters.validation import FloatArray, IntArray
from stereo_slam_env.vector.motion import CHOICE, NOISE, back, rotation_of
from stereo_slam_env.vector.state import Fleet, Outcome, Rules
from stereo_slam_env.world.rays import KERNEL, is_seen

_FEW = 8
"""Up to so many landmarks are found by scanning all candidates for the least key, more by sorting them."""


@njit(**KERNEL)
def in_view(rules: Rules, landmarks: FloatArray, count: int, pose: FloatArray, uvd: FloatArray, seen: IntArray) -> int:
    """Landmarks within range and inside both images, ascending, into `seen`, their (u, v, d) into `uvd`; how many."""
    fx, fy, cx, cy, scale, _, width, height = rules.camera
    nearest, farthest, margin = rules.limits
    R, found = rotation_of(pose), 0
    for i in range(count):
        x, y, z = back(R, landmarks[i, 0] - pose[0], landmarks[i, 1] - pose[1], landmarks[i, 2] - pose[2])
        if z < nearest or z > farthest:
            continue
        u, v, d = fx * x / z + cx, fy * y / z + cy, scale / z
        right, last = u - d, width - 1.0 - margin
        if u < margin or u > last or right < margin or right > last or v < margin or v > height - 1.0 - margin:
            continue
        seen[found] = i
        uvd[found, 0], uvd[found, 1], uvd[found, 2] = u, v, d
        found += 1
    return found


@njit(**KERNEL)
def is_visible(rules: Rules, fleet: Fleet, waiting: IntArray, b: int, landmark: int) -> bool:
    """Whether nothing hides a landmark from both cameras; in the scene frame, as the solids are."""
    pose, point = fleet.pose[b], fleet.landmarks[b, landmark]
    R, baseline, height = rotation_of(pose), rules.camera[5], rules.camera_height
    nodes, solids, bounds, links = fleet.sizes[b, 1], fleet.solids[b], fleet.bounds[b], fleet.links[b]
    x, y, z = point[2], -point[0], height - point[1]
    for side in range(2):
        away = side * baseline
        c0, c1, c2 = pose[0] + away * R[0], pose[1] + away * R[3], pose[2] + away * R[6]
        if not is_seen(solids, bounds, links, nodes, waiting, c2, -c0, height - c1, x, y, z):
            return False
    return True


@njit(**KERNEL)
def observe(
    rules: Rules,
    fleet: Fleet,
    out: Outcome,
    waiting: IntArray,
    b: int,
    uvd: FloatArray,
    seen: IntArray,
    keys: FloatArray,
) -> None:
    """`LandmarkSensor.observe`: track to this frame and measure. The last three are room for all landmarks."""
    tracked, lost = fleet.tracked[b], fleet.lost[b]
    found = in_view(rules, fleet.landmarks[b], fleet.sizes[b, 0], fleet.pose[b], uvd, seen)
    here, kept = 0, 0
    for i in range(fleet.sizes[b, 0]):
        if here < found and seen[here] == i:
            # Landmarks that were tracked go on if they are visible; keys mark them, and those that may be drawn.
            if tracked[i] and is_visible(rules, fleet, waiting, b, i):
                keys[here] = -1.0
                kept += 1
            else:
                keys[here] = math.inf if tracked[i] or lost[i] else 0.0
                if tracked[i] and not rules.revisit:
                    lost[i] = True
            here += 1
        elif tracked[i] and not rules.revisit:
            lost[i] = True
        tracked[i] = False
    if kept < rules.refill_below:
        used = fleet.used[b, CHOICE]
        for k in range(found):
            if keys[k] == 0.0:
                keys[k] = fleet.exponentials[b, used] / uvd[k, 2]
                used += 1
        fleet.used[b, CHOICE] = used
        draw(rules, fleet, waiting, b, seen, keys, found, rules.most - kept)
    out.ids[b, :] = -1
    count = 0
    for k in range(found):
        if keys[k] == -1.0:
            tracked[seen[k]] = True
            out.ids[b, count] = seen[k]
            for a in range(3):
                out.uvd[b, count, a] = uvd[k, a]
            out.v_right[b, count] = uvd[k, 1]
            count += 1
    out.seen[b] = count
    add_noise(rules, fleet, out, b, count)


@njit(**KERNEL)
def draw(
    rules: Rules, fleet: Fleet, waiting: IntArray, b: int, seen: IntArray, keys: FloatArray, found: int, wanted: int
) -> None:
    """Choose up to `wanted` visible ones of the landmarks with the least keys; the key of a chosen one becomes -1."""
    if wanted > _FEW:
        for k in np.argsort(keys[:found]):
            if wanted == 0 or keys[k] == math.inf:
                return
            if keys[k] >= 0.0 and is_visible(rules, fleet, waiting, b, seen[k]):
                keys[k] = -1.0
                wanted -= 1
        return
    while wanted > 0:
        best, least = -1, math.inf
        for k in range(found):
            if 0.0 <= keys[k] < least:
                best, least = k, keys[k]
        if best < 0:
            return
        if is_visible(rules, fleet, waiting, b, seen[best]):
            keys[best] = -1.0
            wanted -= 1
        else:
            keys[best] = math.inf


@njit(**KERNEL)
def add_noise(rules: Rules, fleet: Fleet, out: Outcome, b: int, count: int) -> None:
    """The noise models of `sensing.pixel_noise` that need only normal numbers."""
    normals, used, sigma = fleet.normals[b, NOISE], fleet.used[b, NOISE], rules.sigma
    if rules.noise == 2:  # u, v, d
        for k in range(count):
            for a in range(3):
                out.uvd[b, k, a] += sigma * normals[used + 3 * k + a]
        fleet.used[b, NOISE] = used + 3 * count
    elif rules.noise < 2:  # u, v of the left image, u, v of the right one
        for k in range(count):
            left, row = sigma * normals[used + k], sigma * normals[used + count + k]
            right, right_row = sigma * normals[used + 2 * count + k], sigma * normals[used + 3 * count + k]
            u, v = out.uvd[b, k, 0] + left, out.uvd[b, k, 1] + row
            d, v_right = out.uvd[b, k, 2] + (left - right), out.v_right[b, k] + right_row
            if rules.noise == 1:  # whole pixels
                d, u, v, v_right = np.rint(u) - np.rint(u - d), np.rint(u), np.rint(v), np.rint(v_right)
            out.uvd[b, k, 0], out.uvd[b, k, 1], out.uvd[b, k, 2], out.v_right[b, k] = u, v, d, v_right
        fleet.used[b, NOISE] = used + 4 * count
