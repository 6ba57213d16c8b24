"""What `make same` says of two values, and of a figure that changed (10 s)."""

import importlib
import json
import math
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def same():
    sys.path.insert(0, str(FOLDER))
    try:
        return importlib.import_module("same")
    finally:
        sys.path.remove(str(FOLDER))


def test_a_difference_is_told_with_its_size(same):
    assert same.difference(1.0, 1.0) == same.difference(math.nan, math.nan) == ""
    assert same.difference(2.0, 2.5) == "2.0 -> 2.5 (2.5e-01 of it)"
    assert same.difference(["aa", 4.0], ["bb", 5.0]) == "sum 4.0 -> 5.0 (2.5e-01 of it)"
    assert same.difference(["aa", 4.0], ["bb", 4.0]) == "other bits, sum 4.0"
    assert same.difference("ok", "failed") == "'ok' -> 'failed'"


def test_a_digest_sees_a_bit_a_shape_and_a_type(same):
    import numpy as np

    one = np.array([1.0, 2.0])
    digests = [same.digest(x)[0] for x in (one, np.nextafter(one, 3.0), one[None], one.astype(np.float32), "1.0 2.0")]
    assert len(set(digests)) == 5
    assert same.digest(one, one) == same.digest(one.copy(), one.copy())


def test_figures_of_the_machine_are_left_out(same):
    told = {"pose_anees": 1.0, "ms_per_frame": 2.0, "memory_mb": 3.0, "deep": {"milliseconds": 4.0, "rmse": [5, 6]}}
    assert dict(same._numbers("run", told)) == {"run.pose_anees": 1.0, "run.deep.rmse.0": 5.0, "run.deep.rmse.1": 6.0}


def test_a_changed_figure_is_named_and_ends_with_1(same, monkeypatch, tmp_path, capsys):
    kept = tmp_path / "same.json"
    kept.write_text(json.dumps({"parts": {"stays": 1.0, "changes": 2.0, "goes": 3.0}}))
    monkeypatch.setattr(same, "KEPT", kept)
    monkeypatch.setattr(same, "PARTS", {"parts": lambda data: iter([("stays", 1.0), ("changes", 2.2), ("comes", 4.0)])})
    monkeypatch.setattr(sys, "argv", ["same.py"])
    assert same.main() == 1
    out = capsys.readouterr().out
    assert "parts: changes: 2.0 -> 2.2" in out
    assert "parts: goes: is gone" in out
    assert "parts: comes: is new" in out
    monkeypatch.setattr(sys, "argv", ["same.py", "--write"])
    assert same.main() == 0
    monkeypatch.setattr(sys, "argv", ["same.py"])
    assert same.main() == 0


def test_every_part_has_figures(same):
    assert set(json.loads(same.KEPT.read_text())) == set(same.PARTS)
