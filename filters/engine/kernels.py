"""The loops of a frame for Numba: what NumPy can only do with copies of rows of P and dozens of small calls.

Each function says the same as the NumPy code it stands for (named in its docstring) and is tested against it. All have
fixed signatures, so that they are compiled when this module is imported, or read from Numba's cache on disk, and never
later. Import it through `filters.compilation`.

Landmarks and camera occupy blocks of three rows, and only the lower triangle of P (column-major) is read.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import get_cython_function_address, intrinsic

from filters import rotations
from filters.engine.fates import BEHIND, FAILED, GATED, USED
from filters.engine.retraction import additive_transport_of
from filters.motion import ANGULAR, CAMERA_SIZE, LINEAR, ROTATION
from filters.validation import BoolArray, FloatArray, IntArray

_ROUTINES = (
    get_cython_function_address("scipy.linalg.cython_lapack", "dpotrf"),
    get_cython_function_address("scipy.linalg.cython_blas", "dtrsm"),
    get_cython_function_address("scipy.linalg.cython_blas", "dgemv"),
    get_cython_function_address("scipy.linalg.cython_blas", "dsyrk"),
)
"""Where this process has scipy's BLAS and LAPACK: arguments of the kernels, so that these can be cached on disk."""


def _read(ndim: int, layout: str = "C", dtype: types.Type = types.float64) -> types.Type:
    """An array that is only read."""
    return types.Array(dtype, ndim, layout, readonly=True)


_P = types.Array(types.float64, 2, "F")
_VECTOR, _MATRIX, _MATRICES = _read(1), _read(2), _read(3)
_ANY_MATRIX, _ANY_MATRICES = _read(2, "A"), _read(3, "A")
_INDEX, _ROWS = _read(1, dtype=types.int64), _read(2, dtype=types.int64)
_CAMERA = types.UniTuple(types.float64, 5)
_ADDRESSES = types.UniTuple(types.intp, len(_ROUTINES))
_FLOATS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}  # IEEE, with fused multiply-add
_OPTIONS: dict[str, Any] = {"cache": True, **_FLOATS}
_SEEN = (_CAMERA, _VECTOR, _MATRIX, _MATRIX, _INDEX, _INDEX, types.int64, _INDEX)
_MEASURED = (_MATRIX, _MATRICES, _MATRICES, _ROWS, _ANY_MATRICES)


# ---- calls of BLAS and LAPACK ----


@intrinsic  # type: ignore[misc]
def _call(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call the Fortran subroutine at `address` with pointers to its arguments."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointers = cgutils.unpack_tuple(builder, values[1])
        routine = ir.FunctionType(ir.VoidType(), [pointer.type for pointer in pointers]).as_pointer()
        builder.call(builder.inttoptr(values[0], routine), pointers)
        return context.get_dummy_value()

    return types.void(address, arguments), generate


@njit(inline="always")
def _at(array: Any) -> int:
    """Address of an array's first number."""
    return np.intp(array.ctypes.data)


# ---- linearisation ----


@njit(**_FLOATS)
def _ray(theta: float, phi: float, ray: FloatArray) -> None:
    """`inverse_depth.ray_direction` and its Jacobian by theta and phi, one after the other in `ray` (9,)."""
    sin_theta, cos_theta, sin_phi, cos_phi = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    ray[0], ray[1], ray[2] = cos_phi * sin_theta, -sin_phi, cos_phi * cos_theta
    ray[3], ray[4], ray[5] = cos_phi * cos_theta, 0.0, -cos_phi * sin_theta
    ray[6], ray[7], ray[8] = -sin_phi * sin_theta, -cos_phi, -sin_phi * cos_theta


@njit(**_FLOATS)
def _seen(
    position: FloatArray, blocks: FloatArray, anchor: int, parameter: int, ray: FloatArray, seen: FloatArray
) -> None:
    """`LandmarkModel.homogeneous` of one landmark, and its anchor relative to the camera, in `seen` (7,)."""
    if anchor < 0:  # Euclidean
        for i in range(3):
            seen[i] = blocks[parameter, i] - position[i]
        seen[3] = 1.0
        return
    rho = blocks[parameter, 2]
    _ray(blocks[parameter, 0], blocks[parameter, 1], ray)
    for i in range(3):
        seen[4 + i] = blocks[anchor, i] - position[i]
        seen[i] = rho * seen[4 + i] + ray[i]
    seen[3] = rho


@njit(
    types.Tuple(
        (
            types.float64[:, ::1],
            types.float64[:, :, ::1],
            types.float64[:, :, ::1],
            types.int64[:, ::1],
            types.boolean[::1],
        )
    )(*_SEEN, _ANY_MATRIX),
    **_OPTIONS,
)
def linearise(
    camera: tuple[float, float, float, float, float],
    position: FloatArray,
    R_wc: FloatArray,
    blocks: FloatArray,
    anchors: IntArray,
    parameters: IntArray,
    width: int,
    index: IntArray,
    T: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, BoolArray]:
    """`linearisation.linearise` and `in_front`.

    Returns predicted z (M, k), H by camera (M, k, 6) and by map (M, k, w), rows of the map (M, w), ahead (M,).
    """
    fx, fy, cx, cy, disparity_constant = camera
    count, size = len(index), len(T)
    predicted = np.empty((count, size))
    by_camera = np.empty((count, size, 6))
    by_map = np.empty((count, size, width))
    rows, ahead = np.empty((count, width), np.int64), np.empty(count, np.bool_)
    ray, seen, h, uvd, g = np.empty(9), np.empty(7), np.empty(3), np.empty(3), np.empty(3)
    for m in range(count):
        anchor, parameter = anchors[index[m]], parameters[index[m]]
        _seen(position, blocks, anchor, parameter, ray, seen)
        for i in range(3):
            h[i] = seen[0] * R_wc[0, i] + seen[1] * R_wc[1, i] + seen[2] * R_wc[2, i]
            rows[m, width - 3 + i] = 12 + 3 * parameter + i
            if anchor >= 0:
                rows[m, i] = 12 + 3 * anchor + i
        rho, inverse_z = seen[3], 1.0 / h[2]
        ahead[m] = h[2] > 0.0
        uvd[0] = fx * h[0] * inverse_z + cx
        uvd[1] = fy * h[1] * inverse_z + cy
        uvd[2] = disparity_constant * rho * inverse_z
        for a in range(size):
            predicted[m, a] = T[a, 0] * uvd[0] + T[a, 1] * uvd[1] + T[a, 2] * uvd[2]
            # z by direction in the camera frame (g_c) and in the world (g), and by scale
            by_scale = T[a, 2] * disparity_constant * inverse_z
            g0, g1 = T[a, 0] * fx * inverse_z, T[a, 1] * fy * inverse_z
            g2 = -(g0 * h[0] + g1 * h[1] + by_scale * rho) * inverse_z
            for i in range(3):
                g[i] = R_wc[i, 0] * g0 + R_wc[i, 1] * g1 + R_wc[i, 2] * g2
            # g_c^T [h]x = (g_c x h)^T
            by_camera[m, a, 3] = g1 * h[2] - g2 * h[1]
            by_camera[m, a, 4] = g2 * h[0] - g0 * h[2]
            by_camera[m, a, 5] = g0 * h[1] - g1 * h[0]
            for i in range(3):
                by_camera[m, a, i] = -g[i] if anchor < 0 else -rho * g[i]
                by_map[m, a, i] = -by_camera[m, a, i]
            if anchor >= 0:
                by_map[m, a, 3] = g[0] * ray[3] + g[1] * ray[4] + g[2] * ray[5]
                by_map[m, a, 4] = g[0] * ray[6] + g[1] * ray[7] + g[2] * ray[8]
                by_map[m, a, 5] = g[0] * seen[4] + g[1] * seen[5] + g[2] * seen[6] + by_scale
    return predicted, by_camera, by_map, rows, ahead


# ---- gate ----


@njit(types.float64[::1](_P, *_MEASURED), **_OPTIONS)
def squared_distances(
    P: FloatArray, innovation: FloatArray, by_camera: FloatArray, by_map: FloatArray, map_rows: IntArray, R: FloatArray
) -> FloatArray:
    """`kalman.squared_distances`: nu^T S^-1 nu of each measurement on its own, by S = L D L^T; (M,)."""
    count, size, width = by_map.shape
    camera = by_camera.shape[2]
    total = camera + width
    rows, covariance = np.arange(total), np.empty((total, total))
    H, HP, S, solved = np.empty((size, total)), np.empty(total), np.empty((size, size)), np.empty(size)
    distances = np.zeros(count)
    for i in range(camera):
        for j in range(i + 1):
            covariance[i, j] = covariance[j, i] = P[i, j]
    for m in range(count):
        rows[camera:] = map_rows[m]
        for i in range(camera, total):
            for j in range(i + 1):
                covariance[i, j] = covariance[j, i] = P[max(rows[i], rows[j]), min(rows[i], rows[j])]
        for a in range(size):
            for c in range(camera):
                H[a, c] = by_camera[m, a, c]
            for c in range(width):
                H[a, camera + c] = by_map[m, a, c]
            HP[:] = 0.0
            for i in range(total):
                for j in range(total):
                    HP[j] += H[a, i] * covariance[i, j]
            for b in range(a + 1):
                S[a, b] = R[m, a, b]
                for c in range(total):
                    S[a, b] += HP[c] * H[b, c]
        for a in range(size):
            solved[a] = innovation[m, a]
            for b in range(a):
                solved[a] -= S[a, b] / S[b, b] * solved[b]
                for c in range(a, size):
                    S[c, a] -= S[c, b] * S[a, b] / S[b, b]
            distances[m] += solved[a] ** 2 / S[a, a]
    return distances


# ---- update ----


@njit(**_FLOATS)
def _take_block(P: FloatArray, first: int, block: FloatArray) -> None:
    """Rows first to first + 2 of the symmetric P, in `block` (3, n or more)."""
    for j in range(first):
        block[0, j], block[1, j], block[2, j] = P[first, j], P[first + 1, j], P[first + 2, j]
    for i in range(3):
        for j in range(first, first + i):
            block[i, j] = P[first + i, j]
        for j in range(first + i, len(P)):
            block[i, j] = P[j, first + i]


@njit(**_FLOATS)
def _add_product(target: FloatArray, H: FloatArray, block: FloatArray, columns: int, add: bool) -> None:
    """target = H block, or target += H block, on the first columns; (k, n or more), (k, 3), (3, n or more)."""
    for row in range(len(H)):
        a, b, c = H[row, 0], H[row, 1], H[row, 2]
        if add:
            for j in range(columns):
                target[row, j] += a * block[0, j] + b * block[1, j] + c * block[2, j]
        else:
            for j in range(columns):
                target[row, j] = a * block[0, j] + b * block[1, j] + c * block[2, j]


@njit(**_FLOATS)
def _take(
    routines: tuple[int, ...],
    letters: IntArray,
    sizes: IntArray,
    signs: FloatArray,
    P: FloatArray,
    delta: FloatArray,
    HP: FloatArray,
    S: FloatArray,
    innovation: FloatArray,
    by_camera: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    first: int,
    last: int,
) -> float:
    """Correct P and delta with the measurements first to last - 1; the NIS, or -1 where S has no Cholesky factor.

    HP has a last column for the innovation, so that one triangular solve does for both. BLAS, which is column-major,
    sees HP transposed and the lower triangle of S. The small arrays are arguments because BLAS wants addresses.
    """
    n, camera = len(P), by_camera.shape[2]
    size, width = by_map.shape[1:]
    rows = (last - first) * size
    block = np.empty((3, n))
    for offset in range(0, camera, 3):
        _take_block(P, offset, block)
        for m in range(first, last):
            top = (m - first) * size
            _add_product(HP[top : top + size], by_camera[m, :, offset : offset + 3], block, n, offset > 0)
    for offset in range(0, width, 3):
        held = -1
        for m in range(first, last):
            if map_rows[m, offset] != held:  # neighbours often share an anchor
                held = map_rows[m, offset]
                _take_block(P, held, block)
            top = (m - first) * size
            _add_product(HP[top : top + size], by_map[m, :, offset : offset + 3], block, n, True)

    shared, own = np.empty((camera, rows)), np.empty((width, rows))
    for row in range(rows):
        for c in range(camera):
            shared[c, row] = HP[row, c]
    for m in range(first, last):
        top = (m - first) * size
        for row in range(top, rows):
            for c in range(width):
                own[c, row] = HP[row, map_rows[m, c]]
        target = S[top : top + size, top:rows]
        for offset in range(0, camera, 3):
            block_of_shared = shared[offset : offset + 3, top:]
            _add_product(target, by_camera[m, :, offset : offset + 3], block_of_shared, rows - top, offset > 0)
        for offset in range(0, width, 3):
            _add_product(target, by_map[m, :, offset : offset + 3], own[offset : offset + 3, top:], rows - top, True)
        for a in range(size):
            for b in range(size):
                S[top + a, top + b] += R[m, b, a]
            explained = 0.0
            for c in range(camera):
                explained += by_camera[m, a, c] * delta[c]
            for c in range(width):
                explained += by_map[m, a, c] * delta[map_rows[m, c]]
            HP[top + a, n] = innovation[m, a] - explained

    sizes[0], sizes[1], sizes[2], sizes[3], sizes[4] = rows, n, n + 1, S.shape[1], 1
    lower = _at(letters)
    right, plain, turned = lower + 1, lower + 2, lower + 3
    k = _at(sizes)
    states, stride, room, one, info = k + 4, k + 8, k + 12, k + 16, k + 20
    plus = _at(signs)
    minus, covariance, solved, factor = plus + 8, _at(P), _at(HP), _at(S)
    _call(routines[0], (lower, k, factor, room, info))
    if sizes[5] != 0 or not math.isfinite(S[rows - 1, rows - 1]):
        return -1.0
    # HP <- L^-1 HP, delta += HP^T nu, P -= HP^T HP
    _call(routines[1], (right, lower, turned, plain, stride, k, plus, factor, room, solved, stride))
    _call(routines[2], (plain, states, k, plus, solved, stride, solved + 8 * n, stride, plus, _at(delta), one))
    _call(routines[3], (lower, plain, states, k, minus, solved, stride, plus, covariance, states))
    nis = 0.0
    for row in range(rows):
        nis += HP[row, n] ** 2
    return nis


@njit(
    types.Tuple((types.float64[::1], types.float64, types.boolean[::1]))(_ADDRESSES, _P, *_MEASURED, types.int64),
    **_OPTIONS,
)
def _correct(
    routines: tuple[int, ...],
    P: FloatArray,
    innovation: FloatArray,
    by_camera: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    chunk: int,
) -> tuple[FloatArray, float, BoolArray]:
    """`kalman.update`, P in place: delta (n,), the NIS, and which measurements were used (M,)."""
    count, size = innovation.shape
    delta, nis, used = np.zeros(len(P)), 0.0, np.zeros(count, np.bool_)
    chunks = -(-count // chunk)
    most = min(count, chunk) * size
    HP, S = np.empty((most, len(P) + 1)), np.empty((most, most))
    letters, sizes = np.array((76, 82, 78, 84), np.uint8), np.zeros(6, np.int32)  # L, R, N, T
    signs = np.array((1.0, -1.0))
    for i in range(chunks):
        first, last = count * i // chunks, count * (i + 1) // chunks
        gained = _take(
            routines, letters, sizes, signs, P, delta, HP, S, innovation, by_camera, by_map, map_rows, R, first, last
        )
        if gained >= 0.0:
            used[first:last] = True
            nis += gained
        elif last - first > 1:
            for m in range(first, last):
                gained = _take(
                    routines,
                    letters,
                    sizes,
                    signs,
                    P,
                    delta,
                    HP,
                    S,
                    innovation,
                    by_camera,
                    by_map,
                    map_rows,
                    R,
                    m,
                    m + 1,
                )
                if gained >= 0.0:
                    used[m] = True
                    nis += gained
    return delta, nis, used


def correct(P: FloatArray, *measured: Any) -> tuple[FloatArray, float, BoolArray]:
    """`kalman.update`: delta (n,), the NIS, and which measurements were used (M,)."""
    corrected: tuple[FloatArray, float, BoolArray] = _correct(_ROUTINES, P, *measured)
    return corrected


@njit(**_FLOATS)
def _keep(
    chosen: BoolArray,
    place: IntArray,
    innovation: FloatArray,
    by_camera: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
) -> int:
    """Move the chosen measurements to the front, in place; their number."""
    kept = 0
    for m in range(len(chosen)):
        if chosen[m]:
            if kept < m:
                place[kept], innovation[kept], by_camera[kept] = place[m], innovation[m], by_camera[m]
                by_map[kept], map_rows[kept], R[kept] = by_map[m], map_rows[m], R[m]
            kept += 1
    return kept


@njit(
    types.Tuple((types.float64[::1], types.float64, types.int64))(
        _ADDRESSES,
        _P,
        *_SEEN,
        _ANY_MATRIX,
        _ANY_MATRIX,
        _ANY_MATRICES,
        types.float64,
        types.int64,
        types.uint8[::1],
    ),
    **_OPTIONS,
)
def _stage(
    routines: tuple[int, ...],
    P: FloatArray,
    camera: tuple[float, float, float, float, float],
    position: FloatArray,
    R_wc: FloatArray,
    blocks: FloatArray,
    anchors: IntArray,
    parameters: IntArray,
    width: int,
    index: IntArray,
    T: FloatArray,
    z: FloatArray,
    noise: FloatArray,
    limit: float,
    chunk: int,
    fates: IntArray,
) -> tuple[FloatArray, float, int]:
    """`StereoEKF._correct_stage` without its options: linearise, gate, update; delta, the NIS and its dof."""
    place = np.flatnonzero(fates == USED)
    innovation, by_camera, by_map, map_rows, chosen = linearise(
        camera, position, R_wc, blocks, anchors, parameters, width, index[place], T
    )
    R = np.empty((len(place), len(T), len(T)))
    for i in range(len(place)):
        innovation[i] = z[place[i]] - innovation[i]
        R[i] = noise[place[i]]
        if not chosen[i]:
            fates[place[i]] = BEHIND
    count = _keep(chosen, place, innovation, by_camera, by_map, map_rows, R)
    if limit < np.inf:
        distances = squared_distances(
            P, innovation[:count], by_camera[:count], by_map[:count], map_rows[:count], R[:count]
        )
        for i in range(count):
            chosen[i] = distances[i] <= limit
            if not chosen[i]:
                fates[place[i]] = GATED
        count = _keep(chosen[:count], place, innovation, by_camera, by_map, map_rows, R)
    delta, nis, used = _correct(
        routines, P, innovation[:count], by_camera[:count], by_map[:count], map_rows[:count], R[:count], chunk
    )
    dof = 0
    for i in range(count):
        if used[i]:
            dof += len(T)
        else:
            fates[place[i]] = FAILED
    return delta, nis, dof


def correct_stage(P: FloatArray, *stage: Any) -> tuple[FloatArray, float, int]:
    """`StereoEKF._correct_stage` without its options; delta (n,), the NIS and its degrees of freedom."""
    corrected: tuple[FloatArray, float, int] = _stage(_ROUTINES, P, *stage)
    return corrected


# ---- the camera ----

_matrix_of, _quaternion_of = njit(**_FLOATS)(rotations.matrix_of), njit(**_FLOATS)(rotations.quaternion_of)
_product_of, _right_jacobian_of = njit(**_FLOATS)(rotations.product_of), njit(**_FLOATS)(rotations.right_jacobian_of)
_additive_transport_of = njit(**_FLOATS)(additive_transport_of)


@njit(**_FLOATS)
def _fill(target: FloatArray, nine: tuple[float, ...], scale: float) -> None:
    """target (3, 3) = scale times nine numbers, row by row."""
    for i, number in enumerate(nine):
        target[i // 3, i % 3] = scale * number


@njit(types.void(_P, _MATRIX, _MATRIX), **_OPTIONS)
def transform_leading(P: FloatArray, F: FloatArray, added: FloatArray) -> None:
    """`symmetric.transform_leading`."""
    n, camera = len(P), len(F)
    old, half = np.empty((camera, camera)), np.zeros((camera, camera))
    for i in range(camera):
        for j in range(i + 1):
            old[i, j] = old[j, i] = P[i, j]
    for i in range(camera):
        for k in range(camera):
            if F[i, k] != 0.0:
                for j in range(camera):
                    half[i, j] += F[i, k] * old[k, j]
    for i in range(camera):
        for j in range(i + 1):
            P[i, j] = 0.5 * (added[i, j] + added[j, i])
            for k in range(camera):
                P[i, j] += half[i, k] * F[j, k]
    cross = np.empty((camera, n - camera))
    for k in range(camera):
        cross[k] = P[camera:, k]
    for i in range(camera):
        changed = False
        for k in range(camera):
            changed = changed or F[i, k] != (1.0 if i == k else 0.0)
        if changed:
            P[camera:, i] = 0.0
            for k in range(camera):
                if F[i, k] != 0.0:
                    for j in range(n - camera):
                        P[camera + j, i] += F[i, k] * cross[k, j]


@njit(
    types.Tuple((types.float64[::1], types.float64[::1]))(
        _P, _VECTOR, _VECTOR, _VECTOR, _VECTOR, types.float64, types.float64, types.float64
    ),
    **_OPTIONS,
)
def predict(
    P: FloatArray,
    position: FloatArray,
    orientation: FloatArray,
    linear: FloatArray,
    angular: FloatArray,
    dt: float,
    linear_variance: float,
    angular_variance: float,
) -> tuple[FloatArray, FloatArray]:
    """`ConstantVelocity.predict` and what follows of it for P; the new position and orientation."""
    turn = _quaternion_of(angular[0] * dt, angular[1] * dt, angular[2] * dt)
    moved = _product_of(orientation[0], orientation[1], orientation[2], orientation[3], *turn)
    F = np.eye(CAMERA_SIZE)
    _fill(F[ROTATION, ROTATION].T, _matrix_of(*turn), 1.0)
    _fill(F[ROTATION, ANGULAR], _right_jacobian_of(angular[0] * dt, angular[1] * dt, angular[2] * dt), dt)
    for i in range(3):
        F[i, 6 + i] = dt
        P[6 + i, 6 + i] += linear_variance
        P[9 + i, 9 + i] += angular_variance
    transform_leading(P, F, np.zeros((CAMERA_SIZE, CAMERA_SIZE)))
    return position + dt * linear, np.array(moved)


@njit(
    types.Tuple((types.float64[::1], types.float64[:, ::1]))(
        _P, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _MATRIX, _VECTOR, types.boolean
    ),
    **_OPTIONS,
)
def retract(
    P: FloatArray,
    position: FloatArray,
    orientation: FloatArray,
    linear: FloatArray,
    angular: FloatArray,
    blocks: FloatArray,
    delta: FloatArray,
    additive: bool,
) -> tuple[FloatArray, FloatArray]:
    """`StandardError.moved` and `transport`: the new camera (position, orientation, velocities) and blocks."""
    x, y, z = delta[3], delta[4], delta[5]
    M = np.eye(CAMERA_SIZE)
    if additive:
        turn = (0.5 * x, 0.5 * y, 0.5 * z, 1.0)
        _fill(M[ROTATION, ROTATION], _additive_transport_of(x, y, z), 1.0)
    else:
        turn = _quaternion_of(x, y, z)
        _fill(M[ROTATION, ROTATION], _right_jacobian_of(x, y, z), 1.0)
    transform_leading(P, M, np.zeros((CAMERA_SIZE, CAMERA_SIZE)))
    camera = np.empty(13)
    camera[:3] = position + delta[:3]
    camera[3:7] = np.array(_product_of(orientation[0], orientation[1], orientation[2], orientation[3], *turn))
    camera[7:10] = linear + delta[LINEAR]
    camera[10:] = angular + delta[ANGULAR]
    return camera, blocks + delta[CAMERA_SIZE:].reshape(-1, 3)
