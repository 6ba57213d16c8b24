"""Calibration, considered variables and the invariant error against dense formulas with numerical Jacobians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import CalibratedPair, RightInvariant, StereoEKF, StereoNoise
from filters.engine.engine import Engine
from filters.engine.frame_arrays import Observations
from filters.geometry import symmetric
from filters.kernels.recipe import Recipe
from filters.kernels.records import FAILED, FilterState

from ..drives import CAMERA
from ..numeric import numeric_jacobian as jacobian

R = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 2.0]])
INVARIANT = RightInvariant(reset=True)
LANDMARKS = ("inverse-depth", "shared-anchor", "euclidean")


def recipe_with(landmark: str, calibrated: bool = True, **options: object) -> Recipe:
    given = {name: options.pop(name) for name in ("error", "iterations") if name in options}
    pair = CalibratedPair(1.0, 1.0, 1.0, 1.0) if calibrated else "joint"
    given = {"error": "so3", "gate": None, "landmark": landmark, "measurement": pair, **given}
    recipe = StereoEKF(CAMERA, StereoNoise(R), **given).engine.recipe
    return with_plan(recipe, **options)


def with_plan(recipe: Recipe, **options: object) -> Recipe:
    return replace(recipe, plan=recipe.plan._replace(**options))


def started(recipe: Recipe) -> Engine:
    """A filter in general position with four landmarks."""
    rng = np.random.default_rng(3)
    engine, L = Engine(recipe), recipe.plan.leading
    x = np.zeros(recipe.values)
    x[:3], x[3:7] = (1.0, 2.0, 3.0), Rotation.from_rotvec([0.2, -0.5, 0.1]).as_quat()
    if len(recipe.plan.sensed):
        x[7:13] = 0.7, 0.02, -0.03, 0.01, -0.02, 0.015
    v = recipe.plan.velocity
    x[v + 1 : v + 7] = 0.5, 0.1, 4.0, 0.02, 0.1, -0.01
    root = 0.01 * rng.standard_normal((v + 6, v + 6))
    P = np.zeros((L, L))
    P[: v + 6, : v + 6] = root @ root.T
    engine.reset(0, x, P)
    return engine


UVD = np.array([[500.0, 150.0, 30.0], [800.0, 250.0, 12.0], [650.0, 190.0, 20.0], [900.0, 100.0, 8.0]])


def observed(uvd: np.ndarray) -> Observations:
    ids, yes = np.arange(len(uvd)), np.ones(1, dtype=bool)
    return Observations(yes, np.array([0, len(uvd)]), ids, uvd, R, ~yes)


def exported(engine: Engine) -> FilterState:
    """State of the first filter, P whole."""
    state = engine.export(0)
    return replace(state, P=symmetric.full(state.P.T), blocks=state.blocks[:, :3], first=state.first[:, :3])


def plus(recipe: Recipe, state: FilterState, e: np.ndarray) -> FilterState:
    """The state with an error added, in the standard coordinates."""
    x = state.x.copy()
    x[:3] += e[:3]
    x[3:7] = (Rotation.from_quat(x[3:7]) * Rotation.from_rotvec(e[3:6])).as_quat()
    x[7:] += e[6 : recipe.plan.leading]
    return replace(state, x=x, blocks=state.blocks + e[recipe.plan.leading :].reshape(-1, 3))


def minus(recipe: Recipe, other: FilterState, state: FilterState) -> np.ndarray:
    """The error between two states."""
    turn = Rotation.from_quat(state.x[3:7]).inv() * Rotation.from_quat(other.x[3:7])
    return np.concatenate(
        [other.x[:3] - state.x[:3], turn.as_rotvec(), other.x[7:] - state.x[7:], (other.blocks - state.blocks).ravel()]
    )


def calibration_of(recipe: Recipe, x: np.ndarray) -> np.ndarray:
    return x[7:13] if len(recipe.plan.sensed) else np.zeros(6)


def directions(angles: np.ndarray) -> np.ndarray:
    theta, phi = angles[:, 0], angles[:, 1]
    return np.column_stack([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)])


def project(recipe: Recipe, state: FilterState) -> np.ndarray:
    """(u, v, d) of all landmarks, one after the other."""
    own, rotation = state.blocks[state.own], Rotation.from_quat(state.x[3:7]).as_matrix()
    if not recipe.plan.anchors:
        h, rho = own - state.x[:3], np.ones(len(own))
    else:
        rho = own[:, 2]
        h = rho[:, None] * (state.blocks[state.anchor] - state.x[:3]) + directions(own)
    o, focal, baseline, *turn = calibration_of(recipe, state.x)
    h = h @ rotation @ Rotation.from_rotvec(turn).as_matrix().T
    u, v = CAMERA.fx * h[:, 0] / h[:, 2], CAMERA.fy * h[:, 1] / h[:, 2]
    d = CAMERA.disparity_constant * rho / h[:, 2]
    return np.column_stack(
        [CAMERA.cx + (1 + focal) * u, CAMERA.cy + (1 + focal) * v, (1 + focal) * (1 + baseline) * d + o]
    ).ravel()


def start_blocks(recipe: Recipe, state: FilterState, uvd: np.ndarray) -> np.ndarray:
    """Blocks of landmarks that start there: anchors first."""
    o, focal, baseline, *turn = calibration_of(recipe, state.x)
    rays = np.column_stack(
        [
            (uvd[:, 0] - CAMERA.cx) / (CAMERA.fx * (1 + focal)),
            (uvd[:, 1] - CAMERA.cy) / (CAMERA.fy * (1 + focal)),
            np.ones(len(uvd)),
        ]
    )
    scale = (uvd[:, 2] - o) / ((1 + focal) * (1 + baseline) * CAMERA.disparity_constant)
    h = rays @ Rotation.from_rotvec(turn).as_matrix() @ Rotation.from_quat(state.x[3:7]).as_matrix().T
    if not recipe.plan.anchors:
        return state.x[:3] + h / scale[:, None]
    anchors = np.tile(state.x[:3], (1 if recipe.plan.shares_anchors else len(uvd), 1))
    angles = [np.arctan2(h[:, 0], h[:, 2]), np.arctan2(-h[:, 1], np.hypot(h[:, 0], h[:, 2]))]
    return np.vstack([anchors, np.column_stack([*angles, scale / np.linalg.norm(rays, axis=1)])])


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_new_landmarks_inherit_the_uncertainty_of_pose_and_calibration(landmark: str, calibrated: bool) -> None:
    recipe = recipe_with(landmark, calibrated)
    engine = started(recipe)
    before, L = exported(engine), recipe.plan.leading
    engine.step(0.0, observed(UVD))
    after = exported(engine)
    np.testing.assert_allclose(after.blocks, start_blocks(recipe, before, UVD), rtol=1e-12)
    J = jacobian(lambda e: start_blocks(recipe, plus(recipe, before, e), UVD).ravel(), L)
    B = jacobian(lambda e: start_blocks(recipe, before, UVD + e.reshape(-1, 3)).ravel(), UVD.size, 1e-4)
    G = np.vstack([np.eye(L), J])
    expected = G @ before.P @ G.T
    expected[L:, L:] += B @ np.kron(np.eye(len(UVD)), R) @ B.T
    sigmas = np.sqrt(np.diag(expected)) + 1e-12
    np.testing.assert_allclose(after.P / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=2e-6)


@pytest.mark.parametrize("considered", [(), (6, 7, 8, 9, 10, 11), (0, 7, 13)])
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_an_update_is_the_dense_one_and_schmidts_for_considered_rows(landmark: str, considered: tuple) -> None:
    recipe = recipe_with(landmark, considered=np.array(considered, dtype=np.int64))
    engine = started(recipe)
    engine.step(0.0, observed(UVD))
    before, uvd = exported(engine), UVD + np.random.default_rng(5).standard_normal(UVD.shape)
    engine.step(0.0, observed(uvd))
    after, size = exported(engine), len(before.P)
    H = jacobian(lambda e: project(recipe, plus(recipe, before, e)), size)
    S = H @ before.P @ H.T + np.kron(np.eye(len(uvd)), R)
    K = before.P @ H.T @ np.linalg.inv(S)
    K[list(considered)] = 0.0  # Schmidt
    delta = K @ (uvd.ravel() - project(recipe, before))
    left = np.eye(size) - K @ H
    expected = left @ before.P @ left.T + K @ np.kron(np.eye(len(uvd)), R) @ K.T
    M = np.eye(size)
    M[3:6, 3:6] = _right_jacobian(delta[3:6])
    expected = M @ expected @ M.T
    sigmas = np.sqrt(np.diag(before.P)) + 1e-12
    moved = plus(recipe, before, delta)
    np.testing.assert_allclose(minus(recipe, after, moved) / sigmas, 0.0, atol=1e-5)
    np.testing.assert_allclose(after.P / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=1e-5)
    for row in considered:
        place = row if row < 3 else row + 1
        assert after.x[place] == before.x[place]


def _right_jacobian(phi: np.ndarray) -> np.ndarray:
    inverse = Rotation.from_rotvec(phi).inv()
    return jacobian(lambda e: (inverse * Rotation.from_rotvec(phi + e)).as_rotvec(), 3)


def invariant_plus(recipe: Recipe, state: FilterState, delta: np.ndarray) -> FilterState:
    """The right-invariant retraction in standard coordinates: points x + J_l(theta) dx, rays as points, too."""
    moved = plus(recipe, state, delta)
    theta = Rotation.from_quat(state.x[3:7]).apply(delta[3:6])
    J = _right_jacobian(-theta)
    v = recipe.plan.velocity
    moved.x[:3] = state.x[:3] + J @ delta[:3]
    moved.x[v + 1 : v + 4] = state.x[v + 1 : v + 4] + J @ delta[v : v + 3]
    by_block = delta[recipe.plan.leading :].reshape(-1, 3)
    rays = set() if not recipe.plan.anchors else set(state.own.tolist())
    for c, (block, d) in enumerate(zip(state.blocks, by_block, strict=True)):
        if c not in rays:
            moved.blocks[c] = block + J @ d
            continue
        shift = jacobian(lambda a, block=block: directions(block[None, :2] + a)[0], 2) @ d[:2]
        m = directions(block[None, :2])[0] + J @ shift
        moved.blocks[c] = np.arctan2(m[0], m[2]), np.arctan2(-m[1], np.hypot(m[0], m[2])), block[2] + d[2]
    return moved


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_the_invariant_error_carries_P_along_by_the_whole_jacobian(landmark: str) -> None:
    uvd = UVD + np.array([3.0, -2.0, 1.0])
    so3, invariant = (started(recipe_with(landmark, error=error)) for error in ("so3", INVARIANT))
    recipe = so3.recipe
    for engine in (so3, invariant):
        engine.step(0.0, observed(UVD))
    before = exported(so3)
    for engine in (so3, invariant):
        engine.step(0.0, observed(uvd))
    by_so3, after, size = exported(so3), exported(invariant), len(before.P)
    delta = minus(recipe, by_so3, before)
    back = np.eye(size)
    back[3:6, 3:6] = np.linalg.inv(_right_jacobian(delta[3:6]))
    corrected = back @ by_so3.P @ back.T
    moved = invariant_plus(recipe, before, delta)
    np.testing.assert_allclose(minus(recipe, after, moved), 0.0, atol=1e-8)
    M = jacobian(lambda e: minus(recipe, invariant_plus(recipe, before, delta + e), moved), size, 1e-5)
    expected = M @ corrected @ M.T
    sigmas = np.sqrt(np.diag(expected)) + 1e-9
    np.testing.assert_allclose(after.P / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=1e-4)


@pytest.mark.parametrize("error", ["so3", INVARIANT], ids=["so3", "invariant"])
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_passes_with_the_prior_held_end_at_the_most_probable_state(landmark: str, error: object) -> None:
    """There the correction is P H^T R^-1 times what is left of the measurement, H by the errors of the prior."""
    engine = started(recipe_with(landmark, error=error, iterations=300))
    recipe, retracted = engine.recipe, plus if error == "so3" else invariant_plus
    engine.step(0.0, observed(UVD))
    before, uvd = exported(engine), UVD + np.array([1.0, -2.0, 1.0])
    engine.step(0.0, observed(uvd))
    after, delta = exported(engine), np.zeros(len(before.P))
    for _ in range(10):  # the correction that leads there
        moved = retracted(recipe, before, delta)
        delta = delta + minus(recipe, after, moved)
    np.testing.assert_allclose(minus(recipe, after, retracted(recipe, before, delta)), 0.0, atol=1e-10)
    H = jacobian(lambda e: project(recipe, retracted(recipe, before, delta + e)), len(delta))
    left = (uvd.ravel() - project(recipe, after)).reshape(-1, 3)
    sigmas = np.sqrt(np.diag(before.P)) + 1e-12
    expected = before.P @ H.T @ np.linalg.solve(R, left.T).T.ravel()
    np.testing.assert_allclose(delta / sigmas, expected / sigmas, atol=1e-4)


@pytest.mark.parametrize("iterations", [1, 2])
def test_a_measurement_without_a_cholesky_factor_is_left_out_alone(iterations: int) -> None:
    recipe = recipe_with("shared-anchor", iterations=iterations)
    broken, without = started(recipe), started(recipe)
    for engine in (broken, without):
        engine.step(0.0, observed(UVD))
    seen = observed(UVD + 0.5)
    noise = np.tile(R, (4, 1, 1))
    noise[2] = -1e6 * np.eye(3)
    others = [0, 1, 3]
    outcome = broken.step(0.0, replace(seen, R=noise))
    kept = replace(seen, ids=seen.ids[others], uvd=seen.uvd[others], offsets=np.array([0, 3]))
    expected = Engine(with_plan(recipe, drop_unseen=False))
    expected.load(0, without.export(0))
    expected.step(0.0, kept)
    np.testing.assert_array_equal(outcome.fates == FAILED, [False, False, True, False])
    assert outcome.dof[0] == 9
    np.testing.assert_allclose(exported(broken).x, exported(expected).x, rtol=1e-10, atol=1e-12)
