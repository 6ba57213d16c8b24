"""The command `stereo-slam`, as `python -m stereo_slam_env`."""

import sys

from stereo_slam_env.cli.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
