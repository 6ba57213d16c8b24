"""Judge systems by their files alone: 20 simulated flights, an inertial filter and a smoother that write trajectories.

    python benchmarks/foreign_monte_carlo.py --out sims                # two minutes
    python benchmarks/foreign_monte_carlo.py --out sims --sheet bmi088  # with errors of scale that no filter models

It writes, for each seed, what `stereo-slam scenes record` and a user's own program would leave: the truth in the layout
of EuRoC, `inertial.square` and `fixed-lag.square` with the covariances of the pose, and `state_estimate.txt` with
`state_deviation.txt` as OpenVINS has them. Then `stereo-slam evaluate` judges each by its pattern.

The body has the axes of the inertial unit and the origin of the left camera, so that no lever arm turns its velocity.
Its world is the first camera turned so that z is up.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import filters
from filters import Pose
from filters.geometry import rotations
from harness import arguments, by_seed
from stereo_slam_env.benchmark.recordings.inertial_problem import PERIOD, inertial_drive, inertial_flight
from stereo_slam_env.cli import app
from stereo_slam_env.loop import run
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.recording.state_beliefs import StateBelief
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import save_trajectory
from stereo_slam_env.sensing.imu import DATA_SHEETS, DataSheet, Imu

T_CB = Pose([0.0, 0.0, 0.0], Imu().orientation)
"""The body in the left camera."""
Z_UP = Pose([0.0, 0.0, 0.0], rotations.exp_quaternion(np.array([-0.5 * np.pi, 0.0, 0.0])))
"""The world of the first camera, whose y is down, in one whose z is up."""
EXACT = "exact"
"""Data sheet without errors of scale and alignment, which the filter does not model."""
EUROC = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], "
    "b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]"
)
OPENVINS = "# timestamp(s) q p v bg ba cam_imu_dt num_cam cam0_k cam0_d cam0_rot cam0_trans ... etc"


def main() -> None:
    """Write the files of all seeds, then judge each system by its pattern."""
    given = arguments(__doc__, out=Path, seeds=20, jobs=2, frames=200, drive=("flight", "drive"), sheet=EXACT)
    by_seed(simulate, given.seeds, given.jobs, given.out, given.drive, given.frames, given.sheet)
    for name in ("inertial.square", "fixed-lag.square", "state_estimate.txt"):
        sys.stdout.write(f'\n$ stereo-slam evaluate "{given.out}/{{seed}}/{name}"\n')
        sys.stdout.flush()
        app.main(["evaluate", str(given.out / "{seed}" / name)])


def simulate(seed: int, out: Path, drive: str, frames: int, sheet_name: str) -> None:
    """One drive, and what two systems write of it."""
    sheet = replace(DATA_SHEETS["adis16448"], scale=0.0, misalignment=0.0)
    if sheet_name != EXACT:
        sheet = DATA_SHEETS[sheet_name]
    make = {"flight": inertial_flight, "drive": inertial_drive}[drive]
    recording = make(seed, frames=frames, imu=sheet)
    folder = out / f"{seed:03d}"
    (folder / "mav0" / "state_groundtruth_estimate0").mkdir(parents=True, exist_ok=True)
    write_truth(folder / "mav0" / "state_groundtruth_estimate0" / "data.csv", truth_of(recording, seed, sheet))
    inertial = estimate_of(recording, "inertial")
    write_states(folder, inertial)
    save_trajectory(folder / "inertial.square", inertial)
    save_trajectory(folder / "fixed-lag.square", estimate_of(recording, "fixed-lag"))


def truth_of(recording: Recording, seed: int, sheet: DataSheet) -> Trajectory:
    """The body, with velocity and biases; these are drawn again, as the recording does not hold them."""
    frames = recording.frames
    errors = Imu(sheet).errors(np.random.default_rng(seed).spawn(5)[2])
    biases = [errors.bias]
    for frame in frames[1:]:
        errors.added(np.zeros((len(frame.inertial.times), 6)), PERIOD)
        biases.append(errors.bias)
    velocity = StateBelief(np.array([frame.truth_velocity.linear for frame in frames]))
    states = {
        "velocity": velocity,
        "gyro-bias": StateBelief(np.array(biases)[:, :3]),
        "accelerometer-bias": StateBelief(np.array(biases)[:, 3:]),
    }
    positions, orientations = zip(*((frame.truth.position, frame.truth.orientation) for frame in frames), strict=True)
    times = np.array([frame.timestamp for frame in frames])
    return in_body(Trajectory(np.array(positions), np.array(orientations), times), states)


def estimate_of(recording: Recording, name: str) -> Trajectory:
    """The body as a filter has it after each frame, with velocity and biases of the inertial one."""
    slam = filters.make_filter(name, camera=recording.camera, noise=recording.noise, gate=None)
    poses, velocities, biases = [], [], []
    for moment in run(slam, recording, use_odometry=False):
        poses.append(moment.pose)
        if name == "inertial":
            velocities.append(slam.velocity)
            biases.append(slam.belief("imu-bias"))
    states = {}
    if name == "inertial":
        b, P = np.array([one.value for one in biases]), np.array([one.covariance for one in biases])
        states["velocity"] = StateBelief(
            np.array([v.linear for v in velocities]), np.array([v.covariance[:3, :3] for v in velocities])
        )
        states["gyro-bias"] = StateBelief(b[:, :3], P[:, :3, :3])
        states["accelerometer-bias"] = StateBelief(b[:, 3:], P[:, 3:, 3:])
    times = np.array([frame.timestamp for frame in recording.frames])
    positions, orientations, P = (
        np.array([getattr(pose, part) for pose in poses]) for part in ("position", "orientation", "covariance")
    )
    return in_body(Trajectory(positions, orientations, times, P, name=name, body="body"), states)


def in_body(camera: Trajectory, states: dict[str, StateBelief]) -> Trajectory:
    """A trajectory of the body, of one of the camera; states are of the body already, but for the world."""
    return replace(replace(camera.of_body(T_CB), states=states).moved(Z_UP), body="body")


def write_truth(path: Path, truth: Trajectory) -> None:
    """The file of EuRoC: nanoseconds, scalar part first."""
    rows = np.column_stack(
        [
            1e9 * truth.timestamps,
            truth.positions,
            truth.orientations[:, [3, 0, 1, 2]],
            *(belief.values for belief in truth.states.values()),
        ]
    )
    np.savetxt(path, rows, fmt=["%.0f", *["%.12g"] * 16], delimiter=",", header=EUROC, comments="")


def write_states(folder: Path, estimate: Trajectory) -> None:
    """The two files of OpenVINS, with its digits and a calibration of no camera behind."""
    times, states = estimate.timestamps[:, None], estimate.states.values()
    values = np.column_stack([times, estimate.orientations, estimate.positions, *(state.values for state in states)])
    P = estimate.covariances[:, [3, 4, 5, 0, 1, 2]][:, :, [3, 4, 5, 0, 1, 2]]
    variances = [np.diagonal(one, axis1=1, axis2=2) for one in (P, *(state.covariances for state in states))]
    calibration = np.zeros((len(times), 2))
    for name, rows in (("estimate", values), ("deviation", np.column_stack([times, *map(np.sqrt, variances)]))):
        table = np.column_stack([rows, calibration])
        formats = ["%.5f", *["%.6f"] * (table.shape[1] - 3), "%.7f", "%.0f"]
        np.savetxt(folder / f"state_{name}.txt", table, fmt=formats, header=OPENVINS.removeprefix("# "))


if __name__ == "__main__":
    main()
