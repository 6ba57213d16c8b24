"""What `evaluate` writes is as the schema beside it says (5 s)."""

import json
from dataclasses import asdict

import pytest

import stereo_slam_env as sse
from stereo_slam_env.evaluation.score_schema import KEPT, score_schema
from stereo_slam_env.evaluation.trajectory_runs import score_runs
from stereo_slam_env.evaluation.trajectory_score import SCHEMA

from .test_trajectory_score import drives

jsonschema = pytest.importorskip("jsonschema", reason="needs the extra dev")


def complaints(figures):
    schema = json.loads(KEPT.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    plain = json.loads(json.dumps(figures))
    return [error.message for error in jsonschema.Draft202012Validator(schema).iter_errors(plain)]


def test_the_schema_that_is_shipped_is_that_of_the_types():
    assert json.loads(KEPT.read_text(encoding="utf-8")) == score_schema()


def test_what_is_written_is_as_the_schema_says():
    scores = [sse.evaluate_trajectory(*drives(60, seed=seed, name=str(seed))) for seed in (1, 2)]
    figures = {
        "schema": SCHEMA,
        "scores": [score.as_dict() for score in scores],
        "against": asdict(scores[0].against(scores[1])),
        "runs": score_runs(scores).as_dict(),
    }
    assert complaints(figures) == []
    del figures["scores"][0]["position_rmse_m"]
    assert complaints(figures) == ["'position_rmse_m' is a required property"]
