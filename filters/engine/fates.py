"""What becomes of a known landmark's measurement in one update: codes, one byte each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FateArray = NDArray[np.uint8]
USED, BEHIND, GATED, FAILED = range(4)
"""Corrected the state · predicted behind the camera · not believable · no Cholesky factor."""
