"""`scenes record` and `convert`: drives for other programs, as a user asks for them. About 20 s."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from stereo_slam_env.cli import app
from stereo_slam_env.datasets import open_image_sequence

DRIVE = ["scenes", "record", "right-turn", "--rig", "vga,width=160,height=120,fx=115,fy=115,cx=79.5,cy=59.5"]


def record(out, *more):
    return app.main([*DRIVE, "--out", str(out), *map(str, more)])


def test_a_drive_with_an_inertial_unit_is_read_by_its_own_reader(tmp_path, capsys):
    assert record(tmp_path / "d", "--format", "euroc", "--imu", "bmi088", "--frames", 3) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "d")
    pairs = list(open_image_sequence(tmp_path / "d").pairs())
    assert [pair.inertial is None for pair in pairs] == [True, False, False]
    assert pairs[1].odometry is not None
    assert pairs[1].inertial.unit.gyro_density == 2.4e-4
    readme = (tmp_path / "d" / "README.md").read_text()
    assert "none but these" in readme
    assert "T_cam_imu" in readme


def test_seeds_go_into_folders_and_whole_ones_are_kept(tmp_path, capsys):
    options = ("--format", "tum-vi", "--imu", "adis16448", "--frames", 2, "--seed", 3, "--seeds", 2)
    assert record(tmp_path / "s", *options) == 0
    assert sorted(folder.name for folder in (tmp_path / "s").iterdir()) == ["003", "004"]
    before = (tmp_path / "s" / "003" / "truth_body.tum").stat().st_mtime_ns
    (tmp_path / "s" / "004").rename(tmp_path / "moved")
    assert record(tmp_path / "s", *options) == 0
    assert (tmp_path / "s" / "003" / "truth_body.tum").stat().st_mtime_ns == before
    one, other = (
        (folder / "mav0" / "imu0" / "data.csv").read_bytes() for folder in (tmp_path / "s" / "004", tmp_path / "moved")
    )
    assert one == other
    assert one != (tmp_path / "s" / "003" / "mav0" / "imu0" / "data.csv").read_bytes()


def test_a_flight_has_the_rate_that_is_asked_for(tmp_path):
    drive = [*DRIVE[:2], "flight", *DRIVE[3:], "--out", str(tmp_path / "f"), "--format", "euroc"]
    assert app.main([*drive, "--imu", "car", "--rate", "25", "--frames", "3", "--imu-offset", "0.004"]) == 0
    sequence = open_image_sequence(tmp_path / "f")
    pairs = list(sequence.pairs())
    np.testing.assert_allclose([pair.timestamp for pair in pairs], [0.0, 0.04, 0.08], atol=1e-9)
    assert len(pairs[1].inertial.times) == 8
    assert np.linalg.norm(sequence.gravity) == pytest.approx(9.81)
    assert sequence.gravity[1] < 9.81  # the first camera is not level


def test_a_unit_with_errors_of_scale_says_so(tmp_path):
    common = ("--format", "euroc", "--imu", "bmi088", "--frames", 2)
    assert record(tmp_path / "a", *common) == record(tmp_path / "b", *common, "--scale-errors") == 0
    assert "of scale and alignment" in (tmp_path / "b" / "README.md").read_text()
    tables = [(tmp_path / name / "mav0" / "imu0" / "data.csv").read_text() for name in "ab"]
    assert tables[0] != tables[1]
    stated = json.loads((tmp_path / "a" / "source.json").read_text())["arguments"]
    assert (stated["imu"], stated["imu_calibrated"]) == ("bmi088", True)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--imu", "bmi088"], "the format kitti has no place for inertial samples.* choose euroc, tum-vi, mcap"),
        (["--imu", "mpu6050"], "imu has no data sheet 'mpu6050'"),
        (["--format", "rosbag3"], "there is no format 'rosbag3', did you mean 'bag'"),
        (["--rate", "30"], "--rate needs the route 'flight', got 'right-turn': a drive has 10 pairs a second"),
        (["--imu-offset", "0.01"], "--imu-offset is of an inertial unit: give --imu, too"),
        (["--scale-errors"], "--scale-errors is of an inertial unit: give --imu, too"),
        (["--format", "euroc", "--name", "07"], "name '07' is of a KITTI sequence: leave it out of the format euroc"),
        *(
            (["--format", "euroc", "--imu", "car", "--imu-offset", text], "time_offset must be from -10 to 10 s, got")
            for text in ("nan", "inf", "-11", "1e9")
        ),
        (["--compressed"], "compressed must be left out of the format kitti"),
        (["--imu", "bmi088", "--vehicle", "kinematic"], "imu must be None with vehicle='kinematic'"),
    ],
)
def test_what_cannot_be_written_is_said_in_a_line(tmp_path, capsys, options, complaint):
    assert record(tmp_path / "d", "--frames", 2, *options) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert re.search(complaint, line)
    assert not (tmp_path / "d").exists()


def test_convert_keeps_what_was_measured_or_refuses(tmp_path, capsys):
    pytest.importorskip("rosbags")
    drive, bag = str(tmp_path / "d"), str(tmp_path / "d.bag")
    assert record(drive, "--format", "euroc", "--imu", "bmi088", "--frames", 3) == 0
    assert app.main(["convert", drive, str(tmp_path / "k")]) == 2
    assert "or leave them out (--lossy of convert)" in capsys.readouterr().err
    assert app.main(["convert", drive, bag]) == 0
    back = ["convert", bag, str(tmp_path / "e"), "--format", "euroc"]
    assert app.main(back) == 2
    assert "name it (--odometry-topic, --imu-topic), or leave it out (convert --lossy)" in capsys.readouterr().err
    assert app.main([*back, "--odometry-topic", "/wheel/odometry"]) == 0
    for pair, other in zip(
        open_image_sequence(tmp_path / "e").pairs(), open_image_sequence(drive).pairs(), strict=True
    ):
        np.testing.assert_array_equal(pair.left, other.left)
        np.testing.assert_allclose(pair.truth.position, other.truth.position, atol=1e-9)
        if other.inertial is not None:
            np.testing.assert_allclose(pair.inertial.specific_forces, other.inertial.specific_forces, atol=1e-9)
            np.testing.assert_allclose(pair.odometry.covariance, other.odometry.covariance, atol=1e-9)
        np.testing.assert_allclose(pair.velocity.linear, other.velocity.linear, atol=1e-4)  # as far as rates agree


def test_replay_of_a_drive_with_samples_runs_the_inertial_filter_and_knows_the_truth_to_be_exact(tmp_path, capsys):
    assert record(tmp_path / "d", "--format", "euroc", "--imu", "bmi088", "--frames", 6) == 0
    assert app.main(["replay", str(tmp_path / "d"), "--out", str(tmp_path / "runs")]) == 0
    said = capsys.readouterr().out
    assert "independent truth (simulation). Exact poses of the simulation." in said
    assert "inertial, coloured-noise, inverse-depth, dual-bearing, euclidean" in " ".join(said.split())


def test_who_interrupts_it_is_told_how_to_go_on(tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("stereo_slam_env.datasets.writing.write_recording", interrupted)
    assert record(tmp_path / "d", "--frames", 2) == 130
    assert "interrupted: the same command goes on from here" in capsys.readouterr().err
