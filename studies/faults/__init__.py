"""The reaction of filters to faults of the input, and whether divergence is detected: `python -m studies.faults`."""

from studies.faults.catalogue import FAULTS, Fault
from studies.faults.matrix import FaultMatrix, Run, Session, drive_through, run_matrix

__all__ = ["FAULTS", "Fault", "FaultMatrix", "Run", "Session", "drive_through", "run_matrix"]
