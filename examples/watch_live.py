"""Watch a filter while it drives, in Rerun's viewer (extra viewer): cameras, map, ellipsoids, consistency.

Without an option a viewer opens; --save writes a file that `rerun FILE` opens, --connect shows it in a viewer that
runs elsewhere. Run it: python examples/watch_live.py --save drive.rrd
"""

import argparse

import gymnasium as gym

import stereo_slam_env as sse
from filters import make_filter
from stereo_slam_env.viewer import RerunView

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument("--save", metavar="OUT.rrd")
parser.add_argument("--connect", metavar="ADDRESS")
parser.add_argument("--frames", type=int, default=80)
given = parser.parse_args()

env = gym.make("StereoSlam/Drive-v0", route="right-turn", policy="route")
env.reset(seed=0)
rig = env.unwrapped
loop = sse.FilterLoop(make_filter("inverse-depth", camera=rig.camera, noise=rig.noise), use_odometry=False)
loop.reset(rig.start)
landmarks = rig.landmark_truth()
with RerunView(rig.camera, ["inverse-depth"], save=given.save, connect=given.connect, landmarks=landmarks) as view:
    for frame in range(given.frames):
        if frame:
            _, _, over, cut, _ = env.step(env.action_space.sample())
        view.show("inverse-depth", loop.step(rig.frame))
        if frame and (over or cut):
            break
print(f"{frame + 1} frames shown")
env.close()
