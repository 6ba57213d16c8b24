"""The ASL layout: distorted, turned cameras are rectified to the geometry that they had (2 s)."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import Pose
from stereo_slam_env.datasets import open_image_sequence

from .small_image_folders import cut_file, write_png

SIZE, FRAMES = (320, 240), 8
FIRST_STAMP, STEP_NS, TRUTH_STEP_NS = 1403636579763555584, 50_000_000, 5_000_000
K0 = np.array([[200.0, 0.0, 158.0], [0.0, 199.0, 121.5], [0.0, 0.0, 1.0]])
K1 = np.array([[201.5, 0.0, 165.0], [0.0, 200.0, 117.0], [0.0, 0.0, 1.0]])
D0, D1 = np.array([-0.28, 0.07, 2e-4, 2e-5]), np.array([-0.27, 0.06, -1e-4, -3e-5])
E0, E1 = np.array([0.0035, 0.0007, -0.002, 0.0002]), np.array([0.0034, 0.0018, -0.0027, 0.0003])
"""Of equidistant lenses, as those of TUM-VI."""
T_BS = []
for angles, at in (([0.02, -0.01, 1.56], [-0.0216, -0.0647, 0.0098]), ([0.01, 0.012, 1.55], [-0.0198, 0.0454, 0.0079])):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", angles).as_matrix(), at
    T_BS.append(T)
DOTS_C = np.array([[x, y, 2.0 + 0.3 * i] for i, (x, y) in enumerate(
    (x, y) for y in (-0.6, 0.0, 0.6) for x in (-0.6, -0.1, 0.5))])  # fmt: skip
"""In the left camera of the file."""


def blobs(pixels):
    """An image of soft dots, drawn where they are to a hundredth of a pixel."""
    v, u = np.indices(SIZE[::-1])
    image = sum(180.0 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 2.2**2)) for x, y in pixels)
    return np.rint(np.clip(20 + image, 0, 255)).astype(np.uint8)


def centres(image, expected):
    """Weighted centres of the dots, looked for around where they should be."""
    found = []
    for x, y in expected:
        u0, v0 = round(x) - 9, round(y) - 9
        window = np.clip(image[v0 : v0 + 19, u0 : u0 + 19].astype(float) - 30.0, 0.0, None)
        v, u = np.indices(window.shape)
        found.append([u0 + (window * u).sum() / window.sum(), v0 + (window * v).sum() / window.sum()])
    return np.array(found)


def body_pose(seconds):
    """Of the body in the truth's own world."""
    R = Rotation.from_euler("xyz", [0.3 + 0.1 * seconds, -0.2, 1.0 + 0.5 * seconds])
    return np.array([4.6 + 0.8 * seconds, -1.8 + 0.3 * seconds**2, 0.8]), R


def sensor_yaml(T, K, D, model):
    rows = ",\n         ".join(", ".join(f"{x:.12g}" for x in row) for row in T)
    return (
        "# General sensor definitions.\nsensor_type: camera\ncomment: VI-Sensor cam (MT9M034)\n\n"
        "# Sensor extrinsics wrt. the body-frame.\n"
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{rows}]\n\n"
        f"# Camera specific definitions.\nrate_hz: 20\nresolution: [{SIZE[0]}, {SIZE[1]}]\ncamera_model: pinhole\n"
        f"intrinsics: [{K[0, 0]}, {K[1, 1]}, {K[0, 2]}, {K[1, 2]}] #fu, fv, cu, cv\n"
        f"distortion_model: {model}\ndistortion_coefficients: [{', '.join(map(str, D))}]\n"
    )


def camchain_yaml():
    """Kalibr's file of the equidistant pair, as TUM-VI has it: T_cam_imu takes points of the body to the camera."""
    text = ""
    for eye, (T, K, E) in enumerate(zip(T_BS, (K0, K1), (E0, E1), strict=True)):
        rows = "".join(f"  - [{', '.join(f'{x:.12g}' for x in row)}]\n" for row in np.linalg.inv(T))
        text += (
            f"cam{eye}:\n  T_cam_imu:\n{rows}  camera_model: pinhole\n  distortion_coeffs: [{', '.join(map(str, E))}]\n"
            f"  distortion_model: equidistant\n  intrinsics: [{K[0, 0]}, {K[1, 1]}, {K[0, 2]}, {K[1, 2]}]\n"
            f"  resolution: [{SIZE[0]}, {SIZE[1]}]\n  rostopic: /cam{eye}/image_raw\n"
        )
    return text


def euroc(root, *, truth_from=0, truth_to=FRAMES - 1, lenses="radial-tangential", kalibr=False):
    """`MH_01_easy/mav0`; the dots stand still before the left camera, so all images are alike."""
    mav0 = root / "MH_01_easy" / "mav0"
    bent = (E0, E1) if lenses == "equidistant" else (D0, D1)
    T_10 = np.linalg.solve(T_BS[1], T_BS[0])
    stamps = [FIRST_STAMP + k * STEP_NS for k in range(FRAMES)]
    for eye, (K, D, T) in enumerate(((K0, bent[0], np.eye(4)), (K1, bent[1], T_10))):
        rotation = Rotation.from_matrix(T[:3, :3]).as_rotvec().reshape(3, 1)
        projected = cv2.fisheye.projectPoints if lenses == "equidistant" else cv2.projectPoints
        pixels, _ = projected(DOTS_C.reshape(-1, 1, 3), rotation, T[:3, 3:].copy(), K, D)
        folder = mav0 / f"cam{eye}"
        lines = ["#timestamp [ns],filename"]
        for stamp in stamps:
            write_png(folder / "data" / f"{stamp}.png", blobs(pixels.reshape(-1, 2)))
            lines.append(f"{stamp},{stamp}.png")
        (folder / "data.csv").write_text("\n".join(lines) + "\r\n")
        if not kalibr:
            (folder / "sensor.yaml").write_text(sensor_yaml(T_BS[eye], K, D, lenses))
    if kalibr:
        (mav0.parent / "dso").mkdir()
        (mav0.parent / "dso" / "camchain.yaml").write_text(camchain_yaml())
    folder = mav0 / ("mocap0" if kalibr else "state_groundtruth_estimate0")
    folder.mkdir()
    lines = ["#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_x"]
    # Off the image times by 1 ms, so that it has to be interpolated.
    for stamp in range(stamps[truth_from] - 1_000_000, stamps[truth_to] + 5_000_000, TRUTH_STEP_NS):
        p, R = body_pose(1e-9 * (stamp - FIRST_STAMP))
        x, y, z, w = R.as_quat()
        lines.append(",".join([str(stamp), *(f"{number:.9f}" for number in (*p, w, x, y, z, 0.0))]))
    (folder / "data.csv").write_text("\n".join(lines) + "\n")
    return root / "MH_01_easy"


@pytest.fixture(
    params=[{}, {"lenses": "equidistant"}, {"lenses": "equidistant", "kalibr": True}],
    ids=["EuRoC", "fisheye", "TUM-VI"],
)
def rectified_dots(tmp_path, request):
    """The sequence, and the dots in its rectified left camera."""
    sequence = open_image_sequence(euroc(tmp_path, **request.param))
    T_10 = np.linalg.solve(T_BS[1], T_BS[0])
    # Independent of the reader: x of the rectified frame is along the baseline.
    left_in_right = -T_10[:3, :3].T @ T_10[:3, 3]
    return sequence, left_in_right


def seen_dots(sequence, pair, right_in_left):
    """The dots as measured in the rectified pair, (N, 3) px."""
    camera = sequence.camera
    # Where to look: the turn of the left camera from its defining property alone, x along the baseline.
    x = right_in_left / np.linalg.norm(right_in_left)
    z = np.cross(x, [0.0, 1.0, 0.0])
    z /= np.linalg.norm(z)
    uvd = camera.project(DOTS_C @ np.column_stack([x, np.cross(z, x), z]))
    left = centres(pair.left, uvd[:, :2])
    right = centres(pair.right, np.column_stack([uvd[:, 0] - uvd[:, 2], uvd[:, 1]]))
    assert np.abs(left[:, 1] - right[:, 1]).max() < 0.1  # rows agree
    return np.column_stack([left, left[:, 0] - right[:, 0]])


def turn_of(sequence, pair, right_in_left):
    """Takes vectors of the left camera of the file to the rectified one, as the dots show it."""
    points = sequence.camera.backproject(seen_dots(sequence, pair, right_in_left))
    turn, _ = Rotation.align_vectors(points, DOTS_C)
    return turn


def test_rectified_images_show_the_points_where_the_camera_projects_them(rectified_dots):
    sequence, right_in_left = rectified_dots
    pair = next(sequence.pairs())
    assert sequence.camera.baseline == pytest.approx(np.linalg.norm(right_in_left), rel=1e-9)
    turn = turn_of(sequence, pair, right_in_left)
    projected = sequence.camera.project(turn.apply(DOTS_C))
    assert np.abs(projected - seen_dots(sequence, pair, right_in_left)).max() < 0.12
    # The turn is small: the cameras look the same way to some degrees.
    assert turn.magnitude() < 0.1


def test_truth_is_that_of_the_rectified_left_camera(rectified_dots):
    """Seen from it, points that are fixed to the world must move as the truth says."""
    sequence, right_in_left = rectified_dots
    pairs = list(sequence.pairs())
    assert len(pairs) == FRAMES
    x = right_in_left / np.linalg.norm(right_in_left)
    turn = turn_of(sequence, pairs[0], right_in_left)
    R_bc = Rotation.from_matrix(T_BS[0][:3, :3])
    p0, R0 = body_pose(0.0)
    for k, pair in enumerate(pairs):
        p, R = body_pose(k * 1e-9 * STEP_NS)
        moved = p + R.apply(T_BS[0][:3, 3]) - p0 - R0.apply(T_BS[0][:3, 3])
        moved_c = (R0 * R_bc).inv().apply(moved)  # in the left camera of the file at frame 0
        turned_c = (R0 * R_bc).inv() * R * R_bc
        # Exactly what does not depend on the turn, and to its accuracy what does.
        assert np.linalg.norm(pair.truth.position) == pytest.approx(np.linalg.norm(moved), abs=1e-6)
        assert pair.truth.position[0] == pytest.approx(moved_c @ x, abs=1e-6)
        np.testing.assert_allclose(pair.truth.position, turn.apply(moved_c), atol=2e-3)
        found = Rotation.from_quat(pair.truth.orientation)
        assert found.magnitude() == pytest.approx(turned_c.magnitude(), abs=1e-6)
        assert (found.inv() * turn * turned_c * turn.inv()).magnitude() < 2e-3
    np.testing.assert_allclose([pair.timestamp for pair in pairs], 0.05 * np.arange(FRAMES), atol=1e-12)
    assert isinstance(pairs[0].truth, Pose)


def test_frames_that_the_truth_does_not_cover_are_left_out(tmp_path):
    folder = euroc(tmp_path, truth_from=2, truth_to=5)
    covered = open_image_sequence(folder)
    assert covered.frame_numbers == (2, 3, 4, 5)
    assert all(pair.truth is not None for pair in covered.pairs())
    everything = open_image_sequence(folder, use_truth=False)
    assert len(everything) == FRAMES
    assert all(pair.truth is None for pair in everything.pairs())
    assert open_image_sequence(folder / "mav0", first=3, last=4).frame_numbers == (3, 4)


def test_what_is_wrong_is_named(tmp_path):
    folder = euroc(tmp_path)
    mav0 = folder / "mav0"
    image = sorted((mav0 / "cam1" / "data").iterdir())[3]
    content = image.read_bytes()
    cut_file(image)
    with pytest.raises(ValueError, match=rf"{image.name} is damaged, "):
        list(open_image_sequence(folder).pairs())
    skipping = open_image_sequence(folder, on_broken="skip")
    assert len(list(skipping.pairs())) == FRAMES - 1
    assert skipping.skipped == {"image damaged": 1}
    image.unlink()
    with pytest.raises(ValueError, match=r"cam1/data has no image of frame 3"):
        open_image_sequence(folder)
    image.write_bytes(content)

    listing = mav0 / "cam1" / "data.csv"
    good = listing.read_text()
    listing.write_text(good.replace(f",{image.name}", f",../../{image.name}"))
    with pytest.raises(ValueError, match=r"cam1/data\.csv: line 5 is not 'timestamp in ns,file name'"):
        open_image_sequence(folder)
    listing.write_text(good)

    sensor = mav0 / "cam0" / "sensor.yaml"
    good = sensor.read_text()
    for bad, match in (
        (good.replace("intrinsics", "intrinsic"), r"cam0/sensor\.yaml holds no calibration that is known"),
        (good.replace("T_BS", "T_SB"), r"cam0/sensor\.yaml lacks 'T_BS'"),
        (good.replace("radial-tangential", "fov"), "the lens model 'fov' cannot be rectified by OpenCV"),
        (good.replace("radial-tangential", "equidistant"), "one lens is equidistant, the other radial-tangential"),
        (good.replace("[320, 240]", "[320]"), "'resolution' has 1 numbers where 2"),
    ):
        sensor.write_text(bad)
        with pytest.raises(ValueError, match=match):
            open_image_sequence(folder)
    sensor.write_text(good)

    truth = mav0 / "state_groundtruth_estimate0" / "data.csv"
    lines = truth.read_text().splitlines()
    for at in range(11, 32):  # 0.1 s around frame 2; what is shorter is interpolated
        lines[at] = ",".join([lines[at].split(",")[0], *["nan"] * 8])
    truth.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=r"state_groundtruth_estimate0/data\.csv has NaN"):
        open_image_sequence(folder)


def test_the_folder_around_one_recording_stands_for_it(tmp_path):
    """`MH_01_easy` and its `mav0` are two folders of this layout, and one recording."""
    euroc(tmp_path)
    for folder in (tmp_path, tmp_path / "MH_01_easy", tmp_path / "MH_01_easy" / "mav0"):
        assert open_image_sequence(folder).name == "euroc_MH_01_easy"


UNIT_AT, UNIT_TURN = np.array([0.02, -0.01, 0.03]), Rotation.from_euler("xyz", [0.2, -0.1, 0.3])
GRAVITY = np.array([0.0, 0.0, -9.81])  # in the truth's own world


def write_unit(folder, *, kalibr=False):
    """`imu0` of a unit at 200 Hz, with the samples that the path of the body gives; that of TUM-VI is the body."""
    place, turn = (np.zeros(3), Rotation.identity()) if kalibr else (UNIT_AT, UNIT_TURN)
    seconds = 0.005 * np.arange(-4, 20 * FRAMES)
    poses = [body_pose(t) for t in seconds]
    R = Rotation.concatenate([R_wb for _, R_wb in poses]) * turn

    def at(offset):
        return np.array([p + R_wb.apply(place) for p, R_wb in (body_pose(t + offset) for t in seconds)])

    h = 1e-3
    forces = R.inv().apply((at(h) - 2 * at(0.0) + at(-h)) / h**2 - GRAVITY)
    turned = Rotation.concatenate([body_pose(t + h)[1] for t in seconds]) * turn
    rates = (R.inv() * turned).as_rotvec() / h
    (folder / "mav0" / "imu0").mkdir()
    lines = ["#timestamp [ns],w x,w y,w z,a x,a y,a z"]
    stamps = FIRST_STAMP + np.rint(1e9 * seconds).astype(np.int64)
    for stamp, w, a in zip(stamps, rates, forces, strict=True):
        lines.append(",".join([str(stamp), *(f"{x:.15g}" for x in (*w, *a))]))
    (folder / "mav0" / "imu0" / "data.csv").write_text("\n".join(lines) + "\n")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), place
    mounted = (
        f"sensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{', '.join(map(str, T.ravel()))}]\nrate_hz: 200\n"
    )
    (folder / ("dso/imu_config.yaml" if kalibr else "mav0/imu0/sensor.yaml")).write_text(
        ("rostopic: /imu0\nupdate_rate: 200.0\n" if kalibr else mounted)
        + "gyroscope_noise_density: 1.6968e-04     # [ rad / s / sqrt(Hz) ]\ngyroscope_random_walk: 1.9393e-05\n"
        "accelerometer_noise_density: 2.0000e-3  # [ m / s^2 / sqrt(Hz) ]\naccelerometer_random_walk: 3.0000e-3\n"
    )
    return folder


@pytest.mark.parametrize("kalibr", [False, True], ids=["EuRoC", "TUM-VI"])
def test_samples_of_imu0_lead_along_the_true_path(tmp_path, kalibr):
    """From exact poses at both ends: the unit's place, its turn and the rectification are those of the files."""
    lenses = "equidistant" if kalibr else "radial-tangential"
    folder = write_unit(euroc(tmp_path, lenses=lenses, kalibr=kalibr), kalibr=kalibr)
    pairs = list(open_image_sequence(folder).pairs())
    assert pairs[0].inertial is None
    unit = pairs[1].inertial.unit
    assert (unit.gyro_density, unit.accelerometer_walk) == (1.6968e-4, 3e-3)
    place, turned = (np.zeros(3), np.eye(3)) if kalibr else (UNIT_AT, UNIT_TURN.as_matrix())
    T_ci = np.linalg.solve(T_BS[0], np.vstack([np.column_stack([turned, place]), [0, 0, 0, 1]]))
    assert np.linalg.norm(unit.position) == pytest.approx(np.linalg.norm(T_ci[:3, 3]), abs=1e-9)
    R_wc = [Rotation.from_quat(pair.truth.orientation) for pair in pairs]
    for before, pair, turn, after in zip(pairs, pairs[1:], R_wc, R_wc[1:], strict=False):
        rotation = Rotation.identity()
        for h, w in zip(np.diff(pair.inertial.times, prepend=0.0), pair.inertial.angular_rates, strict=True):
            rotation = rotation * Rotation.from_rotvec(h * w)
        R_ci = Rotation.from_quat(np.array(unit.orientation))
        assert (R_ci * rotation * R_ci.inv() * (turn.inv() * after).inv()).magnitude() < 1e-5
        assert pair.inertial.times[-1] == pytest.approx(pair.timestamp - before.timestamp, abs=1e-12)
    # The camera is hardly accelerated against gravity: 9.81 m/s^2 upwards in the world of the first camera.
    up = np.array([R_wc[k].apply(R_ci.apply(pairs[k].inertial.specific_forces.mean(axis=0))) for k in range(1, FRAMES)])
    R0 = body_pose(0.0)[1] * Rotation.from_matrix(T_BS[0][:3, :3])
    assert np.ptp(up, axis=0).max() < 0.5
    assert up.mean(axis=0) @ R0.inv().apply([0.0, 0.0, 1.0]) == pytest.approx(9.81, abs=0.4)


def test_samples_are_those_of_the_units_clock(tmp_path):
    """Kalibr: the unit's clock is ahead of the camera's by `timeshift_cam_imu`."""
    folder = write_unit(euroc(tmp_path, lenses="equidistant", kalibr=True), kalibr=True)
    sheet, table = folder / "dso" / "camchain.yaml", folder / "mav0" / "imu0" / "data.csv"
    plain = list(open_image_sequence(folder).pairs())
    sheet.write_text(sheet.read_text().replace("  rostopic", "  timeshift_cam_imu: 0.05\n  rostopic"))
    head, *lines = table.read_text().splitlines()
    late = [(int(stamp) + 50_000_000, rest) for stamp, _, rest in (line.partition(",") for line in lines)]
    table.write_text("\n".join([head, *(f"{stamp},{rest}" for stamp, rest in late)]))
    shifted = list(open_image_sequence(folder).pairs())
    for one, other in zip(plain[1:], shifted[1:], strict=True):
        np.testing.assert_allclose(one.inertial.angular_rates, other.inertial.angular_rates, atol=1e-6)
        np.testing.assert_allclose(one.inertial.times, other.inertial.times, atol=1e-9)


def test_a_unit_without_its_data_sheet_is_named(tmp_path):
    folder = write_unit(euroc(tmp_path))
    sheet = folder / "mav0" / "imu0" / "sensor.yaml"
    sheet.write_text(sheet.read_text().replace("gyroscope_random_walk", "gyro_walk"))
    with pytest.raises(
        ValueError, match=r"sensor.yaml lacks 'gyroscope_random_walk': take the calibration of this rig$"
    ):
        open_image_sequence(folder)
