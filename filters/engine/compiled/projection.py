"""Kernels of the prediction of measurements and of its Jacobian, with the calibration of the pair as variables."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from filters.engine.compiled.blas import KERNEL
from filters.engine.compiled.prediction import (
    matrix_of,
    orientation,
    quaternion_of,
    right_jacobian_of,
    times,
    transposed,
)
from filters.engine.compiled.recipe import Plan
from filters.engine.compiled.storage import Scratch
from filters.geometry.rotations import Nine, Three
from filters.validation import FloatArray, IntArray


class View(NamedTuple):
    """Eq. 10 at the values of pose and calibration: a turn from W by R^T, then by E, a projection, an offset of d."""

    R: Nine
    E: Nine
    misalignment: Three
    focal: float
    baseline: float
    scale_u: float
    scale_v: float
    scale_d: float
    offset: float


@njit(**KERNEL)
def view_of(plan: Plan, x: FloatArray) -> View:
    """What the leading variables say; a calibration that is no variable is zero."""
    rows = plan.calibration
    offset = x[rows[0] + 1] if rows[0] >= 0 else 0.0
    focal = 1.0 + (x[rows[1] + 1] if rows[1] >= 0 else 0.0)
    baseline = 1.0 + (x[rows[2] + 1] if rows[2] >= 0 else 0.0)
    x0, x1, x2 = 0.0, 0.0, 0.0
    if rows[3] >= 0:
        x0, x1, x2 = x[rows[3] + 1], x[rows[4] + 1], x[rows[5] + 1]
    q = quaternion_of(x0, x1, x2)
    return View(
        orientation(x),
        matrix_of(q[0], q[1], q[2], q[3]),
        (x0, x1, x2),
        focal,
        baseline,
        focal * plan.fx,
        focal * plan.fy,
        focal * baseline * plan.disparity_constant,
        offset,
    )


@njit(**KERNEL)
def seen_from(
    anchored: bool, x: FloatArray, blocks: FloatArray, anchor: int, own: int
) -> tuple[float, float, float, float]:
    """`LandmarkModel.homogeneous` of one landmark: direction in W from the camera, and scale."""
    if not anchored:
        return blocks[own, 0] - x[0], blocks[own, 1] - x[1], blocks[own, 2] - x[2], 1.0
    theta, phi, rho = blocks[own, 0], blocks[own, 1], blocks[own, 2]
    across = math.cos(phi)
    return (
        rho * (blocks[anchor, 0] - x[0]) + across * math.sin(theta),
        rho * (blocks[anchor, 1] - x[1]) - math.sin(phi),
        rho * (blocks[anchor, 2] - x[2]) + across * math.cos(theta),
        rho,
    )


@njit(**KERNEL)
def project(
    plan: Plan,
    variant: int,
    stage: int,
    x: FloatArray,
    blocks: FloatArray,
    anchor: IntArray,
    own: IntArray,
    s: Scratch,
    count: int,
) -> None:
    """Innovations of the selected measurements, and whether their rays point forward."""
    size = plan.rows[variant, stage, 0]
    T = plan.T[variant, stage]
    view = view_of(plan, x)
    R_cw = transposed(view.R)
    for i in range(count):
        m = s.select[i]
        a, b, c, rho = seen_from(plan.anchored, x, blocks, anchor[s.land[m]], own[s.land[m]])
        a, b, c = times(R_cw, a, b, c)
        a, b, c = times(view.E, a, b, c)
        s.ahead[m] = c > 0.0
        u, v, d = view.scale_u * a / c + plan.cx, view.scale_v * b / c + plan.cy, view.scale_d * rho / c + view.offset
        for k in range(size):
            s.nu[m, k] = s.z[m, k] - (T[k, 0] * u + T[k, 1] * v + T[k, 2] * d)


@njit(**KERNEL)
def linearise(
    plan: Plan,
    variant: int,
    stage: int,
    x: FloatArray,
    blocks: FloatArray,
    anchor: IntArray,
    own: IntArray,
    s: Scratch,
    count: int,
) -> None:
    """`linearisation.linearise`: innovation, H and first rows of the selected measurements, in the scratch."""
    size, measured = plan.rows[variant, stage, 0], plan.measured
    T = plan.T[variant, stage]
    rows, view = plan.calibration, view_of(plan, x)
    scale_u, scale_v, scale_d = view.scale_u, view.scale_v, view.scale_d
    R_cw, E_back = transposed(view.R), transposed(view.E)
    by_misalignment = right_jacobian_of(*view.misalignment)  # of its transpose, the left one
    for i in range(count):
        m = s.select[i]
        anchor_block, own_block = anchor[s.land[m]], own[s.land[m]]
        H = s.H[m]
        theta, phi, rho = blocks[own_block, 0], blocks[own_block, 1], blocks[own_block, 2]
        sin_theta, cos_theta, sin_phi, cos_phi = 0.0, 0.0, 0.0, 0.0
        off0, off1, off2 = 0.0, 0.0, 0.0
        if plan.anchored:
            sin_theta, cos_theta, sin_phi, cos_phi = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
            off0, off1, off2 = (
                blocks[anchor_block, 0] - x[0],
                blocks[anchor_block, 1] - x[1],
                blocks[anchor_block, 2] - x[2],
            )
            w0 = rho * off0 + cos_phi * sin_theta
            w1 = rho * off1 - sin_phi
            w2 = rho * off2 + cos_phi * cos_theta
            s.base[m, 0] = plan.leading + 3 * anchor_block
        else:
            w0, w1, w2, rho = theta - x[0], phi - x[1], rho - x[2], 1.0
        s.base[m, 1] = plan.leading + 3 * own_block
        h0, h1, h2 = times(R_cw, w0, w1, w2)
        e0, e1, e2 = times(view.E, h0, h1, h2)
        inverse = 1.0 / e2
        s.ahead[m] = e2 > 0.0
        from_centre_u, from_centre_v, d0 = scale_u * e0 * inverse, scale_v * e1 * inverse, scale_d * rho * inverse
        for k in range(size):
            t0, t1, t2 = T[k, 0], T[k, 1], T[k, 2]
            s.nu[m, k] = s.z[m, k] - (
                t0 * (from_centre_u + plan.cx) + t1 * (from_centre_v + plan.cy) + t2 * (d0 + view.offset)
            )
            # z by direction in the projecting frame (f), in the camera frame (c) and in the world (g), and by scale
            by_scale = t2 * scale_d * inverse
            f0, f1 = t0 * scale_u * inverse, t1 * scale_v * inverse
            f2 = -(f0 * e0 + f1 * e1 + by_scale * rho) * inverse
            c0, c1, c2 = times(E_back, f0, f1, f2)
            g0, g1, g2 = times(view.R, c0, c1, c2)
            # c^T [h]x = (c x h)^T
            H[k, 3] = c1 * h2 - c2 * h1
            H[k, 4] = c2 * h0 - c0 * h2
            H[k, 5] = c0 * h1 - c1 * h0
            if measured > 6:
                if rows[0] >= 0:
                    H[k, rows[0]] = t2
                if rows[1] >= 0:
                    H[k, rows[1]] = (t0 * from_centre_u + t1 * from_centre_v + t2 * d0) / view.focal
                if rows[2] >= 0:
                    H[k, rows[2]] = t2 * d0 / view.baseline
                if rows[3] >= 0:
                    r0, r1, r2 = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
                    # row times the left Jacobian = right Jacobian times column
                    r0, r1, r2 = times(by_misalignment, r0, r1, r2)
                    H[k, rows[3]], H[k, rows[4]], H[k, rows[5]] = r0, r1, r2
            by_position = -rho if plan.anchored else -1.0
            H[k, 0], H[k, 1], H[k, 2] = by_position * g0, by_position * g1, by_position * g2
            if plan.anchored:
                H[k, measured], H[k, measured + 1], H[k, measured + 2] = rho * g0, rho * g1, rho * g2
                H[k, measured + 3] = cos_phi * (g0 * cos_theta - g2 * sin_theta)
                H[k, measured + 4] = -sin_phi * (g0 * sin_theta + g2 * cos_theta) - g1 * cos_phi
                H[k, measured + 5] = g0 * off0 + g1 * off1 + g2 * off2 + by_scale
            else:
                H[k, measured], H[k, measured + 1], H[k, measured + 2] = g0, g1, g2


@njit(**KERNEL)
def prepare(
    plan: Plan,
    variant: int,
    stage: int,
    uvd: FloatArray,
    R: FloatArray,
    v_right: FloatArray,
    first: int,
    s: Scratch,
    count: int,
) -> None:
    """z and its noise for a stage, of `count` measurements of landmarks in the map (`MeasurementModel.stages`)."""
    size, right_row, apart = plan.rows[variant, stage]
    T = plan.T[variant, stage]
    for m in range(count):
        i = first + s.place[m]
        noise = R[i]
        for a in range(size):
            s.z[m, a] = T[a, 0] * uvd[i, 0] + T[a, 1] * uvd[i, 1] + T[a, 2] * uvd[i, 2]
            for b in range(size):
                total = 0.0
                for p in range(3):
                    for q in range(3):
                        total += T[a, p] * noise[p, q] * T[b, q]
                s.R[m, a, b] = total
        if right_row >= 0:
            s.z[m, right_row] = v_right[i]
        if apart >= 0:
            own = s.R[m, apart, apart] * plan.apart_scale[variant, stage]
            for a in range(size):
                s.R[m, apart, a] = s.R[m, a, apart] = 0.0
            s.R[m, apart, apart] = own


@njit(**KERNEL)
def take_numbers(z: FloatArray, R: FloatArray, first: int, s: Scratch, count: int) -> None:
    """z and its noise of a stage that is given by numbers."""
    for m in range(count):
        i = first + s.place[m]
        for a in range(z.shape[1]):
            s.z[m, a] = z[i, a]
            for b in range(z.shape[1]):
                s.R[m, a, b] = R[i, a, b]
