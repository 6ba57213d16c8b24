"""The reaction of filters to faults of the input, and whether divergence is detected: `stereo-slam faults`."""

from stereo_slam_env.studies.faults.catalogue import FAULTS, Fault
from stereo_slam_env.studies.faults.matrix import FaultMatrix, Run, Session, drive_through, run_matrix

__all__ = ["FAULTS", "Fault", "FaultMatrix", "Run", "Session", "drive_through", "run_matrix"]
