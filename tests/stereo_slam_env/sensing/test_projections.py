"""Projection matrices and the rigs that they mean: forms, units and limits (1 s)."""

import json
from dataclasses import asdict, replace

import cv2
import numpy as np
import pytest

from filters import StereoCamera
from stereo_slam_env.sensing.calibration_entries import lens_of, numbers_of, size_of
from stereo_slam_env.sensing.lenses import require_rotation
from stereo_slam_env.sensing.projections import (
    camera_position,
    rectified_rig,
    require_baseline,
    require_principal_point,
)
from stereo_slam_env.sensing.rig_files import imu_shift, read_calibration
from stereo_slam_env.sensing.rigs import RIGS, camera_of

SIZE = (640, 400)
K = np.array([[400.0, 0.0, 310.0], [0.0, 410.0, 190.0], [0.0, 0.0, 1.0]])


def projection(x=0.0, y=0.0, z=0.0, of=K):
    """P of a camera at a place, m."""
    return np.column_stack([of, -of @ [x, y, z]])


def test_the_rig_is_the_common_k_and_how_far_the_right_camera_is_to_the_right():
    assert rectified_rig("it", projection(), projection(0.12), SIZE) == StereoCamera(400, 410, 310, 190, 0.12, *SIZE)
    found = rectified_rig("it", projection(0.06, 0.01), projection(0.3, -0.02), SIZE)
    assert found.baseline == pytest.approx(0.24)
    np.testing.assert_allclose(camera_position(projection(0.06, 0.01, -0.3)), [0.06, 0.01, -0.3])


@pytest.mark.parametrize(
    ("left", "right", "said"),
    [
        (projection(), projection(-0.12), r"the baseline is -0\.12 m, it must be > 0: are left and right swapped"),
        (projection(), projection(0.0), r"the baseline is 0 m, it must be > 0"),
        (projection(), projection(0.1, 0.2), r"the right camera is \+0\.2 m below the left one: a vertical pair"),
        (projection(of=K + 1e-3 * np.eye(3, k=1)), projection(0.1), "the left projection matrix is not"),
        (projection(of=K * [[-1.0], [1.0], [1.0]]), projection(0.1), "the left projection matrix is not"),
        (projection(of=K * [[1.0], [-1.0], [1.0]]), projection(0.1), "the left projection matrix is not"),
        (projection(), projection(0.1, of=K + 0.01 * np.diag([1.0, 0, 0])), "both cameras must have the same focal"),
        *[(projection(of=wide), projection(0.1, of=wide), "a focal length of 100001 px is that of no camera")
          for wide in (np.diag([100_001.0, 1.0, 1.0]), np.diag([1.0, 100_001.0, 1.0]))],
    ],
)  # fmt: skip
def test_what_is_no_rectified_pair_is_refused(left, right, said):
    with pytest.raises(ValueError, match=f"^it: .*{said}"):
        rectified_rig("it", left, right, SIZE)


def test_the_digits_of_a_text_are_no_difference():
    near = K + 4e-4 * np.ones((3, 3)) * (K != 0) * [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]
    assert rectified_rig("it", projection(), projection(0.12, of=near), SIZE).fx == 400.0


@pytest.mark.parametrize(
    ("baseline", "said"),
    [
        (0.00499, r"^it: the baseline is 0\.00499 m: metres are expected, and -fx b, in px m, as fourth number of P$"),
        (2.1, r"^it: the baseline is 2\.1 m: metres are expected, is it in cm \(0\.021 m\) or inches \(0\.0533 m\)\?$"),
        (12.0, r"is it in cm \(0\.12 m\) or inches \(0\.305 m\)\?$"),
        (120.0, r"is it in mm \(0\.12 m\)\?$"),
        (50.0, r"is it in mm \(0\.05 m\) or cm \(0\.5 m\)\?$"),
        (5000.0, r"5000 m: metres are expected$"),
    ],
)
def test_baselines_of_other_units_are_guessed_at_where_they_fit(baseline, said):
    for taken in (0.005, 0.12, 2.0):
        require_baseline("it", taken)
    with pytest.raises(ValueError, match=said):
        require_baseline("it", baseline)


@pytest.mark.parametrize(
    ("u", "v", "fits"),
    [
        *((319.5, 199.5, True), (0.051 * 640, 199.5, True), (0.949 * 640 - 1.0, 199.5, True)),
        *((0.049 * 640 - 1.0, 199.5, False), (0.951 * 640, 199.5, False), (319.5, 0.948 * 400, True)),
        *((319.5, 0.951 * 400, False), (319.5, 0.048 * 400, False), (319.5, 0.051 * 400, True)),
    ],
)
def test_a_principal_point_is_a_twentieth_from_the_edges_of_an_image(u, v, fits):
    P = projection()
    P[0, 2], P[1, 2] = u, v
    if fits:
        require_principal_point("it", P, SIZE)
    else:
        with pytest.raises(ValueError, match="is not in the middle of images of 640x400"):
            require_principal_point("it", P, SIZE)


# --- entries ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "limit", [{}, {"image_width": 8000, "image_height": 5000}, {"image_width": 1, "image_height": 1}]
)
def test_sizes_are_those_given_or_stated_up_to_forty_million_pixels(limit):
    table = {"image_width": 640, "image_height": 400, "resolution": [320, 200], **limit}
    assert size_of("it", table, ("resolution",), (7, 8)) == (7, 8)
    assert size_of("it", table, ("resolution",), None) == (320, 200)
    assert size_of("it", table, (), None) == (table["image_width"], table["image_height"])


@pytest.mark.parametrize("size", [(0, 400), (640, 0), (-1, -1), (8000, 5001)])
def test_sizes_of_no_image_are_refused(size):
    with pytest.raises(ValueError, match=f"resolution {size[0]}x{size[1]} is none of an image"):
        size_of("it", {}, (), size)


def test_numbers_are_flat_and_as_many_as_expected():
    table = {"a": [[1, 2], [3, 4.5]], "b": {"rows": 1, "data": [7]}, "c": 3}
    assert numbers_of("it", table, "a").tolist() == numbers_of("it", table, ("x", "a"), 3, 4).tolist() == [1, 2, 3, 4.5]
    assert (numbers_of("it", table, "b", 1).tolist(), numbers_of("it", table, "c", 1).tolist()) == ([7.0], [3.0])
    with pytest.raises(ValueError, match=r"'a' has 4 numbers where 3 or 5 were expected"):
        numbers_of("it", table, "a", 3, 5)
    with pytest.raises(ValueError, match=r"it lacks 'x'"):
        numbers_of("it", table, ("x", "y"))


def test_a_lens_is_of_four_numbers_or_of_k_and_a_fisheye_of_four_coefficients():
    by_four = lens_of("it", np.array([400.0, 410.0, 310.0, 190.0]), SIZE, np.zeros(0), "none")
    assert by_four == lens_of("it", K.ravel(), SIZE, np.zeros(0), "pinhole")
    assert (by_four.fx, by_four.fy, by_four.cx, by_four.cy, by_four.size) == (400.0, 410.0, 310.0, 190.0, SIZE)
    filled = lens_of("it", K.ravel(), SIZE, np.array([0.1, 0.2, 0.3, 0.4, 0.0, 0.0]), "Kannala_Brandt4")
    assert (filled.model, filled.distortion) == ("equidistant", (0.1, 0.2, 0.3, 0.4))
    five = lens_of("it", K.ravel(), SIZE, np.array([0.1, 0.2, 0.3, 0.4, 0.0]), "plumb_bob")
    assert (five.model, len(five.distortion)) == ("radial-tangential", 5)
    with pytest.raises(ValueError, match="the lens model 'omni' cannot be rectified"):
        lens_of("it", K.ravel(), SIZE, np.zeros(4), "omni")


@pytest.mark.parametrize(("by", "taken"), [(4e-4, True), (6e-4, False)])
def test_a_rotation_is_one_to_a_thousandth(by, taken):
    R = np.diag([1.0 + by, 1.0, 1.0])
    if taken:
        require_rotation(R, "it", "R")
    else:
        with pytest.raises(ValueError, match=r"^it: R holds no rotation"):
            require_rotation(R, "it", "R")
    with pytest.raises(ValueError, match=r"^it: R holds no rotation"):
        require_rotation(np.diag([1.0, 1.0, -1.0]), "it", "R")


# --- files -----------------------------------------------------------------------------------------------------------


def kitti(folder, names=("P0", "P1"), more=""):
    lines = (
        f"{name}: " + " ".join(map(str, P.ravel()))
        for name, P in zip(names, (projection(), projection(0.5)), strict=True)
    )
    (folder / "calib.txt").write_text("\n".join(lines) + "\n" + more)
    return folder / "calib.txt"


def test_the_size_of_kittis_images_is_given_or_stated_or_that_of_the_first_one(tmp_path):
    expected = StereoCamera(400, 410, 310, 190, 0.5, *SIZE)
    assert read_calibration(kitti(tmp_path), size=SIZE) == expected
    with pytest.raises(ValueError, match="does not say the size of the images"):
        read_calibration(kitti(tmp_path))
    stated = kitti(tmp_path, ("P_rect_00", "P_rect_01"), "S_rect_00: 640.0 400.0\n")
    assert read_calibration(stated) == expected
    assert read_calibration(stated, size=(600, 380)) == replace(expected, width=600, height=380)
    (tmp_path / "image_0").mkdir()
    cv2.imwrite(str(tmp_path / "image_0" / "000000.png"), np.zeros(SIZE[::-1], dtype=np.uint8))
    assert read_calibration(kitti(tmp_path)) == expected
    assert read_calibration(tmp_path) == expected


def orb_slam(folder, **changes):
    table = {"Camera.fx": 400.0, "Camera.fy": 410.0, "Camera.cx": 310.0, "Camera.cy": 190.0, "Camera.bf": 48.0}
    table |= {"Camera.width": 640, "Camera.height": 400, **changes}
    text = "".join(f"{name}: {value}\n" for name, value in table.items() if value is not None)
    (folder / "orb.yaml").write_text("%YAML:1.0\n---\n" + text)
    return folder / "orb.yaml"


def test_settings_of_orb_slam_are_those_of_rectified_images(tmp_path):
    expected = StereoCamera(400, 410, 310, 190, 0.12, *SIZE)
    assert read_calibration(orb_slam(tmp_path)) == expected
    assert read_calibration(orb_slam(tmp_path, **{"Camera.bf": None, "Stereo.b": 0.12})) == expected
    three = {f"Camera1.{name}": value for name, value in (("fx", 400.0), ("fy", 410.0), ("cx", 310.0), ("cy", 190.0))}
    none = dict.fromkeys(("Camera.fx", "Camera.fy", "Camera.cx", "Camera.cy", "Camera.bf"))
    settings = {**none, **three, "Camera.type": '"Rectified"', "Stereo.b": 0.12, "Camera1.k1": -0.3}
    assert read_calibration(orb_slam(tmp_path, **settings)) == expected
    assert read_calibration(orb_slam(tmp_path, **{"Camera.width": None, "Camera.height": None}), size=SIZE) == expected


@pytest.mark.parametrize(("shift", "taken"), [(0.02, True), (-10.0, True), (10.0, True), (10.1, False), (-20.0, False)])
def test_the_clock_of_a_unit_is_ten_seconds_off_at_most(tmp_path, shift, taken):
    (tmp_path / "camchain.yaml").write_text(f"cam0:\n  timeshift_cam_imu: {shift}\n")
    if taken:
        assert imu_shift(tmp_path / "camchain.yaml") == shift
    else:
        with pytest.raises(ValueError, match="seconds are expected, is it in ms or ns"):
            imu_shift(tmp_path / "camchain.yaml")


# --- rigs ------------------------------------------------------------------------------------------------------------


def test_rigs_by_name_have_the_numbers_of_their_makers():
    """Focal lengths over pixels, or fields of view, to one per cent; nominal ones see the middle of their images."""
    assert RIGS["reference"] == StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391)
    assert RIGS["kitti"] == StereoCamera(718.856, 718.856, 607.1928, 185.2157, 386.1448 / 718.856, 1241, 376)
    assert RIGS["euroc"] == StereoCamera(435.2047, 435.2047, 367.4517, 252.2009, 47.90639 / 435.2047, 752, 480)
    nominal = {
        "vga": (2 * 460.0 / 640, 0.571, 640, 480),
        "qvga": (2 * 460.0 / 640, 0.571, 320, 240),
        "zed2": (2 * 2.12 / (1280 * 0.004), 0.12, 1280, 720),
        "d455": (2 * 1.93 / (1280 * 0.003), 0.095, 1280, 720),
        "oak-d": (1 / np.tan(np.deg2rad(36.0)), 0.075, 1280, 800),
    }
    assert {*nominal, "reference", "kitti", "euroc"} == {*RIGS}
    for name, (focal, baseline, width, height) in nominal.items():
        rig = RIGS[name]
        assert rig.fx == rig.fy == pytest.approx(focal * width / 2, rel=0.01)
        assert (rig.baseline, rig.width, rig.height) == (baseline, width, height)
        assert (rig.cx, rig.cy) == ((width - 1) / 2, (height - 1) / 2)
    for rig in RIGS.values():
        assert camera_of(json.loads(json.dumps(asdict(rig)))) == rig


@pytest.mark.parametrize(
    ("number", "value", "taken"),
    [
        *(("fx", 1.0, True), ("fx", 0.99, False), ("fy", 1e5, True), ("fy", 1.01e5, False)),
        *(("baseline", 0.001, True), ("baseline", 0.00099, False), ("baseline", 10.0, True), ("baseline", 10.1, False)),
        *(("cx", 0.0, True), ("cx", -0.1, False), ("cx", 639.0, True), ("cx", 639.1, False)),
        *(("cy", 479.0, True), ("cy", 479.1, False), ("width", 8192, True), ("width", 8193, False)),
        *(("height", 8192, True), ("height", 0, False)),
    ],
)
def test_limits_of_a_rig_belong_to_it(number, value, taken):
    if taken:
        assert getattr(camera_of({"name": "vga", number: value}), number) == value
    else:
        with pytest.raises(ValueError, match=f"^rig.{number} must be"):
            camera_of({"name": "vga", number: value})
