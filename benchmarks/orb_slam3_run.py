"""ORB-SLAM3 on a drive that was written for others: stereo, or stereo and inertial, from its folder to a TUM file.

    python benchmarks/orb_slam3_run.py DRIVE estimate.tum                 # by settings/orb_slam3/stereo.yaml
    python benchmarks/orb_slam3_run.py DRIVE estimate.tum --inertial      # by settings/orb_slam3/stereo_inertial.yaml
    python benchmarks/orb_slam3_run.py DRIVE estimate.tum --vocabulary own

The Python that runs it needs pyorbslam3, NumPy and OpenCV (`pip install pyorbslam3 opencv-python-headless`) and nothing
else: ORB-SLAM3 is under the GPL, and stays in a process of its own. DRIVE is in the layout of EuRoC (`mav0/cam0`,
`cam1`, `imu0`), with `settings` beside `mav0`. The trajectory is that of the left camera, as the map has it at the end;
with --live each pose is that of its frame, as it came. (With inertial measurements the map is turned and scaled once
they are initialised, so that poses before and after do not go together.)

The vocabulary of ORB-SLAM3 (40 MB) is fetched once by pyorbslam3. `own` trains a small one on the pictures of the drive
instead, which needs no network: tracking and mapping take it as well, loops are found less surely.
"""

from __future__ import annotations

import argparse
import csv
import re
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

BRANCHES, LEVELS, PICTURES = 10, 4, 40
"""Of a vocabulary of one's own: 10^4 words at most, of so many pictures."""


def rows_of(path: Path) -> list[list[str]]:
    """Rows of a table of EuRoC, without its head."""
    with path.open(encoding="utf-8", newline="") as stream:
        return [[cell.strip() for cell in row] for row in csv.reader(stream) if row and not row[0].startswith("#")]


def pairs_of(drive: Path) -> list[tuple[int, Path, Path]]:
    """Stamp (ns) and both files of each pair."""
    left, right = (
        {
            int(row[0]): drive / "mav0" / camera / "data" / row[1]
            for row in rows_of(drive / "mav0" / camera / "data.csv")
        }
        for camera in ("cam0", "cam1")
    )
    return [(ns, left[ns], right[ns]) for ns in sorted(left.keys() & right.keys())]


def samples_of(drive: Path) -> np.ndarray:
    """Inertial samples (N, 7), s, rad/s, m/s^2, on the clock of the cameras: ORB-SLAM3 has no entry for an offset."""
    table = rows_of(drive / "mav0" / "imu0" / "data.csv")
    kalibr = (drive / "settings" / "kalibr" / "camchain.yaml").read_text(encoding="utf-8")
    offset = re.search(r"timeshift_cam_imu:\s*(\S+)", kalibr)
    samples = np.array([row[1:7] for row in table], dtype=np.float64)
    seconds = 1e-9 * np.array([int(row[0]) for row in table]) - (float(offset[1]) if offset else 0.0)
    return np.column_stack([seconds, samples])


def image(path: Path) -> np.ndarray:
    """A grey picture."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise ValueError(f"{path} is no picture: write the drive again")
    return grey


def train_vocabulary(pictures: list[Path], file: Path) -> int:
    """Write a vocabulary of ORB descriptors in the text form of DBoW2; the number of its words."""
    orb = cv2.ORB_create(1000)
    of_pictures = [orb.detectAndCompute(image(path), None)[1] for path in pictures]
    of_pictures = [descriptors for descriptors in of_pictures if descriptors is not None]
    descriptors = np.vstack(of_pictures)
    picture = np.repeat(np.arange(len(of_pictures)), [len(one) for one in of_pictures])
    signs = np.unpackbits(descriptors, axis=1).astype(np.float32) * 2 - 1
    rng, lines, words = np.random.default_rng(0), [f"{BRANCHES} {LEVELS} 0 0"], 0
    open_nodes = [(0, np.arange(len(descriptors)), 0)]
    while open_nodes:  # breadth first: parents stand before their children, whose number is that of their line
        parent, members, level = open_nodes.pop(0)
        for cluster in clusters(signs, members, rng):
            leaf = level + 1 == LEVELS or len(cluster) <= BRANCHES
            weight = np.log((1 + len(of_pictures)) / len(np.unique(picture[cluster])))
            middle = np.packbits(signs[cluster].sum(axis=0) > 0)
            lines.append(f"{parent} {int(leaf)} {' '.join(map(str, middle))} {weight:.6f}")
            words += leaf
            if not leaf:
                open_nodes.append((len(lines) - 1, cluster, level + 1))
    file.write_text("\n".join(lines), encoding="utf-8")  # a last line break would be one more word
    return words


def clusters(signs: np.ndarray, members: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Members in up to `BRANCHES` clusters by their Hamming distance to the majority of each."""
    own = signs[members]
    centres = own[rng.choice(len(members), min(BRANCHES, len(members)), replace=False)]
    nearest = np.zeros(len(members), dtype=int)
    for _ in range(5):
        nearest = np.argmax(own @ centres.T, axis=1)
        of_centre = [own[nearest == k] for k in range(len(centres))]
        centres = np.array([np.where(one.sum(axis=0) > 0, 1, -1) for one in of_centre if len(one)], dtype=np.float32)
    nearest = np.argmax(own @ centres.T, axis=1)
    return [members[nearest == k] for k in range(len(centres)) if (nearest == k).any()]


def tum_row(ns: int, T_wc: np.ndarray) -> str:
    """A line of a TUM file: seconds, position, quaternion xyzw."""
    R = np.asarray(T_wc[:3, :3], dtype=np.float64)
    q = np.zeros(4)
    trace, k = np.trace(R), int(np.argmax(np.diag(R)))
    if trace > R[k, k]:
        q[3] = np.sqrt(1.0 + trace) / 2
        q[:3] = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * q[3])
    else:
        i, j = (k + 1) % 3, (k + 2) % 3
        q[k] = np.sqrt(1.0 + 2 * R[k, k] - trace) / 2
        q[i], q[j], q[3] = np.array([R[i, k] + R[k, i], R[j, k] + R[k, j], R[j, i] - R[i, j]]) / (4 * q[k])
    return f"{ns // 10**9}.{ns % 10**9:09d} " + " ".join(f"{value:.9g}" for value in (*T_wc[:3, 3], *q))


def run(drive: Path, estimate: Path, vocabulary: str, inertial: bool, live: bool, frames: int | None) -> None:
    """Track every pair, write the trajectory, and say how it went."""
    import pyorbslam3

    pairs = pairs_of(drive)[:frames]
    kind = "stereo_inertial" if inertial else "stereo"
    settings = drive / "settings" / "orb_slam3" / f"{kind}.yaml"
    samples = samples_of(drive) if inertial else np.zeros((0, 7))
    sensor = pyorbslam3.Sensor.IMU_STEREO if inertial else pyorbslam3.Sensor.STEREO
    with tempfile.TemporaryDirectory() as folder:
        words = vocabulary
        if vocabulary == "own":
            words = str(Path(folder) / "vocabulary.txt")
            lefts = [left for _, left, _ in pairs]
            print(train_vocabulary(lefts[:: max(1, len(lefts) // PICTURES)], Path(words)), "words")
        with pyorbslam3.Slam(words or pyorbslam3.vocabulary_path(), settings, sensor) as slam:
            rows, tracked, began, last = [], 0, time.perf_counter(), -np.inf
            for ns, left, right in pairs:
                now = 1e-9 * ns
                chunk = samples[(samples[:, 0] > last) & (samples[:, 0] <= now)]
                result = slam.track_stereo(image(left), image(right), now, imu=chunk if inertial else None)
                last, tracked = now, tracked + result.ok
                rows += [tum_row(ns, result.pose_wc)] if result.pose_valid else []
            seconds = time.perf_counter() - began
            slam.shutdown()
            if live:
                estimate.write_text("\n".join(rows) + "\n", encoding="utf-8")
            else:
                slam.save_trajectory_tum(str(estimate))
    print(f"{kind}: {tracked} of {len(pairs)} frames tracked, {1e3 * seconds / len(pairs):.0f} ms each")


def main() -> None:
    """Run as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", type=Path)
    parser.add_argument("estimate", type=Path)
    parser.add_argument("--vocabulary", default="")
    parser.add_argument("--inertial", action="store_true")
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--frames", type=int)
    line = parser.parse_args()
    run(line.drive, line.estimate, line.vocabulary, line.inertial, line.live, line.frames)


if __name__ == "__main__":
    main()
