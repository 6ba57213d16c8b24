"""The command, for `python -m stereo_slam_env.cli`."""

import sys

from stereo_slam_env.cli.app import main

sys.exit(main())
