"""One frame of all trials as flat arrays, and what became of each measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from filters.engine.fates import BEHIND, FAILED, GATED, USED
from filters.interface import StereoObservation, UpdateReport
from filters.noise import StereoNoise
from filters.validation import BoolArray, FloatArray, IntArray

INITIALISED, REJECTED = FAILED + 1, FAILED + 2
OUTCOMES = {
    USED: "updated",
    BEHIND: "behind_camera",
    GATED: "gated",
    FAILED: "failed",
    INITIALISED: "initialised",
    REJECTED: "rejected",
}
"""What can become of a measurement, of a known landmark or a new one: the fields of `UpdateReport`."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """N measurements of all trials, trial by trial and within a trial in the order of ids.

    Attributes
    ----------
    trial, ids : (N,) int64
        Who measured what.
    uvd : (N, 3)
        Left pixel and disparity, px.
    R : (N, 3, 3)
        Covariances, px^2.
    v_right : (N,), optional
        Row measured in the right image, px.
    """

    trial: IntArray
    ids: IntArray
    uvd: FloatArray
    R: FloatArray
    v_right: FloatArray | None

    @classmethod
    def of(cls, observations: Sequence[StereoObservation], noise: StereoNoise) -> Sightings:
        """The observations of a frame, one for each trial; `noise` where an observation brings no R.

        Raises
        ------
        ValueError
            Something is not a StereoObservation, or v_right is measured in some trials and not in others.
        """
        for number, observation in enumerate(observations):
            if not isinstance(observation, StereoObservation):
                raise ValueError(f"observations[{number}] must be a StereoObservation, got {observation!r}")
        sizes = np.array([len(observation) for observation in observations])
        seeing = [observation for observation in observations if len(observation)]
        if not seeing:
            return cls(_NO_IDS, _NO_IDS, np.zeros((0, 3)), np.zeros((0, 3, 3)), None)
        with_v = sum(observation.v_right is not None for observation in seeing)
        if 0 < with_v < len(seeing):
            raise ValueError(
                f"v_right must be measured in all trials of a frame or in none, got it in {with_v} of {len(seeing)}: "
                "leave it out, or run the trials one by one"
            )
        sightings = cls(
            np.repeat(np.arange(len(sizes)), sizes),
            np.concatenate([observation.ids for observation in seeing]),
            np.concatenate([observation.uvd for observation in seeing]),
            np.concatenate([observation.covariances(noise) for observation in seeing]),
            np.concatenate([observation.v_right for observation in seeing]) if with_v else None,
        )
        same_trial = sightings.trial[1:] == sightings.trial[:-1]
        if (same_trial & (sightings.ids[1:] < sightings.ids[:-1])).any():
            return sightings[np.lexsort((sightings.ids, sightings.trial))]
        return sightings

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: IntArray | BoolArray) -> Sightings:
        v_right = None if self.v_right is None else self.v_right[index]
        return Sightings(self.trial[index], self.ids[index], self.uvd[index], self.R[index], v_right)

    def numbered(self) -> StereoObservation:
        """All of them as one observation, for a measurement model: the ids are replaced by plain numbers."""
        return StereoObservation(np.arange(len(self)), self.uvd, self.v_right)


_NO_IDS: IntArray = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class TrialReports:
    """What one `update` did with each measurement of B trials; `reports[b]` is the `UpdateReport` of trial b.

    Attributes
    ----------
    trial, ids, outcome : (N,) int64
        Whose measurement, of which landmark, and what became of it: a number of `OUTCOMES`.
    dropped_trial, dropped_ids : (K,) int64
        Landmarks that left the map.
    nis, nis_dof : (B,)
        Normalised innovation squared of each trial and its degrees of freedom.
    """

    trial: IntArray
    ids: IntArray
    outcome: IntArray
    nis: FloatArray
    nis_dof: IntArray
    dropped_trial: IntArray = field(default_factory=_NO_IDS.copy)
    dropped_ids: IntArray = field(default_factory=_NO_IDS.copy)

    def __len__(self) -> int:
        return len(self.nis)

    def __getitem__(self, trial: int) -> UpdateReport:
        own = self.trial == trial
        fields = {name: self.ids[own & (self.outcome == number)] for number, name in OUTCOMES.items()}
        dropped = np.sort(self.dropped_ids[self.dropped_trial == trial])
        return UpdateReport(**fields, dropped=dropped, nis=float(self.nis[trial]), nis_dof=int(self.nis_dof[trial]))

    def counts(self) -> dict[str, IntArray]:
        """How many landmarks of each trial met with each outcome, "dropped" among them; name -> (B,)."""
        trials = len(self)
        counted = {
            name: np.bincount(self.trial[self.outcome == number], minlength=trials) for number, name in OUTCOMES.items()
        }
        return {**counted, "dropped": np.bincount(self.dropped_trial, minlength=trials)}
