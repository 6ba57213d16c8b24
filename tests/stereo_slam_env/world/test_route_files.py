"""Routes along recorded drives, and routes by name. About 1 s, and 1 s for real drives."""

import os
from pathlib import Path

import numpy as np
import pytest

from stereo_slam_env.files.readers import read_poses
from stereo_slam_env.world.routes import FRAME_PERIOD, KITTI_PERIOD, ROUTES, kitti_route, named_route

from .pose_files import drive, figure_eight, write_poses

ROOT = Path(__file__).resolve().parents[3]
REAL = Path(os.environ.get("STEREO_SLAM_DATA", ROOT.parent / "shared" / "data")) / "kitti_poses"


def recorded(path, route, period):
    """Positions (K, 2) of a pose file at the frames of a route, turned into the first direction of the route."""
    level = read_poses(path)[0][:, [0, 2]]
    at = np.arange(route.frames) * FRAME_PERIOD
    level = np.stack([np.interp(at, np.arange(len(level)) * period, level[:, i]) for i in range(2)], axis=1)
    own, level = route.positions[:, [0, 2]], level - level[0]
    u, _, v = np.linalg.svd(own.T @ level)
    return level @ (u @ v).T


def test_it_drives_where_the_file_says_when_it_says(tmp_path):
    period = 0.1
    path = write_poses(tmp_path / "eight.txt", *figure_eight(period))
    route = kitti_route(path, period=period)
    assert route.frames == len(path.read_text().splitlines())
    away = np.linalg.norm(route.positions[:, [0, 2]] - recorded(path, route, period), axis=1)
    assert away.max() < 0.3
    np.testing.assert_allclose(route.speeds[5:-5], 6.0, atol=0.1)
    assert np.degrees(route.headings[-1]) == pytest.approx(0.0, abs=3.0)


def test_noise_of_the_poses_does_not_shake_the_car(tmp_path):
    positions, headings = figure_eight(0.1)
    noise = np.random.default_rng(0).normal(0.0, 0.02, positions.shape)
    smooth = kitti_route(write_poses(tmp_path / "clean.txt", positions, headings), period=0.1)
    noisy = kitti_route(write_poses(tmp_path / "noisy.txt", positions + noise, headings), period=0.1)
    assert np.abs(noisy.yaw_rates - smooth.yaw_rates).max() < 0.2
    assert np.abs(noisy.yaw_rates).max() < 0.7


def test_another_frame_rate_gives_the_same_drive(tmp_path):
    slow, fast = (
        kitti_route(write_poses(tmp_path / f"{k}.txt", *figure_eight(p)), period=p) for k, p in enumerate((0.1, 0.05))
    )
    assert slow.length == pytest.approx(fast.length, rel=0.01)
    assert slow.duration == pytest.approx(fast.duration, abs=0.2)


def test_it_stands_still_where_the_car_did(tmp_path):
    speeds = np.concatenate([np.full(60, 5.0), np.zeros(80), np.full(60, 5.0)])
    positions, headings = drive(speeds, np.zeros(200), 0.1)
    jitter = np.random.default_rng(0).normal(0.0, 0.004, positions.shape)
    route = kitti_route(write_poses(tmp_path / "stop.txt", positions + jitter, headings), period=0.1)
    assert (route.speeds[75:125] == 0).sum() > 40
    assert (route.speeds >= 0).all()
    assert route.length == pytest.approx(60.0, abs=1.0)
    assert np.abs(route.yaw_rates[75:125]).max() < 0.05
    assert np.isfinite(route.positions).all()


def test_a_name_or_a_file_makes_a_route_that_knows_what_it_was_made_from(tmp_path):
    assert named_route("town").length == ROUTES["town"]().length
    path = write_poses(tmp_path / "eight.txt", *figure_eight(KITTI_PERIOD))
    route = named_route(str(path))
    np.testing.assert_array_equal(named_route(route.name).positions, route.positions)


def test_an_unknown_name_gets_the_nearest_one():
    with pytest.raises(ValueError, match=r"'random-grid' or a KITTI pose file, got 'twon', did you mean 'town'\?"):
        named_route("twon")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p, h: (p + (np.arange(len(p)) > 40)[:, None] * 30.0, h), r"jumps by 4\d\.\d m from row 40"),
        (lambda p, h: (p, h + np.pi), r"drives backwards at row \d+: z must be forward"),
        (lambda p, h: (p * 0.01, h), r"drives only \d\.\d m: a route needs 5 m"),
        (lambda p, h: (np.where(np.arange(len(p))[:, None] == 3, np.nan, p), h), r"NaN or infinity in 1 rows.* row 3"),
    ],
    ids=["jump", "backwards", "short", "nan"],
)
def test_a_file_that_is_no_drive_is_named(tmp_path, change, message):
    path = write_poses(tmp_path / "odd.txt", *change(*figure_eight(KITTI_PERIOD)))
    with pytest.raises(ValueError, match=r"odd\.txt.*" + message):
        kitti_route(path)


def test_a_missing_file_and_a_wrong_period_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.txt is not a file: give a KITTI pose file"):
        kitti_route(tmp_path / "none.txt")
    with pytest.raises(ValueError, match="period"):
        kitti_route(write_poses(tmp_path / "eight.txt", *figure_eight(0.1)), period=0.0)


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no KITTI poses in {REAL}")
@pytest.mark.parametrize(("sequence", "within"), [("00", 2.5), ("05", 1.5), ("06", 1.0), ("07", 1.5)])
def test_real_drives_are_followed(sequence, within):
    path = REAL / f"{sequence}.txt"
    route = kitti_route(path)
    assert np.linalg.norm(route.positions[:, [0, 2]] - recorded(path, route, KITTI_PERIOD), axis=1).max() < within
    turning = route.speeds > 1.0
    assert (np.abs(route.yaw_rates[turning]) / route.speeds[turning]).max() < 1 / 3.5
