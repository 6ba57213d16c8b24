"""ORB-SLAM3 on a stereo drive in the KITTI layout: writes its trajectory as TUM, for `stereo-slam replay --trajectory`.

    pip install pyorbslam3 opencv-python-headless          # GPL-3: an environment and a process of its own
    stereo-slam convert FOLDER kitti                      # where the drive is not in that layout
    python run.py kitti/sequences/00 est.tum --vocabulary ORBvoc.txt
    stereo-slam replay FOLDER --trajectory orbslam3=est.tum

It imports nothing of stereo-slam-env. ORBvoc.txt is that of ORB-SLAM3 (139 MB, `pyorbslam3.vocabulary_path()` fetches
it). Without it a small random vocabulary is made, with which it is an odometry: it closes no loops and does not find
its place again. It is not deterministic: run it several times.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np
from pyorbslam3 import Sensor, Slam

SETTINGS = """%YAML:1.0
---
Camera.type: "PinHole"
Camera.fx: {fx}
Camera.fy: {fy}
Camera.cx: {cx}
Camera.cy: {cy}
Camera.k1: 0.0
Camera.k2: 0.0
Camera.p1: 0.0
Camera.p2: 0.0
Camera.width: {width}
Camera.height: {height}
Camera.fps: {fps}.0
Camera.RGB: 1
Camera.bf: {bf}
ThDepth: 40.0
ORBextractor.nFeatures: {features}
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 12
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""


def random_vocabulary(path: Path, branches: int = 10) -> None:
    """Write a vocabulary of DBoW2 of two levels with random words."""
    rng = np.random.default_rng(0)
    rows = [f"{branches} 2 0 0"]
    parents = [0] * branches + [1 + k // branches for k in range(branches**2)]
    for number, parent in enumerate(parents):
        word = " ".join(map(str, rng.integers(0, 256, 32)))
        rows.append(f"{parent} {int(number >= branches)} {word} 1.0")
    path.write_text("\n".join(rows) + "\n")


def calibration(folder: Path) -> dict[str, float]:
    """Intrinsics of a pair, and its baseline in px m, by the projection matrices of the left and the right camera."""
    lines = [line.split(":")[-1].split() for line in (folder / "calib.txt").read_text().splitlines() if line.strip()]
    left, right = (np.array(line[-12:], dtype=float).reshape(3, 4) for line in lines[:2])
    fx = left[0, 0]
    return {"fx": fx, "fy": left[1, 1], "cx": left[0, 2], "cy": left[1, 2], "bf": -right[0, 3]}


def main() -> None:
    """Track all pairs and write the camera's poses, T_wc."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="with image_0, image_1, calib.txt, times.txt")
    parser.add_argument("out", type=Path, help="trajectory, TUM")
    parser.add_argument("--vocabulary", type=Path, help="ORBvoc.txt of ORB-SLAM3; without it: random words")
    parser.add_argument("--features", type=int, default=2000)
    given = parser.parse_args()
    left, right = (sorted((given.folder / name).glob("*.png")) for name in ("image_0", "image_1"))
    pairs = list(zip(left, right, strict=True))
    if not pairs:
        parser.error(f"{given.folder} has no pictures in image_0 and image_1")
    times = np.loadtxt(given.folder / "times.txt")[: len(pairs)]
    height, width = cv2.imread(str(pairs[0][0]), cv2.IMREAD_GRAYSCALE).shape
    about = calibration(given.folder) | {"width": width, "height": height, "features": given.features}
    with tempfile.TemporaryDirectory() as scratch:
        settings, vocabulary = Path(scratch) / "settings.yaml", given.vocabulary or Path(scratch) / "words.txt"
        settings.write_text(SETTINGS.format(**about, fps=round(1.0 / np.median(np.diff(times)))))
        if given.vocabulary is None:
            random_vocabulary(vocabulary)
        slam = Slam(vocabulary, settings, Sensor.STEREO)
        for time, pair in zip(times, pairs, strict=True):
            slam.track_stereo(*(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in pair), float(time))
        slam.shutdown()
        slam.save_trajectory_tum(str(given.out))


if __name__ == "__main__":
    main()
