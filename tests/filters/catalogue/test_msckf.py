"""The multi-state constraint filter: its algebra against the Schur form, consistency, error, and what it never uses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import ColouredNoise, StereoEKF, StereoNoise, StereoObservation, make_filter
from filters.geometry import symmetric

from ..dense import gamma
from ..drives import CAMERA, INDEPENDENT_PIXELS, drive, finish, run, start
from ..inertial_drives import DT, START_SIGMAS, Journey, Path, Poses, driven, flown

INERTIAL = {"motion": {"name": "strapdown", "sigma_gravity": 1e-4}, "gate": None}
WINDOW = 5


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def linearised(poses: np.ndarray, uvd: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened H by the poses, H by the point in W, and residual at the point that Gauss-Newton finds.

    Its image walks from frame to frame by a share of the standard deviation of a measurement.
    """
    frames = np.arange(len(uvd))
    over_frames = np.eye(len(uvd)) + share**2 * np.minimum.outer(frames, frames)
    whiten = np.linalg.inv(np.linalg.cholesky(np.kron(over_frames, INDEPENDENT_PIXELS.R)))
    Rs = Rotation.from_quat(poses[:, 3:]).as_matrix()
    point = poses[0, :3] + Rs[0] @ CAMERA.backproject(uvd[0])
    for _ in range(12):
        p_c = np.einsum("kij,kj->ki", Rs.transpose(0, 2, 1), point - poses[:, :3])
        J = CAMERA.project_jacobian(p_c)
        H_f = whiten @ (J @ Rs.transpose(0, 2, 1)).reshape(-1, 3)
        r = whiten @ (uvd - CAMERA.project(p_c)).ravel()
        point = point + np.linalg.lstsq(H_f, r, rcond=None)[0]
    H = np.zeros((len(r), 6 * len(poses)))
    for k in range(len(poses)):
        H[3 * k : 3 * k + 3, 6 * k : 6 * k + 6] = J[k] @ np.hstack([-Rs[k].T, skew(p_c[k])])
    return whiten @ H, H_f, r


class SchurWindow:
    """The plain filter in its Schur form (SchurVINS), of public calls: tracks that end or fill the window correct it.

    With H by the poses, H_f by the point and r the residual it is A = H^T H - W V^-1 W^T and b = H^T r - W V^-1 g,
    W = H^T H_f, V = H_f^T H_f, g = H_f^T r. The sum of A over the tracks is singular: its square root is a measurement.
    """

    def __init__(self, share: float) -> None:
        options = {"landmark": "shared-anchor", "error": "right-invariant", "gate": None}
        self.share = share
        self.slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options))
        self.tracks: dict[int, list[tuple[str, np.ndarray]]] = {}

    def update(self, number: int, seen: StereoObservation) -> None:
        at = dict(zip(seen.ids.tolist(), seen.uvd, strict=True))
        done = [i for i, track in self.tracks.items() if i not in at or len(track) == WINDOW]
        names = list(self.slam.clones)
        A, b = np.zeros((6 * len(names), 6 * len(names))), np.zeros(6 * len(names))
        for track in map(self.tracks.pop, done):
            if len(track) < 3:
                continue
            own = [name for name, _ in track]
            poses, uvd = self.slam.belief(*own).value.reshape(-1, 7), np.array([uvd for _, uvd in track])
            H, H_f, r = linearised(poses, uvd, self.share)
            W, V, g = H.T @ H_f, H_f.T @ H_f, H_f.T @ r
            rows = (6 * np.array([names.index(n) for n in own])[:, None] + np.arange(6)).ravel()
            A[np.ix_(rows, rows)] += H.T @ H - W @ np.linalg.solve(V, W.T)
            b[rows] += H.T @ r - W @ np.linalg.solve(V, g)
        if A.any():
            size, axes = np.linalg.eigh(A)
            there = size > 1e-9 * size.max()
            root, axes = np.sqrt(size[there]), axes[:, there]
            H = np.hsplit((axes * root).T, len(names))
            self.slam.correct(axes.T @ b / root, dict(zip(names, H, strict=True)), np.eye(len(root)))
        if len(names) == WINDOW:
            self.slam.forget_clone(names[0])
        self.slam.clone_pose(str(number))
        for i, uvd in at.items():
            self.tracks.setdefault(i, []).append((str(number), uvd))


@pytest.mark.parametrize("share", [0.0, 0.7])
def test_null_space_and_schur_form_are_the_same(share: float) -> None:
    """Over 14 frames with tracks that end and tracks that outlive the window, to 1e-9; without a map."""
    noise = ColouredNoise(INDEPENDENT_PIXELS.R, drift=share) if share else INDEPENDENT_PIXELS
    schur, slam = (
        SchurWindow(share),
        start(make_filter("msckf", camera=CAMERA, noise=noise, map_landmarks=0, window=WINDOW, gate=None)),
    )
    for number, frame in enumerate(drive(0, 14, depths=(6.0, 40.0))):
        if number:
            schur.slam.predict(DT)
            slam.predict(DT)
        schur.update(number, frame.observation)
        slam.update(frame.observation)
    assert len(slam.landmarks.ids) == 0
    np.testing.assert_allclose(slam.pose.position, schur.slam.pose.position, atol=1e-9)
    np.testing.assert_allclose(slam.pose.orientation, schur.slam.pose.orientation, atol=1e-9)
    scale = np.abs(slam.pose.covariance).max()
    np.testing.assert_allclose(slam.pose.covariance, schur.slam.pose.covariance, atol=1e-9 * scale)


def scores(
    path: Path,
    runs: int,
    filter_name: str,
    *,
    walk: float = 0.0,
    noise: StereoNoise = INDEPENDENT_PIXELS,
    **options: object,
) -> tuple[np.ndarray, float]:
    """NEES / 6 of each run and the root mean square of the position error over the second half of all."""
    found, errors = [], []
    for seed in range(runs):
        journey = Journey.along(path, seed, 8.0, tracked=40, walk=walk)  # more than the map has room for
        slam = make_filter(filter_name, camera=CAMERA, noise=noise, **options)
        slam.reset(journey.start)
        nees = []
        for k, step in enumerate(journey.steps):
            if k:
                slam.predict(DT, inertial=step.inertial if "motion" in options else None)
            slam.update(step.observation)
            error, covariance = slam.pose_error(step.position, step.orientation)
            nees.append(error @ np.linalg.solve(covariance, error) / 6.0)
            if k > 40:
                errors.append(np.sum((slam.pose.position - step.position) ** 2))
        found.append(np.mean(nees))
    return np.array(found), float(np.sqrt(np.mean(errors)))


@pytest.mark.parametrize(
    "runs", [3, pytest.param(8, marks=[pytest.mark.slow, pytest.mark.timeout(900)])], ids=["few", "many"]
)
@pytest.mark.parametrize("path", [driven, flown], ids=["drives", "flights"])
def test_it_is_consistent_and_about_as_exact_as_slam(path: Path, runs: int) -> None:
    """40 tracks, 30 landmarks in the map. 8 runs: NEES / 6 1.1, error 1.05 and 1.14 of the EKF's."""
    nees, error = scores(path, runs, "msckf", **INERTIAL)
    _, of_slam = scores(path, runs, "inertial", **INERTIAL)
    assert (0.8 < nees.mean() < 1.2) if runs == 8 else (0.4 < nees.mean() < 2.0)
    assert error < (1.15 if runs == 8 else 1.5) * of_slam


@pytest.mark.parametrize("map_landmarks", [30, 0])
def test_tracks_that_walk_leave_it_consistent_where_the_noise_says_so(map_landmarks: int) -> None:
    """3 flights whose points walk in the image by 0.4 sigma a frame: NEES / 6 of 1; taken for white 77 and 1.8."""
    options = {**INERTIAL, "map_landmarks": map_landmarks}
    told, _ = scores(flown, 3, "msckf", walk=0.4, noise=ColouredNoise(INDEPENDENT_PIXELS.R, drift=0.4), **options)
    white, _ = scores(flown, 3, "msckf", walk=0.4, **options)
    assert 0.4 < told.mean() < 2.0
    assert white.mean() > 1.4 * told.mean()


@pytest.mark.parametrize("map_landmarks", [30, 0])
def test_no_heading_is_learnt(map_landmarks: int) -> None:
    """The information on a yaw about the start is that of its prior, .3 rad, after 10 s of flight."""
    sigmas = START_SIGMAS.copy()
    sigmas[:6] = 0.0, 0.0, 0.0, 1e-3, 0.3, 1e-3
    journey = Journey.along(flown, 0, 10.0, sigmas)
    prior = np.diag(np.repeat([1e-6, 0.3, 100.0, 0.05], 3) ** 2)
    slam = make_filter("msckf", camera=CAMERA, noise=INDEPENDENT_PIXELS, map_landmarks=map_landmarks, **INERTIAL)
    assert isinstance(slam, StereoEKF)
    nees = replace(journey, start=replace(journey.start, covariance=prior)).run(slam)
    slam.forget_clone(slam.clones[-1])  # the pose itself, so that P would be singular
    state = slam.state
    yaw, P = gamma(state) @ np.array([0.0, 1.0, 0.0]), symmetric.full(state.P)
    there = np.diag(P) > 0.0
    information = yaw[there] @ np.linalg.solve(P[np.ix_(there, there)], yaw[there])
    assert 0.3**2 * information == pytest.approx(1.0, abs=1e-3)
    assert nees[-20:].mean() / 6.0 < 2.0


def test_a_monocular_inertial_filter_finds_the_scale_and_reads_no_disparity() -> None:
    """The speed at the start is known to .5 m/s only; wrong disparities change no bit."""

    def run(seconds: float, disparity: float) -> tuple[StereoEKF, np.ndarray, np.ndarray]:
        journey = Journey.along(flown, 1, seconds)
        steps = tuple(replace(s, observation=_with_disparity(s.observation, disparity)) for s in journey.steps)
        slam = make_filter(
            "msckf", camera=CAMERA, noise=INDEPENDENT_PIXELS, measurement="left", map_landmarks=0, **INERTIAL
        )
        assert isinstance(slam, StereoEKF)
        return slam, replace(journey, steps=steps).run(slam), steps[-1].position

    slam, nees, position = run(8.0, 0.0)
    assert np.linalg.norm(slam.pose.position - position) < 0.3
    assert nees[-30:].mean() / 6.0 < 3.0
    here, there = (run(2.0, disparity)[0].pose.position for disparity in (0.0, 500.0))
    np.testing.assert_array_equal(here, there)


def rested(t: np.ndarray) -> Poses:
    """The flight after 3 s at rest, from which it starts with 2 of its seconds a squared second."""
    moving = np.maximum(t - 3.0, 0.0)
    return flown(moving**2 / (moving + 1.0))


@pytest.mark.parametrize("gate", [0.99, None])
def test_a_rest_at_the_start_does_no_harm_to_one_camera(gate: float | None) -> None:
    """With a clone in each frame and all tracks used: .16 to 12 m with the gate, .28 to .53 without; now .03 to .08."""
    options = {**INERTIAL, "measurement": "left", "map_landmarks": 0, "gate": gate}
    for seed in range(3):
        journey = Journey.along(rested, seed, 8.0, tracked=40)
        slam = make_filter("msckf", camera=CAMERA, noise=INDEPENDENT_PIXELS, **options)
        assert isinstance(slam, StereoEKF)
        resting = replace(journey, steps=journey.steps[:30])
        resting.run(slam)
        assert len(slam.clones) == 1  # kept by motion
        assert np.linalg.norm(slam.velocity.linear) < 0.03  # it stands, as it was not told
        nees = journey.run(slam)
        assert np.linalg.norm(slam.pose.position - journey.steps[-1].position) < 0.3
        assert nees[-30:].mean() / 6.0 < 3.0


def test_turning_on_the_spot_is_no_parallax() -> None:
    """Tracks without parallax say how the camera has turned, nothing of its way: NEES / 6 was 4, now it is .1."""

    def turning(t: np.ndarray) -> Poses:
        return flown(0.0 * t)[0], Rotation.from_rotvec(np.outer(0.5 * np.sin(0.7 * t), [0.0, 1.0, 0.0]))

    journey = Journey.along(turning, 0, 8.0, tracked=40)
    options = {**INERTIAL, "measurement": "left", "map_landmarks": 0}
    slam = make_filter("msckf", camera=CAMERA, noise=INDEPENDENT_PIXELS, **options)
    assert isinstance(slam, StereoEKF)
    nees = journey.run(slam)
    assert nees[-30:].mean() / 6.0 < 1.0
    turn = Rotation.from_quat(slam.pose.orientation).inv() * Rotation.from_quat(journey.steps[-1].orientation)
    assert turn.magnitude() < 0.015


def _with_disparity(seen: StereoObservation, disparity: float) -> StereoObservation:
    return StereoObservation(seen.ids, np.column_stack([seen.uvd[:, :2], np.full(len(seen), disparity)]))


def test_a_wild_track_is_gated_and_a_point_behind_is_no_point() -> None:
    slam = make_filter("msckf", camera=CAMERA, noise=INDEPENDENT_PIXELS, map_landmarks=0)
    frames = drive(0, 6, missed=0.0)
    wild, reports = int(frames[0].observation.ids[0]), []
    for k, frame in enumerate(frames):
        uvd = frame.observation.uvd.copy()
        uvd[frame.observation.ids == wild, :2] += 40.0 * (k % 2)
        frames[k] = replace(frame, observation=StereoObservation(frame.observation.ids, uvd))
    reports = list(run(start(slam), frames))
    slam.predict(DT)
    reports.append(slam.update(StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))))
    assert wild in np.concatenate([report.gated for report in reports])
    assert wild not in np.concatenate([report.updated for report in reports])


def test_forgotten_tracks_correct_nothing() -> None:
    frames = drive(0, 6, missed=0.0)
    slam = make_filter("msckf", camera=CAMERA, noise=INDEPENDENT_PIXELS, map_landmarks=0)
    assert isinstance(slam, StereoEKF)
    finish(slam, frames)
    slam.forget(np.unique(np.concatenate([frame.observation.ids for frame in frames])))
    slam.predict(DT)
    assert slam.update(StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))).nis_dof == 0


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"window": 2}, r"^window must be an integer >= 3, got 2$"),
        ({"measurement": "left"}, r"^map_landmarks must be 0 with measurement='left', got 30: see its page$"),
        ({"map_landmarks": -1}, r"^map_landmarks must be an integer >= 0, got -1$"),
        ({"measurement": "stacked"}, r"^measurement must be 'joint' or 'left' with a window, got Stacked$"),
        ({"error": "first-estimates"}, r"^error must linearise at the state with a window, got FirstEstimates$"),
    ],
)
def test_what_it_cannot_do_is_refused(option: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_filter("msckf", camera=CAMERA, noise=INDEPENDENT_PIXELS, **option)


def test_the_nis_does_not_depend_on_the_order_of_the_tracks() -> None:
    """Rows without any information, of where all clones are together, would give it what rounding makes of them."""
    sums, order = [], np.random.default_rng(3).permutation(2000)
    for names in (np.arange(2000), order):
        options, nis = {"window": WINDOW, "map_landmarks": 0}, []
        slam = start(make_filter("msckf", camera=CAMERA, noise=INDEPENDENT_PIXELS, **options))
        for k, frame in enumerate(drive(1, 12, visible=150)):
            if k:
                slam.predict(0.1)
            seen = frame.observation
            report = slam.update(StereoObservation(names[seen.ids], seen.uvd))
            nis.append((report.nis, report.nis_dof))
        sums.append(nis)
    assert 6 * (WINDOW - 1) in [dof for _, dof in sums[0]]  # of 30 columns: what many tracks say, without the gauge
    np.testing.assert_allclose(*sums, rtol=1e-9)
