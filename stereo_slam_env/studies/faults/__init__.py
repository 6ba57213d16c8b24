"""What filters do when something goes wrong, and whether they notice: `stereo-slam faults`."""

from stereo_slam_env.studies.faults.catalogue import FAULTS, Fault
from stereo_slam_env.studies.faults.matrix import FaultMatrix, Run, run_matrix
from stereo_slam_env.studies.faults.session import Session, drive_through

__all__ = ["FAULTS", "Fault", "FaultMatrix", "Run", "Session", "drive_through", "run_matrix"]
