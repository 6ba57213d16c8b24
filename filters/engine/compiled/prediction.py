"""Kernels of the motion models: prediction of the leading variables with P, and odometry as a measurement."""

from __future__ import annotations

from numba import njit, types

from filters.engine.compiled.blas import KERNEL
from filters.engine.compiled.covariance import identity, transform_leading
from filters.engine.compiled.recipe import FIRST_ESTIMATES, Plan
from filters.engine.compiled.storage import Scratch
from filters.engine.compiled.units import GIVEN, GIVEN_COVARIANCE, MATRIX, PLAN, SCRATCH, VECTOR, unit
from filters.geometry import rotations
from filters.validation import FloatArray

matrix_of, quaternion_of = njit(**KERNEL)(rotations.matrix_of), njit(**KERNEL)(rotations.quaternion_of)
product_of, right_jacobian_of = njit(**KERNEL)(rotations.product_of), njit(**KERNEL)(rotations.right_jacobian_of)


@njit(**KERNEL)
def multiply(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    """Product of two 3x3 matrices, row by row."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@njit(**KERNEL)
def transposed(a: tuple[float, ...]) -> tuple[float, ...]:
    """Transpose of a 3x3 matrix, row by row."""
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@njit(**KERNEL)
def times(a: tuple[float, ...], x: float, y: float, z: float) -> tuple[float, float, float]:
    """Product of a 3x3 matrix with a vector."""
    return a[0] * x + a[1] * y + a[2] * z, a[3] * x + a[4] * y + a[5] * z, a[6] * x + a[7] * y + a[8] * z


@njit(**KERNEL)
def skew(x: float, y: float, z: float) -> tuple[float, ...]:
    """Cross-product matrix, row by row."""
    return 0.0, -z, y, z, 0.0, -x, -y, x, 0.0


@njit(**KERNEL)
def orientation(x: FloatArray) -> tuple[float, ...]:
    """R_wc, row by row."""
    return matrix_of(x[3], x[4], x[5], x[6])


@njit(**KERNEL)
def put(target: FloatArray, row: int, column: int, nine: tuple[float, ...], scale: float) -> None:
    """target[row:, column:] (3, 3) = scale times nine numbers, row by row."""
    for i, number in enumerate(nine):
        target[row + i // 3, column + i % 3] = scale * number


@njit(**KERNEL)
def world_rotation(x: FloatArray, velocity: int, effect: FloatArray) -> None:
    """`joint_state.world_rotation_of_camera` in the leading rows of `effect`, zero in the other ones."""
    for i in range(len(effect)):
        for a in range(3):
            effect[i, a] = 0.0
    put(effect, 0, 0, skew(x[0], x[1], x[2]), -1.0)
    put(effect, 3, 0, transposed(orientation(x)), 1.0)
    put(effect, velocity, 0, skew(x[velocity + 1], x[velocity + 2], x[velocity + 3]), -1.0)


@njit(**KERNEL)
def constrain(
    J: FloatArray, rows: int, columns: int, image: FloatArray, source: FloatArray, R: tuple[float, ...]
) -> None:
    """`FirstEstimates.constrained`: J[:, 3:6] += (image - J source) R_wc."""
    for i in range(rows):
        m0, m1, m2 = image[i, 0], image[i, 1], image[i, 2]
        for k in range(columns):
            m0 -= J[i, k] * source[k, 0]
            m1 -= J[i, k] * source[k, 1]
            m2 -= J[i, k] * source[k, 2]
        for a in range(3):
            J[i, 3 + a] += m0 * R[a] + m1 * R[3 + a] + m2 * R[6 + a]


@njit(**KERNEL)
def _drive(
    F: FloatArray,
    G: FloatArray,
    moved: FloatArray,
    x: FloatArray,
    v: int,
    dt: float,
    odometry: FloatArray,
    jacobian: tuple[float, ...],
) -> None:
    """`VelocityDriven.predict`: the rest of F, G (leading, 6) by the errors of the odometry, the moved position."""
    v0, v1, v2, w0, w1, w2 = odometry[0], odometry[1], odometry[2], odometry[3], odometry[4], odometry[5]
    h = quaternion_of(0.5 * dt * w0, 0.5 * dt * w1, 0.5 * dt * w2)
    half = matrix_of(h[0], h[1], h[2], h[3])
    R = orientation(x)
    middle = multiply(R, half)
    a0, a1, a2 = times(half, v0, v1, v2)
    by_rotation = multiply(R, skew(a0, a1, a2))
    by_turn = multiply(
        multiply(middle, skew(v0, v1, v2)), right_jacobian_of(0.5 * dt * w0, 0.5 * dt * w1, 0.5 * dt * w2)
    )
    velocity = times(middle, v0, v1, v2)
    for i in range(len(F)):
        for k in range(6):
            G[i, k] = 0.0
    put(F, 0, 3, by_rotation, -dt)
    put(F, v, 3, by_rotation, -1.0)
    put(G, 0, 0, middle, dt)
    put(G, 0, 3, by_turn, -0.5 * dt * dt)
    put(G, 3, 3, jacobian, dt)
    put(G, v, 0, middle, 1.0)
    put(G, v, 3, by_turn, -0.5 * dt)
    for i in range(3):
        F[v + i, v + i] = F[v + 3 + i, v + 3 + i] = 0.0
        G[v + 3 + i, 3 + i] = 1.0
        moved[i] = x[i] + velocity[i] * dt
        moved[v + 1 + i] = velocity[i]
        moved[v + 4 + i] = odometry[3 + i]


@unit(
    *(PLAN, MATRIX, types.int64, VECTOR, VECTOR, types.float64, GIVEN, GIVEN_COVARIANCE),
    *(VECTOR, MATRIX, MATRIX, SCRATCH),
)
def predict(
    plan: Plan,
    P: FloatArray,
    n: int,
    x: FloatArray,
    predicted: FloatArray,
    dt: float,
    odometry: FloatArray,
    odometry_covariance: FloatArray,
    moved_there: FloatArray,
    F_there: FloatArray,
    Q: FloatArray,
    s: Scratch,
) -> None:
    """Leading variables and P after dt seconds: by the numbers of a part, or `ConstantVelocity` or `VelocityDriven`."""
    v, leading, F, moved = plan.velocity, plan.leading, s.F, s.moved
    if plan.driven_by_numbers:
        for i in range(leading):
            for j in range(leading):
                F[i, j] = F_there[i, j]
        transform_leading(P, n, s)
        for i in range(leading):
            for j in range(i, leading):
                P[i, j] += Q[i, j]
        for i in range(len(x)):
            x[i] = predicted[i] = moved_there[i]
        return
    identity(F)
    for i in range(len(x)):
        moved[i] = x[i]
    if plan.velocity_driven:
        w0, w1, w2 = odometry[3], odometry[4], odometry[5]
    else:
        w0, w1, w2 = x[v + 4], x[v + 5], x[v + 6]
    turn = quaternion_of(w0 * dt, w1 * dt, w2 * dt)
    jacobian = right_jacobian_of(w0 * dt, w1 * dt, w2 * dt)
    q0, q1, q2, q3 = product_of(x[3], x[4], x[5], x[6], turn[0], turn[1], turn[2], turn[3])
    moved[3], moved[4], moved[5], moved[6] = q0, q1, q2, q3
    put(F, 3, 3, transposed(matrix_of(turn[0], turn[1], turn[2], turn[3])), 1.0)
    if plan.velocity_driven:
        _drive(F, s.half, moved, x, v, dt, odometry, jacobian)
    else:
        put(F, 3, v + 3, jacobian, dt)
        linear, angular = (plan.sigma_acceleration * dt) ** 2, (plan.sigma_angular_acceleration * dt) ** 2
        for i in range(3):
            F[i, v + i] = dt
            moved[i] = x[i] + dt * x[v + 1 + i]
            P[v + i, v + i] += linear
            P[v + 3 + i, v + 3 + i] += angular
    if plan.error == FIRST_ESTIMATES:
        source, image = s.W, s.W[leading:]
        world_rotation(predicted, v, source[:leading])
        world_rotation(moved, v, image[:leading])
        constrain(F, leading, leading, image, source, orientation(predicted))
    G = s.G  # the velocity-driven noise: G^T, which `transform_leading` must not overwrite
    if plan.velocity_driven:
        for i in range(leading):
            for k in range(6):
                G[k, i] = s.half[i, k]
    transform_leading(P, n, s)
    if plan.velocity_driven:
        for i in range(leading):
            for j in range(i, leading):
                for k in range(6):
                    for m in range(6):
                        P[i, j] += G[k, i] * odometry_covariance[k, m] * G[m, j]
    for i in range(leading):
        P[i, i] += plan.walk[i] * dt
    for i in range(len(x)):
        x[i] = predicted[i] = moved[i]


@njit(**KERNEL)
def measure_odometry(x: FloatArray, v: int, dt: float, odometry: FloatArray, H: FloatArray, nu: FloatArray) -> None:
    """`ConstantVelocity.odometry_measurement`: H (6, leading) and the innovation (6,)."""
    for k in range(6):
        for i in range(H.shape[1]):
            H[k, i] = 0.0
    w0, w1, w2 = 0.5 * dt * x[v + 4], 0.5 * dt * x[v + 5], 0.5 * dt * x[v + 6]
    h = quaternion_of(w0, w1, w2)
    back = matrix_of(h[0], h[1], h[2], h[3])
    R_cw = transposed(orientation(x))
    c0, c1, c2 = times(R_cw, x[v + 1], x[v + 2], x[v + 3])
    by_half_turn = multiply(back, skew(c0, c1, c2))
    put(H, 0, 3, by_half_turn, 1.0)
    put(H, 0, v, multiply(back, R_cw), 1.0)
    put(H, 0, v + 3, multiply(by_half_turn, right_jacobian_of(w0, w1, w2)), -0.5 * dt)
    expected = times(back, c0, c1, c2)
    for i in range(3):
        H[3 + i, v + 3 + i] = 1.0
        nu[i] = odometry[i] - expected[i]
        nu[3 + i] = odometry[3 + i] - x[v + 4 + i]
