"""Kernels of the error definitions: the corrected state, and the Jacobian that carries P along."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from filters.compiled.covariance import shear, transform_blocks, transform_leading
from filters.compiled.geometry import (
    ANGULAR,
    CALIBRATION,
    CALIBRATIONS,
    LINEAR,
    OPTIONS,
    ORIENTATION,
    POSITION,
    angles_jacobian,
    copy,
    copy_matrix,
    exponential,
    inverse,
    left_jacobian_derivative,
    multiply,
    ray,
    right_jacobian,
    rotation,
    skew,
    turn_quaternion,
)
from filters.retractions import additive_transport_of
from filters.validation import FloatArray, IntArray

QUATERNION, SO3, FIRST_ESTIMATES, RIGHT_INVARIANT, INVARIANT = range(5)
"""Error definitions; the last is that of both sides with the full Jacobian, the one before it has no reset."""
_additive_transport_of = njit(**OPTIONS)(additive_transport_of)


@njit(**OPTIONS)
def _point(old: FloatArray, delta: FloatArray, spread: FloatArray, new: FloatArray) -> None:
    """new = old + J_l(theta) delta."""
    for i in range(3):
        new[i] = old[i] + spread[i, 0] * delta[0] + spread[i, 1] * delta[1] + spread[i, 2] * delta[2]


@njit(**OPTIONS)
def _gamma(angles: FloatArray, rays: FloatArray, J: FloatArray, out: FloatArray) -> None:
    """Effect of a rotation of the world on two angles: out (2, 3) = -d angles/d m [m]x."""
    ray(angles[0], angles[1], rays)
    angles_jacobian(rays[0], rays[1], rays[2], J)
    for a in range(2):
        # -g^T [m]x = (m x g)^T
        out[a, 0] = rays[1] * J[a, 2] - rays[2] * J[a, 1]
        out[a, 1] = rays[2] * J[a, 0] - rays[0] * J[a, 2]
        out[a, 2] = rays[0] * J[a, 1] - rays[1] * J[a, 0]


@njit(**OPTIONS)
def _change(before: FloatArray, after: FloatArray, R: FloatArray, out: FloatArray) -> None:
    """out (3, 3) = (after - before) R."""
    for i in range(3):
        x, y, z = after[i, 0] - before[i, 0], after[i, 1] - before[i, 1], after[i, 2] - before[i, 2]
        for j in range(3):
            out[i, j] = x * R[0, j] + y * R[1, j] + z * R[2, j]


@njit(**OPTIONS)
def retract(
    error: int,
    lead: int,
    velocity: int,
    columns: IntArray,
    values: FloatArray,
    blocks: FloatArray,
    landmarks: IntArray,
    count: int,
    delta: FloatArray,
    new_values: FloatArray,
    new_blocks: FloatArray,
    leading: FloatArray,
    own: FloatArray,
    by_rotation: FloatArray,
) -> None:
    """`ErrorDefinition.moved` and `transport`.

    new_values and new_blocks are the corrected state; leading (lead, lead), own (B, 3, 3) and by_rotation (3, n) the
    Jacobian, own only for INVARIANT, by_rotation only for that and RIGHT_INVARIANT.
    """
    phi = delta[3:6]
    copy(values, new_values)
    for i in range(lead):
        for j in range(lead):
            leading[i, j] = 1.0 if i == j else 0.0
    if error == QUATERNION:
        for i, number in enumerate(_additive_transport_of(phi[0], phi[1], phi[2])):
            leading[3 + i // 3, 3 + i % 3] = number
    elif error != FIRST_ESTIMATES:
        right_jacobian(phi, 1.0, leading[3:6, 3:6])
    turn_quaternion(values[ORIENTATION : ORIENTATION + 4], phi, error == QUATERNION, new_values[ORIENTATION:])
    for c in range(CALIBRATIONS):
        if columns[c] >= 0:
            new_values[CALIBRATION + c] += delta[columns[c]]
    for i in range(3):
        new_values[ANGULAR + i] += delta[velocity + 3 + i]
    if error < RIGHT_INVARIANT:
        for i in range(3):
            new_values[POSITION + i] += delta[i]
            new_values[LINEAR + i] += delta[velocity + i]
        for b in range(len(blocks)):
            for i in range(3):
                new_blocks[b, i] = blocks[b, i] + delta[lead + 3 * b + i]
        return

    R, theta, turn, spread = np.empty((3, 3)), np.zeros(3), np.empty((3, 3)), np.empty((3, 3))
    rotation(values[ORIENTATION:], R)
    for i in range(3):
        for j in range(3):
            theta[i] += R[i, j] * phi[j]
    exponential(theta, turn)
    right_jacobian(theta, -1.0, spread)
    _point(values[POSITION:], delta[0:3], spread, new_values[POSITION:])
    _point(values[LINEAR:], delta[velocity : velocity + 3], spread, new_values[LINEAR:])
    rays, J, gamma = np.empty(9), np.empty((2, 3)), np.empty((2, 3))
    slope, by_theta = np.empty((3, 3)), np.empty((3, 3))
    for b in range(len(blocks)):
        row = lead + 3 * b
        _point(blocks[b], delta[row : row + 3], spread, new_blocks[b])
        if error == INVARIANT:
            copy_matrix(spread, own[b])
            left_jacobian_derivative(theta, delta[row : row + 3], slope)
            multiply(slope, R, by_theta)
            for i in range(3):
                for j in range(3):
                    by_rotation[j, row + i] = by_theta[i, j]
    m = np.empty(3)
    for k in range(count):
        if landmarks[k, 2] < 0:
            continue
        b = landmarks[k, 1]
        row = lead + 3 * b
        _gamma(blocks[b], rays, J, gamma)
        corrected0, corrected1 = blocks[b, 0] + delta[row], blocks[b, 1] + delta[row + 1]
        for j in range(3):
            corrected0 -= gamma[0, j] * theta[j]
            corrected1 -= gamma[1, j] * theta[j]
        ray(corrected0, corrected1, rays)
        for i in range(3):
            m[i] = turn[i, 0] * rays[0] + turn[i, 1] * rays[1] + turn[i, 2] * rays[2]
        new_blocks[b, 0] = math.atan2(m[0], m[2])
        new_blocks[b, 1] = math.atan2(-m[1], math.hypot(m[0], m[2]))
        new_blocks[b, 2] = blocks[b, 2] + delta[row + 2]
        if error == INVARIANT:
            angles_jacobian(m[0], m[1], m[2], J)
            for a in range(2):
                g0 = J[a, 0] * turn[0, 0] + J[a, 1] * turn[1, 0] + J[a, 2] * turn[2, 0]
                g1 = J[a, 0] * turn[0, 1] + J[a, 1] * turn[1, 1] + J[a, 2] * turn[2, 1]
                g2 = J[a, 0] * turn[0, 2] + J[a, 1] * turn[1, 2] + J[a, 2] * turn[2, 2]
                own[b, a, 0] = g0 * rays[3] + g1 * rays[4] + g2 * rays[5]
                own[b, a, 1] = g0 * rays[6] + g1 * rays[7] + g2 * rays[8]
                own[b, a, 2] = 0.0
                own[b, 2, a] = 0.0
                # by theta: (m x g)^T J_l(theta) - own Gamma
                c0 = m[1] * J[a, 2] - m[2] * J[a, 1]
                c1 = m[2] * J[a, 0] - m[0] * J[a, 2]
                c2 = m[0] * J[a, 1] - m[1] * J[a, 0]
                for j in range(3):
                    slope[a, j] = c0 * spread[0, j] + c1 * spread[1, j] + c2 * spread[2, j]
                    slope[a, j] -= own[b, a, 0] * gamma[0, j] + own[b, a, 1] * gamma[1, j]
            own[b, 2, 2] = 1.0
            for j in range(3):
                slope[2, j] = 0.0
            multiply(slope, R, by_theta)
            for i in range(3):
                for j in range(3):
                    by_rotation[j, row + i] = by_theta[i, j]
    if error == INVARIANT:
        for place in (0, velocity):
            for i in range(3):
                for j in range(3):
                    leading[place + i, place + j] = spread[i, j]
            left_jacobian_derivative(theta, delta[place : place + 3], slope)
            multiply(slope, R, by_theta)
            for i in range(3):
                for j in range(3):
                    leading[place + i, 3 + j] = by_theta[i, j]
    else:
        # (Gamma+ - Gamma) R on the rotation columns
        before, after = np.empty((3, 3)), np.empty((3, 3))
        for place, value in ((0, POSITION), (velocity, LINEAR)):
            skew(values[value:], -1.0, before)
            skew(new_values[value:], -1.0, after)
            _change(before, after, R, by_theta)
            for i in range(3):
                for j in range(3):
                    leading[place + i, 3 + j] = by_theta[i, j]
        rotation(new_values[ORIENTATION:], after)
        for i in range(3):
            for j in range(3):
                by_theta[i, j] = after[0, i] * R[0, j] + after[1, i] * R[1, j] + after[2, i] * R[2, j]
        for i in range(3):
            for j in range(3):
                leading[3 + i, 3 + j] = by_theta[i, j]
        for b in range(len(blocks)):
            skew(blocks[b], -1.0, before)
            skew(new_blocks[b], -1.0, after)
            _change(before, after, R, by_theta)
            for i in range(3):
                for j in range(3):
                    by_rotation[j, lead + 3 * b + i] = by_theta[i, j]
        for k in range(count):
            if landmarks[k, 2] >= 0:
                b = landmarks[k, 1]
                for j in range(3):
                    before[2, j] = after[2, j] = 0.0
                _gamma(blocks[b], rays, J, before)
                _gamma(new_blocks[b], rays, J, after)
                _change(before, after, R, by_theta)
                for i in range(3):
                    for j in range(3):
                        by_rotation[j, lead + 3 * b + i] = by_theta[i, j]


@njit(**OPTIONS)
def transport(
    P: FloatArray, n: int, error: int, lead: int, leading: FloatArray, own: FloatArray, by_rotation: FloatArray
) -> None:
    """`Transport.apply`: P carried along with a correction."""
    if error == FIRST_ESTIMATES:
        return
    if error == INVARIANT:
        transform_blocks(P, own, lead, n)
    transform_leading(P, leading, np.zeros((lead, lead)), n)
    if error >= RIGHT_INVARIANT:
        # The rotation error is that at the corrected state by now: W leading[rotation, rotation]^-1.
        back, W = np.empty((3, 3)), np.zeros((3, n))
        inverse(leading[3:6, 3:6], back)
        for j in range(lead, n):
            for i in range(3):
                W[i, j] = (
                    by_rotation[0, j] * back[0, i] + by_rotation[1, j] * back[1, i] + by_rotation[2, j] * back[2, i]
                )
        shear(P, W, 3, n)


@njit(**OPTIONS)
def pull_back(
    error: int,
    lead: int,
    leading: FloatArray,
    own: FloatArray,
    by_rotation: FloatArray,
    delta: FloatArray,
    innovation: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
) -> None:
    """`Transport.pulled_back`: the measurements, in place, linear in the errors before the correction delta."""
    count, size, width = by_map.shape
    columns = by_leading.shape[2]
    row = np.empty(columns)
    three = np.empty(3)
    for m in range(count):
        for a in range(size):
            for c in range(columns):
                row[c] = 0.0
                for k in range(columns):
                    row[c] += by_leading[m, a, k] * leading[k, c]
            for block in range(width // 3):
                place = map_rows[m, block]
                if error >= RIGHT_INVARIANT:
                    for j in range(3):
                        for i in range(3):
                            row[3 + j] += by_map[m, a, 3 * block + i] * by_rotation[j, place + i]
                if error == INVARIANT:
                    D = own[(place - lead) // 3]
                    for j in range(3):
                        three[j] = 0.0
                        for i in range(3):
                            three[j] += by_map[m, a, 3 * block + i] * D[i, j]
                    for j in range(3):
                        by_map[m, a, 3 * block + j] = three[j]
            for c in range(columns):
                by_leading[m, a, c] = row[c]
                innovation[m, a] += row[c] * delta[c]
            for block in range(width // 3):
                for i in range(3):
                    innovation[m, a] += by_map[m, a, 3 * block + i] * delta[map_rows[m, block] + i]
