"""Who moves unlike the scene: measurements of a landmark against the motion of the camera, now and before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from filters.camera import StereoCamera
from filters.engine.gating import gate_limit
from filters.validation import IntArray
from stereo_slam_env.frontend.ego_motion import chained
from stereo_slam_env.frontend.finding import Found
from stereo_slam_env.frontend.moving import STRIKES, moving_together
from stereo_slam_env.frontend.stereo_step import Pairs, Step, squared_distances
from stereo_slam_env.frontend.tracked import Outcome
from stereo_slam_env.frontend.tracks import Tracks


def judged(
    camera: StereoCamera, tracks: Tracks, found: Found, steps: Sequence[Step], gate: float
) -> tuple[Tracks, IntArray]:
    """Enter what was found, and say who was found where no standing landmark would be.

    A slow body is told from the scene over several pairs only, so each measurement is compared with all that are
    remembered.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    tracks : Tracks
        With the memory moved on: nothing measured yet in this pair.
    found : Found
        In this pair.
    steps : sequence of Step
        Motion of the camera, newest first; empty where it is not known.
    gate : float
        Probability with which a standing landmark passes.

    Returns
    -------
    tracks : Tracks
        With the measurements, ages, misses, strikes and moving ones of this pair.
    outcome : (N,) int64
        An `Outcome` each.
    """
    measured, measured_R = tracks.measured.copy(), tracks.measured_R.copy()
    measured[:, 0], measured_R[:, 0] = found.uvd, found.R
    matched = found.matched
    unlike, together = np.zeros(len(tracks), dtype=bool), np.zeros(len(tracks), dtype=bool)
    limit = gate_limit(gate, 3)
    over: Step | None = None
    for back, step in enumerate(steps, start=1):
        over = step if over is None else chained(step, over)
        known = np.flatnonzero(matched & np.isfinite(measured[:, back, 0]))
        pairs = Pairs(measured[known, back], measured[known, 0], measured_R[known, back], measured_R[known, 0])
        off = squared_distances(camera, pairs, over) > limit
        unlike[known] |= off
        off &= (pairs.first[:, 2] > 0) & (pairs.second[:, 2] > 0)
        strange = pairs.select(off)
        together[known[off]] |= moving_together(
            camera, strange.first, strange.second, strange.R_first, strange.R_second, over
        )
    strikes = np.where(matched, np.where(unlike, tracks.strikes + 1, 0), tracks.strikes)
    moving = tracks.moving | (together & (strikes >= STRIKES))
    outcome = found.outcome.copy()
    outcome[matched & unlike] = Outcome.INCONSISTENT
    outcome[matched & moving] = Outcome.MOVING
    entered = replace(
        tracks,
        measured=measured,
        measured_R=measured_R,
        age=tracks.age + matched,
        misses=np.where(matched, 0, tracks.misses + 1),
        strikes=strikes,
        moving=moving,
    )
    return entered, outcome
