"""The formulas of docs/derivations, written down as they are printed there, against the code (about 2 s).

`tests/filters/test_jacobians.py` holds the code against finite differences; this holds the pages against the code.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filters import (
    BodyVelocity,
    CameraState,
    ConstantVelocity,
    Euclidean,
    InverseDepth,
    LeftInvariant,
    RightInvariant,
    Start,
    StereoCamera,
    StereoEKF,
    StereoNoise,
    StereoObservation,
    VelocityDriven,
)
from filters.geometry import rotations
from filters.geometry.derivatives import jacobian_of
from filters.geometry.poses import AdditiveQuaternion, RotationVector, additive_transport_of
from filters.geometry.vectors import turned_by
from filters.joint_state import JointState, StateLayout
from filters.landmarks.inverse_depth import angles_of, ray_of

from ..filters.dense import gamma_of_variables, linearised, moved_by
from ..filters.first_sight import first_sight

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs" / "derivations").glob("*.md"))
CAMERA = StereoCamera(fx=700.0, fy=650.0, cx=660.0, cy=190.0, baseline=0.6, width=1344, height=391)
FX, FY, CX, CY, B = 700.0, 650.0, 660.0, 190.0, 0.6
EYE, ZERO = np.eye(3), np.zeros((3, 3))
skew, exp, J_r = rotations.skew, rotations.exp, rotations.right_jacobian
EXACT = {"rtol": 1e-10, "atol": 1e-10}


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def state(rng):
    return CameraState(rng.normal(size=3), rotations.exp_quaternion(rng.normal(size=3)), *rng.normal(size=(2, 3)))


class TestCamera:
    def test_projection_and_its_jacobian(self, rng):
        h, s = rng.normal([0.0, 0.0, 5.0]), -0.3
        i = 1 / h[2]
        u, v, d = FX * h[0] / h[2] + CX, FY * h[1] / h[2] + CY, FX * B * s / h[2]
        np.testing.assert_allclose(CAMERA.project_scaled(h, s), [u, v, d], **EXACT)
        expected = [
            [FX * i, 0, -FX * h[0] * i**2, 0],
            [0, FY * i, -FY * h[1] * i**2, 0],
            [0, 0, -FX * B * s * i**2, FX * B * i],
        ]
        np.testing.assert_allclose(CAMERA.project_scaled_jacobian(h, s), expected, **EXACT)

    def test_back_projection(self):
        u, v, d = 700.0, 150.0, 12.0
        z = FX * B / d
        np.testing.assert_allclose(CAMERA.backproject([u, v, d]), [z * (u - CX) / FX, z * (v - CY) / FY, z], **EXACT)

    def test_noise_of_independent_pixels(self):
        A = np.array([[1, 0, 0], [0, 1, 0], [1, 0, -1]])
        np.testing.assert_allclose(StereoNoise.independent_pixels(0.7).R, 0.49 * A @ A.T, **EXACT)

    def test_triangulated_points_are_too_far(self, rng):
        d, sigma = 20.0, 1.0
        mean = (FX * B / (d + rng.normal(0, sigma, 1_000_000))).mean()
        z = FX * B / d
        assert mean - z == pytest.approx(z * sigma**2 / d**2, rel=0.1)  # standard error 2 %, third order 1 %


class TestMotion:
    def test_constant_velocity(self, state):
        dt, omega = 0.3, state.angular_velocity
        F = np.block(
            [
                [EYE, ZERO, dt * EYE, ZERO],
                [ZERO, exp(omega * dt).T, ZERO, J_r(omega * dt) * dt],
                [ZERO, ZERO, EYE, ZERO],
                [ZERO, ZERO, ZERO, EYE],
            ]
        )
        step = ConstantVelocity(2.0, 0.5).predict(state, dt, None)
        np.testing.assert_allclose(step.F, F, **EXACT)
        np.testing.assert_allclose(step.G, F[:, 6:], **EXACT)
        np.testing.assert_allclose(step.Q, dt**2 * np.diag([4.0] * 3 + [0.25] * 3), **EXACT)

    def test_odometry_as_a_measurement(self, state):
        dt, omega = 0.3, state.angular_velocity
        E, v_c = exp(omega * dt / 2), state.R_wc.T @ state.linear_velocity
        seen = ConstantVelocity().odometry_measurement(state, dt, BodyVelocity(np.zeros(3), np.zeros(3), np.eye(6)))
        np.testing.assert_allclose(seen.innovation, -np.concatenate([E @ v_c, omega]), **EXACT)
        by_omega = -0.5 * dt * E @ skew(v_c) @ J_r(omega * dt / 2)
        H = np.block([[ZERO, E @ skew(v_c), E @ state.R_wc.T, by_omega], [ZERO, ZERO, ZERO, EYE]])
        np.testing.assert_allclose(seen.H, H, **EXACT)

    def test_driven_by_odometry(self, state, rng):
        dt, R = 0.3, state.R_wc
        b, w = rng.normal(size=(2, 3))
        R_m = R @ exp(w * dt / 2)
        step = VelocityDriven().predict(state, dt, BodyVelocity(b, w, np.eye(6)))
        np.testing.assert_allclose(step.state.position, state.position + R_m @ b * dt, **EXACT)
        np.testing.assert_allclose(step.state.linear_velocity, R_m @ b, **EXACT)
        by_turn = -R @ skew(exp(w * dt / 2) @ b)
        np.testing.assert_allclose(step.F[:3, 3:6], by_turn * dt, **EXACT)
        np.testing.assert_allclose(step.F[3:6, 3:6], exp(w * dt).T, **EXACT)
        np.testing.assert_allclose(step.F[6:9, 3:6], by_turn, **EXACT)
        assert not step.F[:, 6:].any()
        by_w = -0.5 * dt * R_m @ skew(b) @ J_r(w * dt / 2)
        G = np.block([[R_m * dt, dt * by_w], [ZERO, J_r(w * dt) * dt], [R_m, by_w], [ZERO, EYE]])
        np.testing.assert_allclose(step.G, G, **EXACT)

    def test_the_right_jacobian(self, rng):
        phi = rng.normal(size=3)
        angle = np.linalg.norm(phi)
        expected = (
            EYE
            - (1 - np.cos(angle)) / angle**2 * skew(phi)
            + (angle - np.sin(angle)) / angle**3 * skew(phi) @ skew(phi)
        )
        np.testing.assert_allclose(J_r(phi), expected, **EXACT)


class TestInverseDepth:
    theta, phi, rho = 0.4, -0.3, 0.07

    def test_seen_from_the_camera(self, rng):
        a, r = rng.normal(size=(2, 3))
        c, s, C, S = np.cos(self.phi), np.sin(self.phi), np.cos(self.theta), np.sin(self.theta)
        m = np.array([c * S, -s, c * C])
        M = np.array([[c * C, -s * S], [0, -c], [-c * S, -s * C]])
        parameters = np.array([[self.theta, self.phi, self.rho]])
        seen = InverseDepth().relative_to(r, a[None], parameters)
        np.testing.assert_allclose(seen.homogeneous[0], [*(self.rho * (a - r) + m), self.rho], **EXACT)
        by_map = np.block([[self.rho * EYE, M, (a - r)[:, None]], [np.zeros((1, 5)), np.ones((1, 1))]])
        np.testing.assert_allclose(seen.by_map[0], by_map, **EXACT)
        np.testing.assert_allclose(seen.by_position[0], -by_map[:, :3], **EXACT)
        points = InverseDepth().points(a[None], parameters)
        np.testing.assert_allclose(points.positions[0], a + m / self.rho, **EXACT)
        by_y = np.block([[EYE, M / self.rho, (-m / self.rho**2)[:, None]]])
        np.testing.assert_allclose(points.by_map[0], by_y, **EXACT)

    def test_angles(self, rng):
        g = rng.normal(size=3)
        c = np.hypot(g[0], g[2])
        np.testing.assert_allclose(angles_of(g), [np.arctan2(g[0], g[2]), np.arctan2(-g[1], c)], **EXACT)
        by_theta = np.array([g[2], 0, -g[0]]) / c**2
        by_phi = np.array([g[0] * g[1] / c, -c, g[2] * g[1] / c]) / (g @ g)
        np.testing.assert_allclose(jacobian_of(angles_of, g[None])[1][0], [by_theta, by_phi], **EXACT)

    def test_initialisation(self, state):
        uvd = np.array([700.0, 150.0, -2.0])
        R = state.R_wc
        h = np.array([(uvd[0] - CX) / FX, (uvd[1] - CY) / FY, 1.0])
        n, f_b = np.linalg.norm(h), FX * B
        noise = np.diag([1.0, 2.0, 3.0]) + 0.5
        new = first_sight(InverseDepth(), CAMERA, state.position, R, uvd[None], noise)
        rho = uvd[2] / (f_b * n)
        np.testing.assert_allclose(new.parameters[0], [*angles_of(R @ h), rho], **EXACT)
        by_g = jacobian_of(angles_of, (R @ h)[None])[1][0] @ R
        by_pose = np.hstack([ZERO, [*(-by_g @ skew(h)), np.zeros(3)]])
        np.testing.assert_allclose(new.by_leading[0], np.hstack([by_pose, np.zeros((3, 6))]), **EXACT)
        by_pixel = by_g @ np.array([[1 / FX, 0], [0, 1 / FY], [0, 0]])
        by_rho = [*(-rho / n**2 * np.array([h[0] / FX, h[1] / FY])), 1 / (f_b * n)]
        expected = np.vstack([np.column_stack([by_pixel, np.zeros(2)]), by_rho])
        np.testing.assert_allclose(new.noise[0], expected @ noise @ expected.T, **EXACT)


class TestEuclidean:
    def test_seen_from_the_camera(self, rng):
        X, r = rng.normal(size=(2, 3))
        seen = Euclidean().relative_to(r, None, X[None])
        np.testing.assert_allclose(seen.homogeneous[0], [*(X - r), 1.0], **EXACT)
        np.testing.assert_allclose(seen.by_map[0, :3], EYE, **EXACT)
        np.testing.assert_allclose(seen.by_position[0, :3], -EYE, **EXACT)

    def test_initialisation(self, state):
        uvd, R = np.array([700.0, 150.0, 2.0]), state.R_wc
        h = CAMERA.backproject(uvd)
        noise = np.diag([1.0, 2.0, 3.0]) + 0.5
        new = first_sight(Euclidean(), CAMERA, state.position, R, uvd[None], noise)
        np.testing.assert_allclose(new.parameters[0], state.position + R @ h, **EXACT)
        np.testing.assert_allclose(new.by_leading[0], np.hstack([EYE, -R @ skew(h), np.zeros((3, 6))]), **EXACT)
        by_uvd = np.linalg.inv(CAMERA.project_jacobian(h))
        np.testing.assert_allclose(new.noise[0], R @ by_uvd @ noise @ by_uvd.T @ R.T, **EXACT)
        np.testing.assert_allclose(by_uvd[:, 2], -h / uvd[2], **EXACT)


class TestMeasurements:
    def test_the_chain(self, state):
        """H of the left pixels of a filter whose camera has moved on from the anchor."""
        slam = StereoEKF(CAMERA, StereoNoise(EYE), gate=None, measurement="left", error="so3")
        slam.reset(Start(state.position, state.orientation))
        seen = StereoObservation([7], [[700.0, 150.0, 20.0]])
        slam.update(seen)
        joint = slam.state
        now = replace(state, position=state.position + np.array([0.3, -0.1, 0.2]))
        slam.state = replace(joint, camera=now, predicted=now)
        shown = InverseDepth().relative_to(now.position, joint.anchors(), joint.parameters())
        R = now.R_wc
        h_c = shown.homogeneous[:, :3] @ R
        T = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        C = CAMERA.project_scaled_jacobian(h_c[0], shown.homogeneous[0, 3])
        C_h, C_s = C[:, :3], C[:, 3:]
        H = linearised(slam, seen).H[0]
        np.testing.assert_allclose(H[:, :3], T @ C_h @ R.T @ shown.by_position[0, :3], **EXACT)
        np.testing.assert_allclose(H[:, 3:6], T @ C_h @ skew(h_c[0]), **EXACT)
        expected = T @ (C_h @ R.T @ shown.by_map[0, :3] + C_s @ shown.by_map[0, 3:])
        np.testing.assert_allclose(H[:, joint.map_rows(np.array([0]))[0]], expected, **EXACT)


class TestErrors:
    def test_the_additive_quaternion(self, state):
        delta = np.array([0.3, -0.2, 0.5])
        q, size = state.orientation, 1 + delta @ delta / 4
        retraction = AdditiveQuaternion()
        dq = _times(q, [*(delta / 2), 0.0])
        np.testing.assert_allclose(retraction.retract(q, delta), (q + dq) / np.linalg.norm(q + dq), **EXACT)
        J = np.reshape(additive_transport_of(*delta), (3, 3))
        np.testing.assert_allclose(J, (EYE - skew(delta / 2)) / size, **EXACT)

    def test_so3(self, state):
        delta = np.array([0.3, -0.2, 0.5])
        moved = RotationVector().retract(state.orientation, delta)
        np.testing.assert_allclose(rotations.matrix(moved), state.R_wc @ exp(delta), **EXACT)

    def test_what_cannot_be_seen(self, state):
        r, v = state.position, state.linear_velocity
        expected = np.vstack([-skew(r), state.R_wc.T, -skew(v), ZERO])
        np.testing.assert_allclose(gamma_of_variables(StateLayout(), state), expected, **EXACT)
        y = np.array([[0.4, -0.3, 0.07]])
        m = np.array(ray_of(*y[0, :2]))
        by_turn = [*(-jacobian_of(angles_of, m[None])[1][0] @ skew(m)), np.zeros(3)]
        start = InverseDepth().start_from

        def around(theta, at):
            return start((*turned_by(theta, m), at[2]))

        np.testing.assert_allclose(jacobian_of(around, np.zeros((1, 3)), y)[1][0], by_turn, **EXACT)

    @pytest.mark.parametrize("error", [RightInvariant(), LeftInvariant()])
    def test_an_invariant_correction(self, state, rng, error):
        """Both lines of the page, and the one they have in common."""
        delta = rng.normal(size=12)
        slam = StereoEKF(CAMERA, StereoNoise(EYE), error=error)
        layout, landmark = slam.options.layout, slam.options.landmark
        slam.state = replace(JointState.at(Start(), layout, landmark), camera=state, predicted=state, P=np.eye(12))
        moved = moved_by(slam, delta)[0].camera
        theta = state.R_wc @ delta[3:6]
        J_l = J_r(-theta)
        np.testing.assert_allclose(moved.R_wc, exp(theta) @ state.R_wc, **EXACT)
        for before, after, d in (
            (state.position, moved.position, delta[:3]),
            (state.linear_velocity, moved.linear_velocity, delta[6:9]),
        ):
            np.testing.assert_allclose(after, before + J_l @ d, **EXACT)
            np.testing.assert_allclose(after, exp(theta) @ before + J_l @ (d + skew(before) @ theta), **EXACT)
            left = before + state.R_wc @ J_r(-delta[3:6]) @ state.R_wc.T @ d
            np.testing.assert_allclose(after, left, **EXACT)

    def test_the_pose_error_of_right_invariant(self, state, rng):
        position, orientation = rng.normal(size=3), rotations.exp_quaternion(rng.normal(size=3))
        P = np.diag(rng.uniform(0.1, 1.0, 6))
        error, covariance = RightInvariant().pose_error(state, P, position, orientation)
        R, r = state.R_wc, state.position
        theta = rotations.log(rotations.matrix(orientation) @ R.T)
        J_l = J_r(-theta)
        xi = np.linalg.solve(J_l, position - exp(theta) @ r)
        np.testing.assert_allclose(error, [*xi, *theta], **EXACT)
        J = np.block([[EYE, skew(r) @ R], [ZERO, R]])
        np.testing.assert_allclose(covariance, J @ P @ J.T, **EXACT)


def _times(p, q):
    """The product of two quaternions xyzw that need not be unit."""
    a, s, b, t = np.array(p[:3]), p[3], np.array(q[:3]), q[3]
    return np.array([*(s * b + t * a + np.cross(a, b)), s * t - a @ b])


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_code_points_at_its_derivation(path):
    """Each page names its code in its first line, and that code names the page."""
    line = next(line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("Code:"))
    named = re.findall(r"`((?:filters|stereo_slam_env)/[\w/]+\.py)`", line.split("Tests:")[0])
    assert named
    for name in named:
        assert f"docs/derivations/{path.name}" in (ROOT / name).read_text(encoding="utf-8"), name
