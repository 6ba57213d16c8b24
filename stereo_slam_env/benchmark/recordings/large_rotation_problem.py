"""Large orientation uncertainty: a tumbling camera in a sparse cloud, all noise proportional to what is measured.

The simulation of Zhang, Wu, Song, Huang and Dissanayake, "Convergence and Consistency Analysis for a 3-D
Invariant-EKF SLAM" (RA-L 2017): 500 steps, 300 landmarks, and a standard deviation of `level` times the value for
every component of the odometry and of every measured point. Path, turn rates (0.67 rad a step on average) and the
box of landmarks are those of the simulation its authors released. What had to be chosen, for a stereo camera:

- The published sensor sees points up to 120 degrees off its axis within 25 m, 6.5 of the 300 at a time. A pinhole
  camera does not; here it is 120 degrees wide and sees to 35 m, which gives the same number.
- The noise of a point is Gaussian in (x, y, z) with covariance Psi, carried to (u, v, d) by the Jacobian J of the
  projection: R = J Psi J^T is then exactly the covariance of what is measured. Projecting a noisy point would add a
  bias that no filter models.
- Psi is made of the true point and the covariance of the odometry of the true motion, so that the noise a filter is
  told is the noise there is. Values below 0.1 m and 0.01 rad count as these: R stays regular.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, StereoCamera, StereoNoise, StereoObservation
from filters.validation import FloatArray, positive
from stereo_slam_env.recording.recording import SIMULATION, Frame, LandmarkTruth, Pose, Recording, Start, Velocity

CAMERA = StereoCamera(230.0, 230.0, 399.5, 399.5, 0.5, 800, 800)
SIGHT = 35.0  # m
NEAREST = 1.0  # m
MARGIN = 30.0  # m, of the box of landmarks around the path
SMALLEST_LENGTH, SMALLEST_ANGLE = 0.1, 0.01
KNOWN_START = 1e-6


def relative_noise_loop(
    seed: int, level: float = 0.05, frames: int = 500, landmarks: int = 300, sight: float = SIGHT
) -> Recording:
    """The tumbling camera, with odometry in every frame and an R for every measurement.

    Parameters
    ----------
    seed : int
        Of the landmarks and of all noise; the path is always the same.
    level : float
        Standard deviation of the noise, relative to what is measured; 0.01 and 0.05 are published.
    frames : int
        Length, one second each.
    landmarks : int
        Landmarks in the box.
    sight : float
        How far the camera sees, m: the fewer landmarks in view, the larger the uncertainty.

    Raises
    ------
    ValueError
        level or sight is not positive, fewer than 2 frames or no landmark.
    """
    level, sight = positive("level", level), positive("sight", sight)
    if frames < 2:
        raise ValueError(f"frames must be at least 2, got {frames!r}")
    if landmarks < 1:
        raise ValueError(f"landmarks must be at least 1, got {landmarks!r}")
    rng = np.random.default_rng(seed)
    positions, rotations = _path(frames)
    box = positions.min(axis=0) - MARGIN, positions.max(axis=0) + MARGIN
    # W is the first camera frame.
    to_w, origin = rotations[0].inv(), positions[0]
    points_w = to_w.apply(rng.uniform(*box, (landmarks, 3)) - origin)
    positions, rotations = to_w.apply(positions - origin), to_w * rotations

    taken = []
    for k in range(frames):
        odometry, velocity = None, None
        if k:
            odometry, velocity = _step(positions[k - 1 : k + 1], rotations[k - 1 : k + 1], level, rng)
        observation = _observe(rotations[k].inv().apply(points_w - positions[k]), level, sight, rng)
        pose = Pose(positions[k], rotations[k].as_quat())
        taken.append(Frame(float(k), observation, odometry, truth=pose, truth_velocity=velocity))
    return Recording(
        "relative-noise-loop",
        CAMERA,
        tuple(taken),
        StereoNoise.independent_pixels(1.0),  # not used: every measurement brings its own
        Start(covariance=KNOWN_START**2 * np.eye(12)),
        LandmarkTruth(np.arange(landmarks), points_w),
        {"problem": "relative-noise-loop", "seed": seed, "level": level, "frames": frames}
        | {"landmarks": landmarks, "sight": sight},
        SIMULATION,
    )


def _path(frames: int) -> tuple[FloatArray, Rotation]:
    """Positions (frames, 3), m, on a closed curve of about 100 x 80 x 40 m, and orientations that tumble."""
    k = np.arange(frames)
    positions = np.stack([50 * np.cos(0.075 * k), 40 * np.sin(0.05 * k), 20 * np.sin(0.05 * k + 1.0)], axis=1)
    return positions, Rotation.from_euler("xyz", np.stack([0.5 * k + 2.0, -0.3 * k, 0.4 * k], axis=1))


def _step(
    positions: FloatArray, rotations: Rotation, level: float, rng: np.random.Generator
) -> tuple[BodyVelocity, Velocity]:
    """Odometry of one step, the linear part in the camera frame half-way through the turn; and the true velocity."""
    moved = positions[1] - positions[0]
    turn = (rotations[0].inv() * rotations[1]).as_rotvec()
    half_way = rotations[0] * Rotation.from_rotvec(0.5 * turn)
    linear = half_way.inv().apply(moved)
    smallest = np.repeat([SMALLEST_LENGTH, SMALLEST_ANGLE], 3)
    sigmas = level * np.maximum(np.abs(np.concatenate([linear, turn])), smallest)
    errors = sigmas * rng.standard_normal(6)
    return BodyVelocity(linear + errors[:3], turn + errors[3:], np.diag(sigmas**2)), Velocity(moved, turn)


def _observe(points_c: FloatArray, level: float, sight: float, rng: np.random.Generator) -> StereoObservation:
    """What is seen of the points (N, 3), given in the camera frame."""
    ids = np.flatnonzero((points_c[:, 2] > NEAREST) & (np.linalg.norm(points_c, axis=1) < sight))
    ids = ids[CAMERA.in_view(CAMERA.project(points_c[ids]))]
    seen = points_c[ids]
    sigmas = level * np.maximum(np.abs(seen), SMALLEST_LENGTH)
    J = CAMERA.project_jacobian(seen)
    root = J * sigmas[:, None, :]
    errors = np.einsum("mij,mj->mi", root, rng.standard_normal(seen.shape))
    return StereoObservation(ids, CAMERA.project(seen) + errors, R=root @ root.transpose(0, 2, 1))
