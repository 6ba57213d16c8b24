"""Replay of a folder of KITTI images: the front end, then two filters on the same measurements, and their errors.

Give it a sequence of KITTI odometry (the folder with image_0 and image_1, or image_2 and image_3). Without one it
renders a short drive and writes it in KITTI's layout first.
The command `stereo-slam replay FOLDER` does this with a report.

Run it: python examples/replay_kitti.py PATH/sequences/07 --frames 200
"""

import argparse
import tempfile

import stereo_slam_env as sse
from stereo_slam_env.datasets import write_recording


def replay(folder, **options):
    """Print the errors of two filters on the sequence in a folder."""
    recording = sse.load(folder, **options)
    measured = sum(len(frame.observation) for frame in recording.frames)
    print(f"{recording.name}: {len(recording)} pairs, {measured / len(recording):.0f} landmarks in each")
    for name in ("inverse-depth", "dual-bearing"):
        run = sse.evaluate(name, recording, use_odometry=False, gate=0.99, consensus=True)
        found, end = run.figures, run.series.positions[-1]
        if found.ate_rigid_m is None:
            print(f"{name:<14} ends at {end.round(2)} m; the folder has no true poses to compare with")
        else:
            print(f"{name:<14} ATE {found.ate_rigid_m:.3f} m, drift at the end {found.end_drift_percent:.2f} %")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", help="a KITTI odometry sequence")
    parser.add_argument("--frames", type=int, default=None)
    given = parser.parse_args()
    if given.folder is not None:
        replay(given.folder, **({} if given.frames is None else {"last": given.frames - 1}))
    else:
        with tempfile.TemporaryDirectory() as out:
            drive = sse.RenderedDrive({"route": "right-turn", "rig": "qvga"}, seed=0, frames=given.frames or 25)
            replay(write_recording(drive, out, "kitti", may_lose={"odometry"}))
