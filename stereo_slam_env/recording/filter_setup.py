"""Setup of filters for a recording: the one rule by which everything that runs a filter sets it up."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from filters.catalogue.registry import USUAL
from filters.contract.noise import ColouredNoise, StereoNoise
from filters.contract.validation import finite_array, gate_probability, require_known


@dataclass(frozen=True)
class FilterSetup:
    """Assumptions and inputs of the filters, as a scenario or a recording states them; without a statement these.

    Raises
    ------
    ValueError
        A value is impossible: the message names it.
    """

    use_odometry: bool = True
    """Whether filters are given the odometry, where there is any."""
    gate: float | None = USUAL["gate"]
    """Probability per landmark; None: no gate."""
    consensus: bool = False
    """Whether filters that can test the frame as a whole do so."""
    motion: Mapping[str, float] = field(default_factory=lambda: dict(USUAL["motion"]))
    """Fields of `ConstantVelocity` that the filters assume."""
    noise: Mapping[str, Any] | None = None
    """Assumed noise, {"independent_pixels": sigma} or {"diagonal": [u, v, d]}; None: that of the recording."""
    divergence_percent: float = 10.0
    """A run that ends farther from the truth than this share of the path has diverged."""

    def __post_init__(self) -> None:
        gate_probability(self.gate)
        require_known("motion has no key", self.motion, USUAL["motion"])
        self.assumed_noise(StereoNoise.independent_pixels(1.0))

    def assumed_noise(self, of_recording: StereoNoise) -> StereoNoise:
        """The noise filters are told to assume; what a recording says of errors that last holds with any R."""
        if self.noise is None:
            return of_recording
        require_known("noise has no key", self.noise, ("independent_pixels", "diagonal"))
        if len(self.noise) != 1:
            raise ValueError("noise must have one key: independent_pixels or diagonal")
        if "diagonal" in self.noise:
            stated_noise = StereoNoise.diagonal(*finite_array("noise.diagonal", self.noise["diagonal"], (3,)).tolist())
        else:
            stated_noise = StereoNoise.independent_pixels(self.noise["independent_pixels"])
        if isinstance(of_recording, ColouredNoise):
            lasts = None if of_recording.lasting is None else of_recording.lasting_time  # R - white is of another R
            return dataclasses.replace(of_recording, R=stated_noise.R, white=None, lasting_time=lasts)
        return stated_noise

    def common_options(self, own: Mapping[str, Any]) -> dict[str, Any]:
        """Options of every filter that leaves them open, beside its `own`: without a gate there is no consensus."""
        common: dict[str, Any] = {"gate": self.gate, "motion": dict(self.motion)}
        joint = self.consensus and own.get("gate", self.gate) is not None
        return {**common, "consensus": True} if joint else common

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form: keyword arguments of this class."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        """One line for results."""
        motion = [
            f"{self.motion[name]:.3g} {unit}" for name, unit in zip(USUAL["motion"], ("m/s²", "rad/s²"), strict=True)
        ]
        noise = "of the recording" if self.noise is None else f"{dict(self.noise)} px".replace("'", "")
        return "; ".join(
            [
                f"odometry {'used' if self.use_odometry else 'not used'}",
                "no gate" if self.gate is None else f"gate {self.gate:g} per landmark",
                f"consensus {'yes' if self.consensus else 'no'}",
                f"motion {', '.join(motion)}",
                f"noise {noise}",
            ]
        )
