"""Kernels of H: landmarks as the camera sees them, the numbers of the sensor there, and the chain rule through both."""

from __future__ import annotations

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.vectors import times, transposed
from filters.kernels.blas import kernel
from filters.kernels.calls import Calls, call, unit
from filters.kernels.covariance import clear, orientation
from filters.kernels.recipe import Plan
from filters.kernels.records import BLOCKS, LANDMARKS, OWN, POINT, Scratch, Storage


@kernel
def clear_all(arrays: FloatArray, count: int) -> None:
    """The first `count` matrices are zero."""
    for i in range(count):
        for j in range(arrays.shape[1]):
            for k in range(arrays.shape[2]):
                arrays[i, j, k] = 0.0


@kernel
def take_variables(plan: Plan, x: FloatArray, s: Scratch) -> None:
    """Values that the sensor depends on: of its variables, then perhaps the velocity as the camera feels it."""
    count = len(plan.sensed)
    for i in range(count):
        s.sensed[i] = x[plan.sensed[i]]
    if plan.sees_velocity:
        v = plan.velocity + 1
        a, b, c = times(transposed(orientation(x)), x[v], x[v + 1], x[v + 2])
        s.sensed[count], s.sensed[count + 1], s.sensed[count + 2] = a, b, c
        for i in range(3):
            s.sensed[count + 3 + i] = x[v + 3 + i]


@kernel
def by_velocity(plan: Plan, x: FloatArray, H: FloatArray) -> None:
    """A row by rotation and velocity, where H has the Jacobian by the velocity as the camera feels it."""
    v = plan.velocity
    R = orientation(x)
    c0, c1, c2 = times(transposed(R), x[v + 1], x[v + 2], x[v + 3])
    g0, g1, g2 = H[v], H[v + 1], H[v + 2]
    H[3] += g1 * c2 - g2 * c1
    H[4] += g2 * c0 - g0 * c2
    H[5] += g0 * c1 - g1 * c0
    H[v], H[v + 1], H[v + 2] = times(R, g0, g1, g2)


@kernel
def take_homogeneous(calls: Calls, plan: Plan, s: Scratch, values: FloatArray, count: int) -> None:
    """Homogeneous points of landmarks of these values, from their anchors, and the Jacobians by their errors."""
    clear_all(s.by_own, count)
    clear(s.points[:count])
    call(calls.point, (plan.landmark, values[:count], s.points[:count], s.by_own[:count]))


@kernel
def take_points(calls: Calls, plan: Plan, blocks: FloatArray, kind: IntArray, s: Scratch, count: int) -> None:
    """Homogeneous points and Jacobians of the landmarks whose blocks are in `taken`."""
    for i in range(count):
        for a in range(s.values_taken.shape[1]):
            s.values_taken[i, a] = blocks[s.taken[i], a]
    take_homogeneous(calls, plan, s, s.values_taken, count)
    if plan.changes:  # some have become points of W
        for i in range(count):
            if kind[s.taken[i]] == POINT:
                point, J = s.points[i], s.by_own[i]
                for a in range(4):
                    point[a] = s.values_taken[i, a] if a < 3 else 1.0
                    for k in range(3):
                        J[a, k] = 1.0 if a == k else 0.0


@kernel
def sense(calls: Calls, plan: Plan, s: Scratch, points: FloatArray, count: int) -> None:
    """Numbers of the sensor at points in the camera frame, and their Jacobians."""
    clear_all(s.by_point, count)
    clear_all(s.by_values, count)
    clear(s.numbers[:count])
    for i in range(count):
        s.in_front[i] = False
    written = s.numbers[:count], s.by_point[:count], s.by_values[:count], s.in_front[:count]
    call(calls.project, (plan.sensor, plan.camera, points[:count], s.sensed, *written))


@kernel
def from_camera(plan: Plan, x: FloatArray, blocks: FloatArray, anchor: int) -> tuple[float, float, float]:
    """Vector from the camera to the anchor, or to the origin of W."""
    if anchor < 0:
        return -x[0], -x[1], -x[2]
    return blocks[anchor, 0] - x[0], blocks[anchor, 1] - x[1], blocks[anchor, 2] - x[2]


@kernel
def see(
    calls: Calls, plan: Plan, x: FloatArray, blocks: FloatArray, S: Storage, b: int, s: Scratch, count: int
) -> None:
    """The selected landmarks in the camera frame, and the numbers of the sensor there."""
    own, anchor = S.own[b], S.anchor[b]
    for i in range(count):
        s.taken[i] = own[s.land[s.select[i]]]
    take_points(calls, plan, blocks, S.kind[b], s, count)
    R_cw = transposed(orientation(x))
    for i in range(count):
        scale = s.points[i, 3]
        d0, d1, d2 = from_camera(plan, x, blocks, anchor[s.land[s.select[i]]])
        w0, w1, w2 = s.points[i, 0] + scale * d0, s.points[i, 1] + scale * d1, s.points[i, 2] + scale * d2
        s.points_c[i, 0], s.points_c[i, 1], s.points_c[i, 2] = times(R_cw, w0, w1, w2)
        for a in range(3, s.points.shape[1]):
            s.points_c[i, a] = s.points[i, a]
    take_variables(plan, x, s)
    sense(calls, plan, s, s.points_c, count)


@kernel
def compare(T: FloatArray, s: Scratch, count: int, size: int) -> None:
    """Innovations `nu` of the selected measurements, and `ahead`: whether the sensor can see them."""
    for i in range(count):
        m = s.select[i]
        s.ahead[m] = s.in_front[i]
        for k in range(size):
            expected = 0.0
            for q in range(s.numbers.shape[1]):
                if T[k, q] != 0.0:
                    expected += T[k, q] * s.numbers[i, q]
            s.nu[m, k] = s.z[m, k] - expected


@kernel
def chain(
    plan: Plan, T: FloatArray, x: FloatArray, blocks: FloatArray, S: Storage, b: int, s: Scratch, count: int, size: int
) -> None:
    """H and first rows of the selected measurements, linearised where `see` has been."""
    measured, values_width = plan.measured, s.by_values.shape[2]
    R = orientation(x)
    for i in range(count):
        m = s.select[i]
        anchor, own = S.anchor[b, s.land[m]], S.own[b, s.land[m]]
        H, J, by_own = s.H[m], s.by_point[i], s.by_own[i]
        h0, h1, h2, scale = s.points_c[i, 0], s.points_c[i, 1], s.points_c[i, 2], s.points_c[i, 3]
        d0, d1, d2 = from_camera(plan, x, blocks, anchor)
        s.base[m, 0] = plan.leading + plan.size * (anchor if anchor >= 0 else own)
        s.base[m, 1] = plan.leading + plan.size * own
        for k in range(size):
            c0, c1, c2, by_scale = 0.0, 0.0, 0.0, 0.0
            for j in range(values_width):
                H[k, 6 + j] = 0.0
            for q in range(J.shape[0]):
                t = T[k, q]
                if t != 0.0:
                    c0, c1, c2, by_scale = c0 + t * J[q, 0], c1 + t * J[q, 1], c2 + t * J[q, 2], by_scale + t * J[q, 3]
                    for j in range(values_width):
                        H[k, 6 + j] += t * s.by_values[i, q, j]
            g0, g1, g2 = times(R, c0, c1, c2)
            # c^T [h]x = (c x h)^T
            H[k, 3], H[k, 4], H[k, 5] = c1 * h2 - c2 * h1, c2 * h0 - c0 * h2, c0 * h1 - c1 * h0
            H[k, 0], H[k, 1], H[k, 2] = -scale * g0, -scale * g1, -scale * g2
            if plan.sees_velocity:
                by_velocity(plan, x, H[k])
            first = measured
            if plan.anchors > 0:
                way = scale if anchor >= 0 else 0.0
                H[k, first], H[k, first + 1], H[k, first + 2] = way * g0, way * g1, way * g2
                first += 3
            by_scale += g0 * d0 + g1 * d1 + g2 * d2
            for a in range(3):
                H[k, first + a] = g0 * by_own[0, a] + g1 * by_own[1, a] + g2 * by_own[2, a] + by_scale * by_own[3, a]
            for a in range(3, plan.size):  # apart: a loop over three is unrolled
                H[k, first + a] = g0 * by_own[0, a] + g1 * by_own[1, a] + g2 * by_own[2, a] + by_scale * by_own[3, a]
            for e in range(4, J.shape[1]):
                along = 0.0
                for q in range(J.shape[0]):
                    along += T[k, q] * J[q, e]
                for a in range(plan.size):
                    H[k, first + a] += along * by_own[e, a]


@unit("linearise")
def linearise(
    calls: Calls,
    plan: Plan,
    variant: int,
    stage: int,
    S: Storage,
    b: int,
    x: FloatArray,
    blocks: FloatArray,
    s: Scratch,
    count: int,
) -> None:
    """Innovation, H and first rows of the selected measurements, H at the state or at the first estimates.

    Valid afterwards, by measurement: `nu`, `ahead`, `H`, `base`. The rest of the scratch it writes is its own.
    """
    T, size = plan.T[variant, stage], plan.rows[variant, stage, 0]
    if plan.first_estimates:
        point, at = S.predicted[b], s.point_blocks
        for c in range(S.counts[b, BLOCKS]):
            for i in range(blocks.shape[1]):
                at[c, i] = S.first[b, c, i]
        for i in range(S.counts[b, LANDMARKS]):
            if S.kind[b, S.own[b, i]] == OWN:
                for a in plan.follows:
                    at[S.own[b, i], a] = blocks[S.own[b, i], a]
        see(calls, plan, point, at, S, b, s, count)
        chain(plan, T, point, at, S, b, s, count, size)
    see(calls, plan, x, blocks, S, b, s, count)
    compare(T, s, count, size)
    if not plan.first_estimates:
        chain(plan, T, x, blocks, S, b, s, count, size)


@kernel
def expect(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, count: int) -> None:
    """Predicted numbers of the first `count` landmarks of a map, and H of (u, v, d) at the state."""
    for i in range(count):
        s.land[i] = s.select[i] = i
    x, blocks = S.x[b], S.blocks[b]
    see(calls, plan, x, blocks, S, b, s, count)
    chain(plan, plan.T[0, -1], x, blocks, S, b, s, count, 3)


@kernel
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
    """z and its noise for a stage, of `count` measurements of landmarks in the map (`StageRows.of`)."""
    size, right_row, apart = plan.rows[variant, stage]
    T = plan.T_uvd[variant, stage]
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
                if len(plan.sigma_points) > 0:
                    s.added[m, a, b] = 0.0
        if right_row >= 0:
            s.z[m, right_row] = v_right[i]
        if apart >= 0:
            apart_variance = s.R[m, apart, apart] * plan.apart_scale[variant, stage]
            for a in range(size):
                s.R[m, apart, a] = s.R[m, a, apart] = 0.0
            s.R[m, apart, apart] = apart_variance
