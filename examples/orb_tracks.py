"""ORB tracks of rendered pairs, as OpenCV matches them, in a file for `stereo-slam scenes noise --tracks`.

python examples/orb_tracks.py [FOLDER of `stereo-slam scenes record`] [FILE]
"""

import sys
from pathlib import Path

import cv2
import numpy as np

import stereo_slam_env as sse
from stereo_slam_env.datasets import write_recording

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "pairs")
file = Path(sys.argv[2] if len(sys.argv) > 2 else "tracks.txt")
if not folder.exists():  # as `stereo-slam scenes record right-turn --rig vga --seed 3 --frames 20 --out pairs`
    drive = sse.RenderedDrive({"route": "right-turn", "rig": "vga"}, seed=3, frames=20)
    write_recording(drive, folder, "kitti", may_lose={"odometry"})

orb, matcher = cv2.ORB_create(1500), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
rows, next_id, before = [], 0, None
for frame, path in enumerate(sorted((folder / "sequences" / "00" / "image_0").glob("*.png"))):
    left, right = (cv2.imread(str(path.parents[1] / name / path.name), 0) for name in ("image_0", "image_1"))
    (points, features), (points_right, features_right) = (orb.detectAndCompute(image, None) for image in (left, right))
    ids, tracked = np.full(len(points), -1), {}
    if before is not None:
        matches = matcher.match(before[1], features)
        tracked = {m.trainIdx: before[0][m.queryIdx] for m in matches if m.distance < 40 and before[0][m.queryIdx] >= 0}
    for match in matcher.match(features, features_right):
        k, (u, v), (u_right, v_right) = match.queryIdx, points[match.queryIdx].pt, points_right[match.trainIdx].pt
        if match.distance < 40 and abs(v - v_right) < 2.0 and 1.0 < u - u_right < 120.0:
            ids[k] = tracked.get(k, next_id)
            next_id += ids[k] == next_id
            sigma = 1.2 ** points[k].octave  # px, as ORB-SLAM assumes
            rows.append(
                f"{frame},{ids[k]},{u:.3f},{v:.3f},{u - u_right:.3f},{sigma:.3f},{sigma:.3f},{sigma * 2**0.5:.3f}"
            )
    before = ids, features
file.write_text("\n".join(["frame,id,u,v,d,su,sv,sd", *rows]) + "\n")
print(f"{len(rows)} measurements of {next_id} points in {file}")
