"""JSON schema of what `evaluate` prints; `python -m stereo_slam_env.evaluation.score_schema` writes it anew."""

from __future__ import annotations

import json
from dataclasses import fields, make_dataclass
from pathlib import Path
from typing import Any, Literal, get_type_hints

from stereo_slam_env.evaluation.claims import ClaimScore
from stereo_slam_env.evaluation.trajectory_runs import RunsClaim, RunsScore
from stereo_slam_env.evaluation.trajectory_score import SCHEMA, PairedVerdict, TrajectoryScore
from stereo_slam_env.files.folders import write_atomically

KEPT = Path(__file__).with_name("score.schema.json")
"""The schema that is shipped."""


def score_schema() -> dict[str, Any]:
    """JSON schema of the figures of `evaluate`, by the types that hold them."""
    import msgspec

    claim = _plain(ClaimScore, coverage=dict[str, float], verdict=str)
    score = _plain(
        TrajectoryScore,
        schema=Literal[SCHEMA],
        claims=dict[str, claim],  # type: ignore[valid-type]
        verdict=str,
        depends_on_the_gauge=bool,
    )
    runs_claim = _plain(RunsClaim, verdict=str, alone=int)
    runs = _plain(RunsScore, claims=dict[str, runs_claim], words=str)  # type: ignore[valid-type]
    entries = {
        "schema": Literal[SCHEMA],
        "scores": list[score],  # type: ignore[valid-type]
        "against": PairedVerdict | None,
        "runs": runs | None,
    }
    schema = msgspec.json.schema(make_dataclass("Evaluation", entries.items()))
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _plain(kind: type, **others: Any) -> Any:
    """The type of what JSON has of a dataclass: without its series, with other types of some fields, and more."""
    hints = get_type_hints(kind)
    entries = {field.name: hints[field.name] for field in fields(kind) if field.repr} | others
    return make_dataclass(kind.__name__, entries.items())


if __name__ == "__main__":
    write_atomically(KEPT, lambda stream: stream.write((json.dumps(score_schema(), indent=1) + "\n").encode()))
