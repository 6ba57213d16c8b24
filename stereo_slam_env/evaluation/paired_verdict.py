"""Verdict on two estimates of one drive: which of them has the smaller errors, and the better claim."""

from __future__ import annotations

from dataclasses import dataclass

from stereo_slam_env.evaluation.bands import MeanInterval


@dataclass(frozen=True)
class PairedVerdict:
    """One estimate against another one on the same frames of one drive."""

    estimate: str
    """Name of the first."""
    other: str
    """Name of the second."""
    frames: int
    """That both have."""
    error_ratio: tuple[float, float, float]
    """Of the position RMSE, with its 95 % interval; < 1: the first is better."""
    log_score_difference: MeanInterval | None
    """Nats a frame; < 0: the first is better; None: no claim to score."""

    @property
    def words(self) -> str:
        """The verdict in two sentences."""
        ratio, low, high = self.error_ratio
        better = self._better(high < 1.0, low > 1.0)
        text = f"The position error of {self.estimate} is {ratio:.3g} times that of {self.other}"
        text += f" (95 %: {low:.3g} to {high:.3g}): {better}."
        if (difference := self.log_score_difference) is None:
            return text
        better = self._better(difference.high < 0.0, difference.low > 0.0)
        interval = f"{difference.low:+.3g} to {difference.high:+.3g}".replace("-", "−")
        by = f"{difference.mean:+.3g}".replace("-", "−")
        return f"{text} Its log score of the pose differs by {by} nats (95 %: {interval}): {better}."

    def _better(self, first: bool, second: bool) -> str:
        return (
            f"{self.estimate} is better"
            if first
            else f"{self.other} is better"
            if second
            else "the difference is not significant"
        )
