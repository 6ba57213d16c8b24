"""From rendered images to a trajectory: a drive, the front end, and a filter whose forecast guides the search.

Run it: python examples/track_images.py
"""

import numpy as np

import stereo_slam_env as sse
from filters import make_filter
from stereo_slam_env.frontend import TYPICAL_NOISE, StereoTracker

drive = sse.RenderedDrive({"route": "right-turn", "rig": "qvga"}, seed=0, frames=40)
tracker = StereoTracker(drive.camera, drive.front_end)
slam = make_filter("inverse-depth", camera=drive.camera, noise=TYPICAL_NOISE, gate=0.99, consensus=True)
slam.reset(drive.start)

before = None
for pair in drive.pairs():
    if before is None:
        tracked = tracker.track(pair.left, pair.right)
    else:
        dt = pair.timestamp - before
        slam.predict(dt)
        tracked = tracker.track(pair.left, pair.right, dt, slam.forecast())
    slam.update(tracked.observation)
    before = pair.timestamp

error = np.linalg.norm(slam.pose.position - pair.truth.position)
print(f"{len(tracked.observation)} landmarks in the last pair; position error {error:.2f} m after {len(drive)} pairs")
