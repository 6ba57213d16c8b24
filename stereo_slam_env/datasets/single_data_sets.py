"""Readers of five data sets that people know by name, each alone in its layout; the table of them is at the end.

Options of several of them: `sigma_px` of a pixel coordinate, `sigma_u`, `sigma_v`, `sigma_d` of left pixel and
disparity (px, independent), `sigma_linear` and `sigma_angular` of velocities (m/s, rad/s, per axis, white) are standard
deviations; `image_size` is (width, height), px. None takes those of the public recording for that recording, else
`stated_or_assumed`. `max_per_frame` thins tracks to so many landmarks at a time, long tracks first; None keeps all. W
is the left camera at the first frame. A damaged file, NaN and an impossible option raise a `ValueError` that names it.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import InertialUnit, Pose, Start
from filters.contract.extras import require_module
from filters.contract.validation import positive
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.datasets import track_files as point_tracks
from stereo_slam_env.datasets.image_files import numbered_images
from stereo_slam_env.datasets.layouts import POSITION, ImagesRow, known_by, reference_for
from stereo_slam_env.datasets.sequence import Choice, ImageFiles, RecordedSequence, known_poses, poses_of_rows, rig_of
from stereo_slam_env.datasets.track_files import ASSUMED, SPEEDS, PointTracks, TrackFiles, TracksRow, camera_velocities
from stereo_slam_env.files.opening import is_there, require_inside
from stereo_slam_env.files.readers import finite_rows, read_archive, read_poses, read_table, split_poses
from stereo_slam_env.recording.inertial import samples_of_steps
from stereo_slam_env.recording.recording import LandmarkTruth, Recording, Reference
from stereo_slam_env.recording.trajectory_transforms import OPTICAL_TO_BASE
from stereo_slam_env.sensing.projections import projections

_log = logging.getLogger(__name__)
_Factors = tuple[tuple[float, ...], PointTracks, PointTracks, dict[str, Any]]


def _kitti07_tracks(path: Path, *, max_per_frame: int | None = None) -> TrackFiles:
    """Stereo feature tracks with noisy velocities, as those over the whole of KITTI odometry 07 are stored.

    25 to 120 landmarks a frame. Frames after the last pose have no truth. Measurements that repeat the frame before are
    left out and counted, and their tracks go on as new landmarks (`without_repeats`).
    """
    arrays = read_archive(path / "tracks.npz", KITTI07_TRACKS.arrays)
    times, K, T = arrays["time_stamps"], arrays["K"], arrays["cam_T_imu"]
    positions, orientations = read_poses(path / "poses.txt")
    truth = _poses(positions[: len(times)], orientations[: len(times)])
    beyond = [None] * (len(times) - len(truth))
    rig = K[0, 0], K[1, 1], K[0, 2], K[1, 2], arrays["b"][0]
    tracks, repeats = point_tracks.without_repeats(arrays["features"].transpose(0, 2, 1))
    usable = tracks.with_positive_disparity()
    settings = {
        **{"max_per_frame": max_per_frame, "dropped_repeats": repeats},
        **{"dropped_non_positive_disparity": len(tracks) - len(usable), "frames_without_truth": len(beyond)},
    }
    # The translation is the camera position in the IMU frame, not one cam <- imu.
    velocities = arrays["linear_velocity"].T, arrays["rotational_velocity"].T, T[:3, :3], T[:3, 3]
    used = usable.thinned(max_per_frame)
    return TrackFiles(positions, times, [*truth, *beyond], rig, tracks, used, settings, velocities=velocities)


def _kitti00_stereo_tracks(
    path: Path, *, max_per_frame: int | None = 100, inertial: bool = False, rate: float | None = None
) -> TrackFiles:
    """Dense stereo feature tracks, as GTSAM's example data over the first frames of KITTI odometry 00 are stored.

    `stereo_factors.txt` (frame_id landmark_id uL uR v X Y Z, 387 to 852 landmarks a frame), `calibration.txt` (fx fy
    skew cx cy baseline), `vo_poses.txt` (frame_id, 4x4 T_world_cam by stereo odometry), `poses.txt`, and `times.txt` or
    the `rate` of frames 0, 1, 2, ..., Hz. Absent frame ids make a longer step. With `inertial` it begins with the first
    frame after which every step has samples of `imu_100hz.csv` (t on the clock of the frames, specific forces, rates).
    The truth is moved rigidly so that its first scored pose is that of the odometry: that of frame 0 need not be known.
    """
    frame_ids, matrices, odometry = _numbered_poses(path / "vo_poses.txt")
    positions, orientations = read_poses(path / "poses.txt")
    times = _times(path, rate, len(positions))
    count = min(len(times), len(positions))
    if frame_ids[-1] >= count:
        raise ValueError(f"{path}: vo_poses.txt has frame {frame_ids[-1]}, times.txt and poses.txt end at {count - 1}")
    maker = known_by(positions)
    first = int(np.searchsorted(frame_ids, 0 if maker is None else maker.first_scored))
    truth: list[Pose | None] = [None] * len(frame_ids)
    note = ""
    if first < len(frame_ids):
        places, turns = positions[frame_ids[first:]], Rotation.from_quat(orientations[frame_ids[first:]])
        turn = Rotation.from_matrix(matrices[first, :3, :3]) * turns[0].inv()
        truth[first:] = _poses(turn.apply(places - places[0]) + matrices[first, :3, 3], (turn * turns).as_quat())
        note = _MOVED.format(frame_ids[first])
    factors = _stereo_factors(path / "stereo_factors.txt", path / "calibration.txt", frame_ids, max_per_frame)
    files = TrackFiles(positions, times[frame_ids], truth, *factors, note=note)
    if not inertial:
        return files
    point_tracks.require_increasing(files.timestamps)
    table = read_table(path / INERTIAL, 7, delimiter=",", header_lines=1)
    numbers = table[:, [4, 5, 6, 1, 2, 3]]
    samples = samples_of_steps(path / INERTIAL, table[:, 0], numbers, files.timestamps, UNIT)
    first = max(k for k, step in enumerate(samples) if step is None)
    if first == len(samples) - 1:
        raise ValueError(f"{path / INERTIAL} does not reach to the last frame: it is of another recording")
    start, settings = Start(odometry[first].position, odometry[first].orientation), {"inertial": INERTIAL}
    return replace(files, samples=samples, first=first, start=start, settings={**files.settings, **settings})


def read_gtsam(*, sigma_px: float = ASSUMED["sigma_px"], max_per_frame: int | None = 100) -> Recording:
    """KITTI 00 tracks inside the gtsam wheel: 135 frames, 110 m, one turn of 90 degrees.

    The wheel has no ground truth: the reference is the stereo odometry that comes with the tracks and was fitted to
    the same pixels. It shows gross errors, not which filter is better by centimetres. Without gtsam an `ImportError`.
    """
    require_module("gtsam", "gtsam")
    import gtsam

    paths = []
    for name in EXAMPLE:
        try:
            paths.append(Path(str(gtsam.findExampleDataFile(name))))  # type: ignore[no-untyped-call,unused-ignore]
        except (FileNotFoundError, RuntimeError) as error:
            raise ValueError(f"the installed gtsam has no example file {name}: install gtsam 4.3 or newer") from error
    factors, calibration, poses = paths
    frame_ids, matrices, truth = _numbered_poses(poses)
    content = _stereo_factors(factors, calibration, frame_ids, max_per_frame)
    times, origin = EXAMPLE_INTERVAL * frame_ids.astype(np.float64), {"frame_interval_s": EXAMPLE_INTERVAL}
    files = TrackFiles(matrices[:, :3, 3], times, truth, *content, origin)
    stated = {"sigma_px": sigma_px, "image_size": KITTI00_STEREO_TRACKS.facts["image_size"]}
    recording = point_tracks.recording_of(files, poses, "gtsam:kitti00", "", {}, stated)
    source = {name: value for name, value in recording.source.items() if name != "path"}
    return replace(recording, name="gtsam_kitti00", source=source, truth_from=EXAMPLE_REFERENCE)


def _poses(positions: FloatArray, orientations: FloatArray) -> list[Pose]:
    return [Pose(r, q) for r, q in zip(positions, orientations, strict=True)]


def _numbered_poses(path: Path) -> tuple[IntArray, FloatArray, list[Pose]]:
    """Frame ids (K,), ascending, and T_world_cam (K, 4, 4) of a table `frame_id T00 ... T33`, also as poses."""
    table = read_table(path, 17)
    frame_ids, matrices = table[:, 0].astype(np.int64), table[:, 1:].reshape(-1, 4, 4)
    if not (np.diff(frame_ids) > 0).all():
        raise ValueError(f"{path}: frame ids must increase: sort the rows")
    return frame_ids, matrices, _poses(*split_poses(path, matrices))


def _times(path: Path, rate: float | None, count: int) -> FloatArray:
    """Times of the frames, s, of the file or by their rate."""
    file = path / "times.txt"
    if rate is None and not is_there(file):
        raise ValueError(f"{path} has no times.txt: give the frames a second, rate=10 (--rate 10)")
    if rate is None:
        return read_table(file, 1).reshape(-1)
    if is_there(file):
        raise ValueError(f"{file} says when the frames were taken: leave rate out, got {rate:g}")
    return np.arange(count) / positive("rate", rate)


def _stereo_factors(path: Path, calibration: Path, frame_ids: IntArray, max_per_frame: int | None) -> _Factors:
    """Rig, tracks, those used, and settings of two files; one common row v was stored."""
    fx, fy, _, cx, cy, baseline = read_table(calibration, 6)[0].tolist()
    table = read_table(path, 8)
    ids, landmarks = table[:, :2].astype(np.int64).T
    if (unknown := np.setdiff1d(ids, frame_ids)).size:
        raise ValueError(f"{path} has observations of frame {unknown[0]}, which has no pose")
    u_left, u_right, v = table[:, 2:5].T
    uvd = np.column_stack([u_left, v, u_left - u_right])
    tracks = PointTracks(np.searchsorted(frame_ids, ids), landmarks, uvd)
    usable = tracks.with_positive_disparity()
    used = usable.thinned(max_per_frame)
    settings = {
        **{"max_per_frame": max_per_frame, "dropped_non_positive_disparity": len(tracks) - len(usable)},
        **{"observations_used": len(used), "observations_in_file": len(tracks)},
    }
    return (fx, fy, cx, cy, baseline), tracks, used, settings


def _starry_night(
    path: Path, *, first: int | None = None, max_row_difference: float | None = 1.0, gyro_delay: float | None = None
) -> TrackFiles:
    """Stereo measurements of 20 surveyed landmarks in a motion-capture room, with velocities ("Starry Night").

    The third data set of T. D. Barfoot's course on state estimation: i is the room, v_k the vehicle at step k. `first`
    is the first step used; None: 100 in the recording of the course, where those before see almost nothing, else 0.
    Measurements whose rows in the two images differ by more than `max_row_difference`, px, are left out and counted:
    the two cameras took different points. `gyro_delay`, s, is how late angular velocities are; None: `GYRO_DELAY` in
    the public recording, else 0. Landmarks keep their ids (columns of `y_k_j`) when they are seen again.
    """
    archive = path / "starry_night.npz"
    arrays = read_archive(archive, STARRY_NIGHT.arrays)
    times, vehicle_i, R_cv, camera_v = arrays["t"], arrays["r_i_vk_i"].T, arrays["C_c_v"], arrays["rho_v_c_v"]
    maker = known_by(vehicle_i)
    if first is None:
        first = 0 if maker is None else maker.first_scored
    split_poses(archive, np.column_stack([R_cv, camera_v])[None])  # it must be a rotation
    if type(first) is not int or not 0 <= first <= len(times) - 2:
        raise ValueError(f"first must be a whole number from 0 to {len(times) - 2}, got {first!r}")
    turn_iv = Rotation.from_rotvec(arrays["theta_vk_i"].T[first:])
    turn_ic = turn_iv * Rotation.from_matrix(R_cv.T)
    positions_i, to_w = vehicle_i[first:] + turn_iv.apply(camera_v), turn_ic[0].inv()
    truth = _poses(to_w.apply(positions_i - positions_i[0]), (to_w * turn_ic).as_quat())
    points_w = to_w.apply(arrays["rho_i_pj_i"].T - positions_i[0])
    tracks = used = point_tracks.tracks_of_pixels(arrays["y_k_j"][:, first:])
    if max_row_difference is not None:
        assert tracks.v_right is not None
        most = positive("max_row_difference", max_row_difference)
        used = tracks.select(np.abs(tracks.uvd[:, 1] - tracks.v_right) <= most)
    delay = (0.0 if maker is None else GYRO_DELAY) if gyro_delay is None else gyro_delay
    speeds = point_tracks.step_velocities(times, arrays["v_vk_vk_i"].T, arrays["w_vk_vk_i"].T, delay)
    settings = {
        **{"max_row_difference_px": max_row_difference, "dropped_row_difference": len(tracks) - len(used)},
        "gyro": f"sign turned, read {delay} s late, see step_velocities",
    }
    rig = [arrays[key][0] for key in ("fu", "fv", "cu", "cv", "b")]
    return TrackFiles(
        *(vehicle_i, times[first:], truth, rig, tracks, used, settings, {"first": first}),
        velocities=(*(speed[first:] for speed in speeds), R_cv, camera_v),
        landmarks=LandmarkTruth(np.arange(len(points_w)), points_w),
    )


def _kitti06_stereo51(
    path: Path, choice: Choice, *, sigma_linear: float = 0.5, sigma_angular: float = 0.05, odometry_seed: int = 0
) -> RecordedSequence:
    """Stereo pairs with poses and velocities of an INS, as the first 51 pairs of KITTI odometry 06 are stored.

    `image_l/NNNNNN.png`, `image_r/NNNNNN.png`; `calib.txt` has the 3x4 projection matrices of left and right in two
    rows; `poses.txt` T_world_cam of the left camera; `odometry_oxts.csv` t_s, vx, vy, vz, wx, wy, wz in the IMU frame:
    row k has the time of frame k and the velocities of the step from frame k - 1 to k. White noise of `sigma_linear`
    and `sigma_angular` is added to these, by `odometry_seed`.
    """
    folders, calibration = (path / "image_l", path / "image_r"), path / "calib.txt"
    left, right = map(numbered_images, folders)
    velocities, poses = path / "odometry_oxts.csv", path / "poses.txt"
    P = read_table(calibration, 12).reshape(-1, 3, 4)
    if len(P) != 2:
        raise ValueError(f"{calibration} has {len(P)} rows where 2 projection matrices were expected")
    table = read_table(velocities, 7, delimiter=",", header_lines=1, finite=False)
    speeds, sigmas = np.nan_to_num(table[:, 1:]), {"sigma_linear": sigma_linear, "sigma_angular": sigma_angular}
    odometry = camera_velocities(speeds[:, :3], speeds[:, 3:], R_CI, P_I, **sigmas, seed=odometry_seed)
    steps = [step if np.isfinite(row).all() else None for step, row in zip(odometry, table, strict=True)]
    rows = read_table(poses, 12, finite=False)
    seconds = table[: max([*left, *right], default=-1) + 1, 0]  # the table has one row more
    truth_from = reference_for(rows[:, POSITION], KITTI06_STEREO51.truth, seconds)
    files = ImageFiles(folders, (left, right), seconds, velocities, poses_of_rows(rows), poses, steps)
    source = {
        **{"reader": KITTI06_STEREO51.NAME, "path": str(path), "odometry": "INS velocities with white noise added"},
        **{SPEEDS[name]: float(sigma) for name, sigma in sigmas.items()},
        "odometry_seed": int(odometry_seed),
    }
    name = path.resolve().name if known_by(rows[:, POSITION]) is None else KITTI06_STEREO51.NAME
    return RecordedSequence(name, files, choice, rig_of(calibration, (P[0], P[1])), source, truth_from)


def _karlsruhe(path: Path, choice: Choice, *, use_truth: bool = True, rate_hz: float | None = None) -> RecordedSequence:
    """The layout of the Karlsruhe stereo sequences (A. Geiger, 2009 and 2010).

    A folder such as `2009_09_08_drive_0010` with `I1_NNNNNN.png` (left) and `I2_NNNNNN.png` (right), rectified, and
    `insdata.txt`: a line a frame, time, latitude, longitude, altitude, x, y, z (m, z up), roll, pitch, yaw (rad). The
    calibration, in the folder or beside it, has `P1_roi:` and `P2_roi:`, the projection matrices of the images as they
    are stored. The layout is that of public programs; the sequences were not at hand. Not confirmed: times are s
    (others are refused), the unit sits at the left camera, yaw counts as it fits the course driven (`use_truth`;
    without a fit there is no truth). `rate_hz` replaces the stored times; where there are none it is 10.
    """
    path = path.resolve()
    left, right = (numbered_images(path, prefix) for prefix in ("I1_", "I2_"))
    calibration, ins = _calibration(path), path / "insdata.txt"
    P = projections(calibration, ["P1_roi", "P2_roi"])
    table = read_table(ins, 10, finite=False) if ins.exists() else None
    if table is not None and rate_hz is None:
        seconds = _stored_times(ins, table[:, 0])
    else:
        rate_hz = positive("rate_hz", 10.0 if rate_hz is None else rate_hz)
        seconds = np.arange(max([*left, *right], default=-1) + 1) / rate_hz
    truth = reading = None
    if use_truth and table is not None:
        good = finite_rows(table)
        if (reading := _reading_of_yaw(table[good])) is None:
            _log.warning("%s: yaw fits no direction of motion, the sequence has no truth", ins)
        else:
            roll, pitch, yaw = np.where(good[:, None], table[:, 7:], 0.0).T
            sign, offset = _YAW[reading]
            R_wu = Rotation.from_euler("ZYX", np.column_stack([sign * yaw + offset, pitch, roll]))
            truth = known_poses(table[:, 4:7], R_wu * Rotation.from_matrix(R_CI.T), good)
    files = ImageFiles((path, path), (left, right), seconds, ins, truth, ins)
    source = {
        **{"reader": KARLSRUHE.NAME, "path": str(path), "calibration": str(calibration)},
        "times": "insdata.txt" if rate_hz is None else f"assumed {rate_hz:g} Hz",
    }
    truth_from = Reference("unknown", KARLSRUHE.truth.format(reading))
    return RecordedSequence(f"karlsruhe_{path.name}", files, choice, rig_of(calibration, P), source, truth_from)


def _reading_of_yaw(rows: FloatArray) -> str | None:
    """The key of `_YAW` that agrees best with the course in rows of `insdata.txt`; None: none, or no motion."""
    steps = np.diff(rows[:, 4:6], axis=0)
    moving = np.linalg.norm(steps, axis=1) > _MOVES
    if not moving.any():
        return None
    course, yaw = np.arctan2(steps[moving, 1], steps[moving, 0]), np.unwrap(rows[:, 9])
    halfway = (0.5 * (yaw[1:] + yaw[:-1]))[moving]  # between the frames, for the chord points that way in a turn
    misfit = {}
    for name, (sign, offset) in _YAW.items():
        misfit[name] = float(np.median(np.abs((sign * halfway + offset - course + np.pi) % (2 * np.pi) - np.pi)))
    best = min(misfit, key=misfit.__getitem__)
    return best if misfit[best] < _AGREES else None


def _stored_times(path: Path, times: FloatArray) -> FloatArray:
    """Times from the first one on, s."""
    finite = times[np.isfinite(times)]
    step = float(np.median(np.diff(finite))) if finite.size > 1 else _LIKELY_STEP[0]
    if not _LIKELY_STEP[0] <= step <= _LIKELY_STEP[1]:
        raise ValueError(f"{path}: times are {step:.6g} apart, which are no seconds: give rate_hz=10 instead of them")
    return np.asarray(times - (finite[0] if finite.size else 0.0))


def _calibration(path: Path) -> Path:
    """The file that is most likely the calibration of this sequence."""
    date = "_".join(path.name.split("_")[:3])
    beside = (path.parent / f"{name}calib.txt" for name in (f"{path.name}_", f"{date}_", ""))
    files = [*sorted(path.glob("*calib.txt")), *(file for file in beside if file.exists())]
    if not files:
        raise ValueError(f"{path} has no calibration: put {date}_calib.txt into it or beside it")
    return require_inside(files[0], path.parent)


R_CI = OPTICAL_TO_BASE.T.copy()
"""Takes vectors of a unit (x forward, y left, z up) to a camera aligned with it (x right, y down, z forward)."""
P_I = np.array([1.1, -0.3, 0.7])
"""Camera of KITTI 06 in the IMU frame (m), to some centimetres and a degree: far below the noise of the odometry."""
INERTIAL = "imu_100hz.csv"
# The OXTS RT3003 of the car of KITTI 00: its place by the calibration of 2011_10_03, with its axes along those of the
# camera, which they are to some 12 mrad; densities and walks as GTSAM states them for its samples of this drive.
UNIT = InertialUnit(np.array([-0.32, 0.72, -1.08]), np.array([0.5, -0.5, 0.5, 0.5]), 1.75e-4, 1e-2, 2.9e-6, 1.7e-4)
EXAMPLE = ("VO_stereo_factors00.txt", "VO_calibration00.txt", "VO_camera_poses00.txt")  # in the gtsam wheel
EXAMPLE_INTERVAL = 0.1037  # s between frames; the wheel holds no times
_FITTED = "The stereo odometry that comes with the tracks and was fitted to the same pixels."
EXAMPLE_REFERENCE = Reference("odometry", _FITTED)
GYRO_DELAY = 0.11  # s, of the public recording of Starry Night
_MOVED = "It is moved as a whole onto the stereo odometry of frame {}: its place is not independent of the images."
_LIKELY_STEP = (0.02, 1.0)  # s
_MOVES, _AGREES = 0.3, np.deg2rad(15.0)  # m between two frames, below which the direction of motion says nothing
# Reading of yaw -> (sign, offset) that turn it into an angle from x, counter-clockwise.
_YAW = {
    "from east, counter-clockwise": (1.0, 0.0),
    "from east, clockwise": (-1.0, 0.0),
    "from north, counter-clockwise": (1.0, 0.5 * np.pi),
    "from north, clockwise": (-1.0, 0.5 * np.pi),
}

KITTI07_TRACKS = TracksRow(
    "kitti07_tracks",
    (("tracks.npz", "poses.txt"),),
    "poses.txt of the recording.",
    _kitti07_tracks,
    # Rectified images of the drives of 2011_09_30.
    {**{name: ASSUMED[name] for name in ("sigma_px", "sigma_linear", "sigma_angular")}, "image_size": (1226, 370)},
    {
        **{"time_stamps": "k", "features": (4, "n", "k"), "K": (3, 3), "b": 1, "cam_T_imu": (4, 4)},
        **dict.fromkeys(("linear_velocity", "rotational_velocity"), (3, "k")),
    },
)
KITTI00_STEREO_TRACKS = TracksRow(
    "kitti00_stereo_tracks",
    (("stereo_factors.txt", "calibration.txt", "vo_poses.txt", "poses.txt"),),
    "poses.txt of the recording.",
    _kitti00_stereo_tracks,
    {"sigma_px": ASSUMED["sigma_px"], "image_size": (1241, 376)},  # rectified images of the drives of 2011_10_03
)
STARRY_NIGHT = TracksRow(
    "starry_night",
    (("starry_night.npz",),),
    "The poses in starry_night.npz.",
    _starry_night,
    # Errors against motion capture, see docs/real_data.md; the images are the smallest that hold all measurements.
    {
        "sigma_u": 6.5,
        "sigma_v": 12.8,
        "sigma_d": 1.9,
        "sigma_linear": 0.05,
        "sigma_angular": 0.1,
        "image_size": (646, 480),
    },
    {
        **{"t": "k", **dict.fromkeys(("r_i_vk_i", "theta_vk_i", "v_vk_vk_i", "w_vk_vk_i"), (3, "k"))},
        **{"rho_i_pj_i": (3, "n"), "y_k_j": (4, "k", "n"), "C_c_v": (3, 3), "rho_v_c_v": 3},
        **dict.fromkeys(("fu", "fv", "cu", "cv", "b"), 1),
    },
)
KITTI06_STEREO51 = ImagesRow(
    "kitti06_stereo51",
    (("image_l", "image_r", "calib.txt", "poses.txt", "odometry_oxts.csv"),),
    "poses.txt of the recording; the odometry is odometry_oxts.csv, with noise added.",
    _kitti06_stereo51,
)
KARLSRUHE = ImagesRow(
    "karlsruhe",
    (("I1_*", "I2_*", "*calib.txt"), ("I1_*", "I2_*", "../*calib.txt")),
    "The poses in insdata.txt, of a unit taken to sit at the left camera, its yaw counted {}: weak, to metres.",
    _karlsruhe,
)
