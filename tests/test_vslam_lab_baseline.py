"""The baseline for VSLAM-LAB: the command line it is called with, and the file that it must leave (10 s)."""

import csv
import importlib.util
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

import stereo_slam_env as sse

from .stereo_slam_env.datasets.small_image_folders import DT, FRAMES, true_poses
from .stereo_slam_env.datasets.test_field_recordings import EPOCH, vslam_lab

TEMPLATE = Path(__file__).resolve().parents[1] / "templates" / "vslam-lab"


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, TEMPLATE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_run_leaves_the_trajectory_that_vslam_lab_reads(tmp_path):
    """The experiment has copies of its own, of fewer pairs, and more options than the script knows."""
    sequence, experiment = vslam_lab(tmp_path / "sequence"), tmp_path / "experiment"
    experiment.mkdir()
    rows = (sequence / "rgb.csv").read_text().splitlines()
    (experiment / "rgb_exp.csv").write_text("\n".join(rows[:5]) + "\n")
    shutil.move(sequence / "calibration.yaml", experiment / "calibration_exp.yaml")
    (sequence / "calibration.yaml").write_text("of all experiments\n")
    said = {
        "sequence_path": sequence,
        "calibration_yaml": experiment / "calibration_exp.yaml",
        "rgb_csv": experiment / "rgb_exp.csv",
        "exp_folder": experiment,
        "exp_it": 7,
        "settings_yaml": "none.yaml",
        "verbose": 1,
        "mode": "stereo",
        "filter": "inverse-depth",
    }
    loaded("vslamlab_stereoslam").main([word for key, value in said.items() for word in (f"--{key}", str(value))])
    with (experiment / "00007_KeyFrameTrajectory.csv").open() as file:
        head, *table = csv.reader(file)
    assert head == ["ts (ns)", "tx (m)", "ty (m)", "tz (m)", "qx", "qy", "qz", "qw"]
    assert len(table) == 4 < FRAMES
    assert [int(row[0]) for row in table] == [round(1e9 * EPOCH) + round(1e9 * DT) * k for k in range(4)]
    positions = np.array([row[1:4] for row in table], dtype=float)
    files = {"calibration": str(said["calibration_yaml"]), "rgb_csv": str(said["rgb_csv"])}
    recording = sse.load(sequence, use_truth=False, **files)
    poses = [moment.slam.pose for moment in sse.run("inverse-depth", recording)]
    np.testing.assert_allclose(positions, [pose.position for pose in poses], rtol=0, atol=1e-9)
    way = true_poses()[3].position
    np.testing.assert_allclose(positions[-1], way, atol=0.15 * np.linalg.norm(way))


def test_the_class_says_what_the_base_class_of_vslam_lab_asks_for(monkeypatch):
    class Base:
        def __init__(self, name, folder, default_parameters):
            self.told = name, folder, default_parameters

    package, module = ModuleType("Baselines"), ModuleType("Baselines.BaselineVSLAMLAB")
    module.BaselineVSLAMLAB = Base
    monkeypatch.setitem(sys.modules, "Baselines", package)
    monkeypatch.setitem(sys.modules, "Baselines.BaselineVSLAMLAB", module)
    baseline = loaded("baseline_stereoslam").STEREOSLAM_baseline()
    assert baseline.told[2]["mode"] in baseline.modes
    assert baseline.command_style == "python"
    assert baseline.is_installed()[0]
