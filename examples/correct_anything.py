"""Use what no camera measures, here a position from outside and a vehicle that stays on its plane: `slam.correct`."""

import numpy as np

import stereo_slam_env as sse
from filters import Pose, make_filter

recording = sse.record("StereoSlam/Drive-v0", seed=0, route="right-turn", policy="route", frames=40)
slam = make_filter("right-invariant", camera=recording.camera, noise=recording.noise)
rng, nothing = np.random.default_rng(0), np.zeros((3, 3))
for moment in sse.run(slam, recording):
    if moment.number == 0:
        slam.clone_pose("start")
    pose, velocity = slam.pose, slam.velocity
    R_wc = Pose(pose.position, pose.orientation).R_wc
    vx, vy, vz = R_wc.T @ velocity.linear
    # No velocity along the camera's y axis, to 1 cm/s: innovation, Jacobian by the errors of variables, covariance.
    H = {"velocity": [[*R_wc[:, 1], 0, 0, 0]], "pose": [[0, 0, 0, vz, 0, -vx]]}
    slam.correct([0.0 - vy], H, [[0.01**2]])
    if moment.number % 10 == 9:
        gps = moment.truth.position + rng.normal(0.0, 0.05, 3)
        told = slam.correct(gps - slam.pose.position, {"pose": np.hstack([np.eye(3), nothing])}, 0.05**2 * np.eye(3))
        print(f"frame {moment.number}: normalised innovation squared of the position {told.nis:.2f}, expected 3")
error = np.linalg.norm(slam.pose.position - moment.truth.position)
print(f"{np.linalg.norm(slam.relative_pose('start').position):.1f} m since the start, {1000 * error:.0f} mm wrong")
