"""The command `stereo-slam`, which Ctrl-C ends without a traceback while its modules are imported, too."""

import sys


def main() -> int:
    """Run the command; returns its exit code."""
    try:
        from stereo_slam_env.cli.app import main as run
    except KeyboardInterrupt:
        return 130
    return run()


if __name__ == "__main__":
    sys.exit(main())
