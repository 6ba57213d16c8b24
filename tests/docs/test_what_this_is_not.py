"""Each sentence of docs/what_this_is_not.md with what shows that it is so (20 s).

A limit that falls makes a test fail here: then the sentence goes.
"""

import ast
import dataclasses
import inspect
import re
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import filters
import stereo_slam_env as sse
from filters import (
    BodyVelocity,
    ColouredNoise,
    Start,
    StereoEKF,
    StereoFilter,
    StereoNoise,
    StereoObservation,
    available_filters,
    make_filter,
)
from filters.parts import SLOTS
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.datasets import image_layouts
from stereo_slam_env.envs.recorder import RenderedDrive
from stereo_slam_env.frontend.ego_motion import robust_step
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.recording.recording import Frame, Recording, StereoPair
from stereo_slam_env.world.routes import named_route
from stereo_slam_env.world.scene import MovingBody
from studies.faults.catalogue import FAULTS

from ..filters.drives import CAMERA, drive
from ..stereo_slam_env.frontend.synthetic_steps import STEP, Cloud

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "what_this_is_not.md"
SOURCES = [path for package in ("filters", "stereo_slam_env") for path in (ROOT / package).rglob("*.py")]
OTHERS = "If you need one of these"
"""The section that only names others."""
CHECKS = {}


def says(sentence):
    """Register the check of a sentence of the page, as it stands there without marks and links."""

    def register(check):
        assert sentence not in CHECKS
        CHECKS[sentence] = check
        return check

    return register


def sentences():
    """Those of the page in its order, without headings, marks and links."""
    text = PAGE.read_text(encoding="utf-8").split(f"## {OTHERS}")[0]
    text = re.sub(r"^#.*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"\s*\(\[[^]]*\]\([^)]*\)\)", "", text)  # a link alone in brackets
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text).replace("*", "").replace("`", "")
    paragraphs = (" ".join(part.split()) for part in re.split(r"\n\n|^- ", text, flags=re.MULTILINE))
    return [one for paragraph in paragraphs for one in re.split(r"(?<=\.) (?=[A-Z])", paragraph) if one]


def fields(kind):
    return {field.name for field in dataclasses.fields(kind)}


def imported():
    """Names of the modules that ours import, wherever they do."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                yield from ((path, alias.name) for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                yield path, node.module


def driven(slam, frames, change=lambda uvd: uvd):
    """The filter over the frames of `drive`."""
    slam.reset(Start(linear_velocity=np.array([0.0, 0.0, 5.0])))
    for number, frame in enumerate(frames):
        if number:
            slam.predict(0.1)
        seen = frame.observation
        slam.update(StereoObservation(seen.ids, change(seen.uvd) if number else seen.uvd))
    return slam


# ---- sensors ---------------------------------------------------------------------------------------------------------


@says("This page lists the limits, so that you can decide quickly whether the software fits your problem.")
def lists_the_limits():
    assert len(sentences()) > 30


@says("Each sentence is a test (tests/docs/test_what_this_is_not.py).")
def each_sentence_is_a_test():
    assert f"tests/docs/{Path(__file__).name}" in PAGE.read_text(encoding="utf-8")


@says("No inertial sensor on a head that turns.")
@says('Drive-v0 with vehicle="smooth" has one; the rates of a head jump.')
def a_head_has_no_inertial_sensor():
    with gym.make("StereoSlam/Drive-v0", vehicle="smooth", imu="bmi088") as env:
        assert "imu" in env.observation_space.spaces
    with pytest.raises(ValueError, match="with a head that turns"):
        gym.make("StereoSlam/DriveGaze-v0", vehicle="smooth", imu="bmi088")
    with pytest.raises(TypeError, match="imu"):
        gym.make("StereoSlam/Gaze-v0", imu="bmi088")


@says(
    "A filter takes inertial samples, a recording keeps them, and the readers of EuRoC, KITTI raw, KITTI 00, tracks "
    "of one camera and bags read them."
)
def readers_make_inertial_samples():
    assert "inertial" in inspect.signature(StereoFilter.predict).parameters
    assert "inertial" in fields(Frame) & fields(StereoPair)
    reads = {path.name for path in SOURCES if re.search(r"samples_of_steps\(", path.read_text(encoding="utf-8"))}
    tracks = {"single_data_sets.py", "mono_tracks.py"}
    assert reads == {"inertial.py", "euroc.py", "kitti_raw.py", "bag_motion.py"} | tracks


@says("Images are rectified pairs.")
@says("The front end measures (u, v, d), for which a point must have the same row in both images.")
def the_front_end_measures_uvd():
    drive_of_images = RenderedDrive({"route": "straight", "rig": "qvga"}, 0, 2)
    pair = next(iter(drive_of_images.pairs()))
    seen = StereoTracker(drive_of_images.camera).track(pair.left, pair.right, None)
    assert len(seen.observation) > 20
    assert seen.observation.uvd.shape[1] == 3
    rows = np.abs(seen.observation.v_right - seen.observation.uvd[:, 1]) if seen.observation.v_right is not None else 0
    assert np.max(rows) < 2.0


@says(
    "The readers of EuRoC and TUM-VI, VSLAM-LAB, plain folders and ROS bags rectify on reading; all other images must "
    "already be rectified."
)
def some_readers_rectify():
    sources = {layout.NAME: inspect.getsource(inspect.getmodule(layout.open_sequence)) for layout in image_layouts()}
    that_do = [name for name, source in sources.items() if "Rectification" in source or "Recalibrated" in source]
    assert that_do == ["euroc", "vslam_lab", "stereo_folder", "ros_bag"]


@says("Fisheye, canted and depth cameras have models for measurements (fisheye, unrectified, depth), but no front end.")
def other_cameras_have_models_and_no_front_end():
    assert {"fisheye", "unrectified", "depth"} <= set(SLOTS["measurement"].named)
    noise = StereoNoise.diagonal(1.0, 1.0, 0.05)
    slam = StereoEKF(CAMERA, noise, measurement="depth")
    slam.update(StereoObservation([1, 2], np.array([[600.0, 150.0, 8.0], [700.0, 160.0, 9.0]])))
    assert slam.landmarks.positions[:, 2] == pytest.approx([8.0, 9.0])
    front_end = "".join(path.read_text(encoding="utf-8") for path in SOURCES if path.parent.name == "frontend")
    assert not re.search("fisheye|unrectified", front_end, re.IGNORECASE)


@says("Synchronous global shutters.")
@says("Both images of a pair have one time stamp, and every row of them the same.")
def one_time_stamp():
    assert [name for name in fields(StereoPair) if "time" in name] == ["timestamp"]
    assert not [path for path in SOURCES if re.search("rolling.shutter", path.read_text(encoding="utf-8"), re.I)]


@says("No calibration from images alone.")
@says("The front end measures one number before the drive, the disparity offset of a real rig.")
def the_front_end_measures_an_offset():
    measured = sorted(name for name in fields(TrackerSettings) if re.search("offset|focal|baseline|centre", name))
    assert measured == ["disparity_offset", "disparity_offset_sigma"]


@says(
    "Filters can estimate more: coloured-noise that offset and the rotation of the right camera, the measurement "
    "calibrated also the focal length, the baseline and the misalignment of camera and vehicle."
)
def filters_estimate_calibration():
    noise = ColouredNoise(np.eye(3), disparity_offset=0.05, right_yaw=0.002, right_roll=0.002)
    slam = driven(make_filter("coloured-noise", camera=CAMERA, noise=noise), drive(0, 8))
    believed = slam.belief("calibration")
    assert len(believed.value) == 3  # the offset, yaw and roll
    assert np.diag(believed.covariance)[0] < 0.05**2
    priors = {f"{name}_sigma": 0.01 for name in ("offset", "focal", "baseline", "misalignment", "yaw", "roll")}
    calibrated = {"name": "calibrated", **priors}
    slam = driven(StereoEKF(CAMERA, StereoNoise.diagonal(1.0, 1.0, 1.0), measurement=calibrated), drive(0, 8))
    assert np.abs(slam.belief("calibration").value).min() > 0.0
    assert len(slam.belief("calibration").value) == 8


@says("A wrong baseline cannot be seen from images at all.")
def a_wrong_baseline_is_hidden():
    """Every measurement agrees with a world that is larger by the same factor."""
    longer = dataclasses.replace(CAMERA, baseline=1.05 * CAMERA.baseline)
    points = np.random.default_rng(0).uniform([-5, -2, 5], [5, 2, 40], (50, 3))
    np.testing.assert_allclose(longer.project(1.05 * points), CAMERA.project(points), atol=1e-9)
    assert FAULTS["baseline-5"].hidden


@says("The monocular filter is a yardstick.")
@says("It starts landmarks from the disparity and then ignores the right image.")
def the_monocular_filter_ignores_the_right_image():
    frames = drive(0, 6, missed=0.0)

    def wrong(uvd):
        return uvd + np.array([0.0, 0.0, 0.7])

    def moved(name):
        slams = [make_filter(name, camera=CAMERA, noise=StereoNoise.diagonal(1, 1, 1), gate=None) for _ in range(2)]
        seen = frames[0].observation.ids
        kept = [dataclasses.replace(frame, observation=only(frame.observation, seen)) for frame in frames]
        one, other = driven(slams[0], kept), driven(slams[1], kept, wrong)
        return float(np.linalg.norm(one.pose.position - other.pose.position))

    assert moved("monocular") < 1e-12
    assert moved("inverse-depth") > 1e-3


def only(observation, ids):
    return observation.select(np.isin(observation.ids, ids))


# ---- mapping ---------------------------------------------------------------------------------------------------------


@says("No place recognition.")
@says("A landmark that the front end has lost is a new landmark when it is seen again.")
def lost_is_lost():
    images = RenderedDrive({"route": "straight", "rig": "qvga"}, 0, 1)
    (pair,) = images.pairs()
    tracker, dark = StereoTracker(images.camera), np.zeros_like(pair.left)
    first = tracker.track(pair.left, pair.right, None).observation.ids
    for _ in range(5):
        assert len(tracker.track(dark, dark, 0.1).observation) == 0
    again = [tracker.track(pair.left, pair.right, 0.1).observation.ids for _ in range(4)][-1]
    assert len(first) > 20
    assert len(again) > 20
    assert set(first.tolist()).isdisjoint(again.tolist())


def returning(revisit):
    """Whether an id is seen again after it was lost, while the head sweeps over the same things."""
    with_head = gym.make("StereoSlam/Gaze-v0", revisit=revisit, visibility=150.0)
    try:
        seen, lost, back = set(), set(), set()
        observation, _ = with_head.reset(seed=0)
        for k in range(60):
            now = set(observation["ids"][observation["mask"] > 0].tolist())
            back |= now & lost
            lost |= seen - now
            seen |= now
            side = 1.0 if (k // 20) % 2 == 0 else -1.0
            observation, *_ = with_head.step(np.array([side, 0.0], dtype=np.float32))
    finally:
        with_head.close()
    return bool(back)


@says("Loops close only if the ids return.")
@says("The landmark sensor can return a lost id (revisit=True).")
def ids_return_if_asked_for():
    assert returning(True)
    assert not returning(False)


@says("A filter that keeps its map (drop_unseen=False, submaps) then corrects the pose in one update.")
def a_kept_map_corrects():
    """Ten landmarks, a blind stretch that moves the belief 1.5 m aside, and one look at the ten again."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-6, -2, 8], [6, 2, 20], (10, 3))
    seen = StereoObservation(np.arange(10), CAMERA.project(points))
    astray = BodyVelocity(np.array([1.5, 0.0, 0.0]), np.zeros(3), 0.25 * np.eye(6))
    for name, options in (("inverse-depth", {"drop_unseen": False}), ("submaps", {})):
        slam = make_filter(name, camera=CAMERA, noise=StereoNoise.diagonal(1, 1, 1), gate=None, **options)
        slam.reset(Start(covariance=np.diag(np.repeat([1e-3, 1e-3, 0.5, 0.05], 3) ** 2)))
        slam.update(seen)
        for _ in range(10):
            slam.predict(0.1, astray)
            slam.update(StereoObservation(np.zeros(0, dtype=np.int64), np.zeros((0, 3))))
        before = np.linalg.norm(slam.pose.position)
        slam.update(seen)
        assert before > 0.5
        assert np.linalg.norm(slam.pose.position) < 0.2 * before, name


@says("No filter revises the past.")
@says("What it gives is the pose now and the map; the baseline batch smooths all poses, by GTSAM, as a reference.")
def no_filter_revises_the_past():
    beliefs = {name for name, kind in vars(StereoFilter).items() if isinstance(kind, property)}
    assert beliefs == {"pose", "velocity", "landmarks"}
    assert "smoothing" in available_filters()["batch"].lower()
    assert "GTSAM" in available_filters()["batch"]


@says("No dense map.")
@says("The map is points with covariances: no mesh, no occupancy grid, no semantics.")
def the_map_is_points():
    slam = driven(make_filter("shared-anchor", camera=CAMERA, noise=StereoNoise.diagonal(1, 1, 1)), drive(0, 3))
    count = len(slam.landmarks.ids)
    assert slam.landmarks.positions.shape == (count, 3)
    assert slam.landmarks.covariances.shape == (count, 3, 3)
    assert not any(re.search("mesh|grid|label|class|occup", name) for name in fields(type(slam.landmarks)))


@says("No relocalisation.")
@says("A filter that has diverged is reported, not restarted.")
def divergence_is_reported():
    starts = []

    class Astray(filters.InverseDepthStereoEKF):
        """Told that noise is 50 times smaller than it is."""

        def __init__(self, camera, noise, **options):
            super().__init__(camera, StereoNoise(noise.R / 2500.0), **options)

        def reset(self, start=None):
            starts.append(start)
            super().reset(start or Start())

    evaluation = sse.evaluate(Astray, sse.make_recording("reference-turn", 0), gate=0.5)
    assert evaluation.figures.diverged
    assert len(starts) <= 2  # a filter starts on its construction, and once for the drive


@says("One vehicle.")
@says("A recording has one rig, and a filter one map.")
def one_rig_and_one_map():
    assert isinstance(sse.make_recording("reference-turn", 0).camera, filters.StereoCamera)
    assert [name for name in fields(Recording) if "camera" in name or "rig" in name] == ["camera"]


# ---- front end -------------------------------------------------------------------------------------------------------


@says("Classical, unless you bring a network.")
@says("Corners, normalised correlation and Lucas–Kanade; a model file of yours runs through OpenCV, none is shipped.")
def no_learned_features():
    assert not [path for path in (ROOT / "stereo_slam_env").rglob("*") if path.suffix in {".onnx", ".pt", ".pb"}]
    learning = re.compile("torch|tensorflow|onnx|keras|cv2.dnn")
    assert [str(path) for path, name in imported() if path.parent.name == "frontend" and learning.match(name)] == []
    assert not any("dnn" in path.read_text() for path in SOURCES if path.parent.name == "frontend")


@says("Moving objects are rejected, not tracked.")
def moving_objects_are_rejected():
    pairs = Cloud(count=80, moved=20).pairs()
    found = robust_step(CAMERA, pairs, STEP)
    np.testing.assert_allclose(found.step.t, STEP.t, atol=0.05)
    assert not found.inliers[:20].any()


@says("If most landmarks are on one moving body, that body is taken for the scene.")
def the_majority_is_the_scene():
    pairs = Cloud(count=80, moved=64, shift=(0.4, 0.0, 0.8)).pairs()
    found = robust_step(CAMERA, pairs, None)
    assert np.linalg.norm(found.step.t - STEP.t) > 0.3


@says("No corner, no measurement.")
@says("A plain image gives none; of a world without texture only the corners of its shapes are left.")
def no_texture():
    textured, blank = (
        RenderedDrive({"route": "straight", "rig": "qvga", "blank_from": since}, 0, 1) for since in (None, 0.0)
    )
    found = {}
    for name, images in (("textured", textured), ("blank", blank)):
        (pair,) = images.pairs()
        found[name] = len(StereoTracker(images.camera).track(pair.left, pair.right, None).observation)
    plain = np.full_like(pair.left, 120)
    assert len(StereoTracker(blank.camera).track(plain, plain, None).observation) == 0
    assert 0 < found["blank"] < 0.5 * found["textured"]


# ---- world -----------------------------------------------------------------------------------------------------------


@says("Flat ground.")
@says("Routes are planar; the simulated car is a bicycle model.")
def routes_are_planar():
    for name in ("straight", "right-turn", "town", "loop"):
        assert not named_route(name).positions[:, 1].any()


@says("No photographs.")
def no_photographs():
    pictures = {".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tga", ".dds"}
    assert [path for path in (ROOT / "stereo_slam_env").rglob("*") if path.suffix.lower() in pictures] == []


@says(
    "Scenes and their textures are computed from a seed: measure on real data before you conclude anything about a "
    "real front end."
)
def scenes_are_computed():
    route = named_route("straight")
    first, second, other = (sse.world.build_scene("street", route, np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.landmark_points, second.landmark_points)
    assert (
        first.landmark_points.shape != other.landmark_points.shape
        or (first.landmark_points != other.landmark_points).any()
    )


@says("No traffic simulation.")
@says("Other cars and pedestrians follow scripts and do not react.")
def traffic_follows_scripts():
    """Where a body is depends on the time and on nothing else."""
    assert list(inspect.signature(MovingBody.pose_at).parameters) == ["self", "time"]


# ---- software --------------------------------------------------------------------------------------------------------


@says("No real-time guarantee.")
@says(
    "A frame of 100 landmarks takes about 1 ms compiled, but the only deadline is that of a benchmark, a minute a "
    "frame."
)
def no_deadline():
    assert inspect.signature(Scenario).parameters["frame_time_limit"].default == 60.0
    slam = make_filter("shared-anchor", camera=CAMERA, noise=StereoNoise.diagonal(1, 1, 1))
    frames = drive(0, 30, visible=100)
    driven(slam, frames)  # compiled by now
    begun = time.process_time()
    driven(slam, frames)
    assert (time.process_time() - begun) / len(frames) < 0.01


@says("No ROS in the package.")
@says(
    "Bags are read without it; the node is a template, and convert writes neither the odometry nor the inertial "
    "samples of a bag."
)
def no_ros():
    assert {name.split(".")[0] for _, name in imported()}.isdisjoint({"rospy", "rclpy"})
    assert "rclpy" in (ROOT / "templates" / "ros2-node" / "stereo_slam_node" / "node.py").read_text(encoding="utf-8")
    writer = (ROOT / "stereo_slam_env" / "datasets" / "bag_images.py").read_text(encoding="utf-8")
    assert not re.search(r"nav_msgs|sensor_msgs/msg/Imu", writer)


@says("Nothing is downloaded.")
@says("You fetch the data sets yourself.")
def nothing_is_downloaded():
    network = ("urllib.request", "http.client", "requests", "ftplib", "aiohttp", "httpx", "pooch")
    assert [str(path) for path, name in imported() if name.startswith(network)] == []


# ---- the page --------------------------------------------------------------------------------------------------------


def test_each_sentence_has_a_check_and_each_check_its_sentence():
    assert sorted(sentences()) == sorted(CHECKS)


@pytest.mark.slow
@pytest.mark.parametrize("sentence", CHECKS)
def test_it_is_so(sentence):
    CHECKS[sentence]()


def test_a_filter_named_for_those_who_need_more_is_none_of_ours():
    named = PAGE.read_text(encoding="utf-8").split(f"## {OTHERS}")[1]
    assert not any(name in named for name in available_filters())
