"""The learning curve of a run, as a table that grows."""

from __future__ import annotations

import csv
from dataclasses import asdict, fields
from pathlib import Path

from stereo_slam_env.training.evaluation import Evaluation

_COLUMNS = ("decisions", "seconds", "mean_return", *(field.name for field in fields(Evaluation)))


class LearningCurve:
    """Rows of a CSV file, read back when a run goes on.

    Parameters
    ----------
    file : Path
        Need not exist yet.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self.rows: list[dict[str, float]] = []
        if file.exists():
            with file.open(encoding="utf-8", newline="") as stream:
                self.rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]

    @property
    def seconds(self) -> float:
        """Spent so far."""
        return self.rows[-1]["seconds"] if self.rows else 0.0

    def add(self, decisions: int, seconds: float, mean_return: float, results: Evaluation) -> bool:
        """Add a row; whether it is the best so far, by the log det of the pose in the end."""
        row = {"decisions": float(decisions), "seconds": seconds, "mean_return": mean_return, **asdict(results)}
        best = all(results.final_pose_logdet < other["final_pose_logdet"] for other in self.rows)
        self.rows.append(row)
        with self._file.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, _COLUMNS)
            writer.writeheader()
            writer.writerows({name: f"{value:.6g}" for name, value in row.items()} for row in self.rows)
        return best
