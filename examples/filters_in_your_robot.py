"""The package `filters` in the loop of a robot: no simulator, no Gymnasium, only NumPy and SciPy.

The loop needs pixels and disparities with lasting ids (from your tracker), the velocities of the wheels, and the time.
It gets a pose with its covariance, a forecast of each landmark, and an alarm where the measurements do not fit the
belief. Replace `Robot` by yours.

Run it: python examples/filters_in_your_robot.py
"""

import sys

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, StereoCamera, StereoNoise, StereoObservation, VelocityDriven, make_filter

CAMERA = StereoCamera(fx=420.0, fy=420.0, cx=320.0, cy=240.0, baseline=0.12, width=640, height=480)
PERIOD, SPEED, YAW_RATE = 0.1, 0.8, 0.15  # s, m/s, rad/s
ODOMETRY_SIGMAS = np.array([0.03, 0.03, 0.03, 0.01, 0.01, 0.01])  # m/s, rad/s


class Robot:
    """A stand-in for your hardware: wheels, a stereo camera, and a tracker that keeps ids."""

    def __init__(self, rng):
        self.rng, self.position, self.R_wc = rng, np.zeros(3), np.eye(3)
        angles, distances = rng.uniform(-np.pi, np.pi, 400), rng.uniform(2, 12, 400)
        heights = rng.uniform(-1.5, 0.5, 400)  # y points down
        self.points = np.column_stack([distances * np.sin(angles), heights, distances * np.cos(angles)])

    def drive(self):
        """Move for a period; the measured body velocity."""
        half = Rotation.from_rotvec([0.0, 0.5 * YAW_RATE * PERIOD, 0.0]).as_matrix()
        self.position = self.position + self.R_wc @ half @ [0.0, 0.0, SPEED * PERIOD]
        self.R_wc = self.R_wc @ half @ half
        said = np.array([0.0, 0.0, SPEED, 0.0, YAW_RATE, 0.0]) + ODOMETRY_SIGMAS * self.rng.normal(size=6)
        return BodyVelocity(said[:3], said[3:], np.diag(ODOMETRY_SIGMAS**2))

    def look(self, most=60):
        """Landmarks in view: ids, left pixels and disparities."""
        p_c = (self.points - self.position) @ self.R_wc
        ids = np.flatnonzero(p_c[:, 2] > 0.5)
        uvd = CAMERA.project(p_c[ids])
        inside = np.flatnonzero(CAMERA.in_view(uvd))[:most]
        noise = self.rng.multivariate_normal(np.zeros(3), NOISE.R, len(inside))
        return StereoObservation(ids[inside], uvd[inside] + noise)


NOISE = StereoNoise.independent_pixels(0.7)  # your tracker's, px
robot = Robot(np.random.default_rng(0))
slam = make_filter(
    "shared-anchor",
    camera=CAMERA,
    noise=NOISE,
    motion=VelocityDriven(),
    drop_unseen=False,
    gate=0.99,
)
slam.reset()  # the robot starts in the origin of its map
slam.update(robot.look())
for step in range(1, 101):
    slam.predict(PERIOD, robot.drive())
    expected = slam.forecast()  # where a tracker would search: expected.uvd, within expected.S
    report = slam.update(robot.look())
    if report.nis_dof and report.nis > 2.0 * report.nis_dof:
        print(f"{step * PERIOD:.1f} s: the measurements do not fit (NIS {report.nis:.0f} of {report.nis_dof})")
    if step % 25 == 0:
        sigma = np.sqrt(np.trace(slam.pose.covariance[:3, :3]))
        error = np.linalg.norm(slam.pose.position - robot.position)
        print(
            f"{step * PERIOD:4.1f} s: sigma {sigma:.3f} m, true error {error:.3f} m; "
            f"{int(expected.in_view.sum())} of {len(slam.landmarks.ids)} landmarks expected in view, "
            f"{len(report.gated)} gated"
        )
assert "stereo_slam_env" not in sys.modules
