"""The determinism certificate: the same bits every way, and a difference is found and named (40 s)."""

import dataclasses
import itertools
import json

import numpy as np
import pytest

from stereo_slam_env.benchmark import Scenario, Study, certificate, run_filter
from stereo_slam_env.benchmark.certificate import WAYS, Certificate, certify, digest_of_run
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice
from stereo_slam_env.cli import app as cli

FILTERS = (filter_choice("inverse-depth"),)
STREET = Scenario("corner", "street", {"route": "right-turn", "rig": "qvga", "max_landmarks": 20}, filters=FILTERS)
REFERENCE = Scenario("reference", "reference", {"name": "short_turn"}, filters=FILTERS, seeds=(0, 1, 2), frames=6)


@pytest.mark.slow
def test_every_way_gives_the_same_bits():
    ways = [way for way in WAYS if way not in ("ray", "dask")]  # their tests are in test_engines
    (made,) = certify(Study.of(STREET), ways, seeds=2, frames=3)
    assert made.holds
    assert list(made.found) == ways
    assert set(made.parts) == {"stream", "episodes", "bound", "filter inverse-depth"}
    assert set(made.found["vector, async"]) == {"episodes"}


def test_a_certificate_is_the_same_another_time_and_another_for_other_seeds():
    (first,) = certify(Study.of(REFERENCE), ["one process"], seeds=2, frames=3)
    (second,) = certify(Study.of(REFERENCE), ["again"], seeds=2, frames=3)
    (fewer,) = certify(Study.of(REFERENCE), ["one process"], seeds=1, frames=3)
    assert first.sha256 == second.sha256 != fewer.sha256


def test_a_difference_is_named():
    a, b = "a" * 64, "b" * 64
    made = Certificate("x", {"one process": {"stream": a, "filter f": a}, "ray": {"stream": a, "filter f": b}}, {})
    assert not made.holds
    assert made.differences == (("ray", "filter f"),)
    assert made.as_dict()["differences"] == [{"way": "ray", "part": "filter f"}]


def test_the_digest_of_a_run_has_every_bit_and_no_clock():
    recording = short_turn(seed=0, frames=5)
    first, second = run_filter(recording, "inverse-depth"), run_filter(recording, "inverse-depth")
    assert digest_of_run(first) == digest_of_run(second)
    touched = first.positions.copy()
    touched[-1, 0] = np.nextafter(touched[-1, 0], np.inf)
    assert digest_of_run(dataclasses.replace(first, positions=touched)) != digest_of_run(first)


def test_a_way_that_is_not_installed_is_told(monkeypatch):
    def missing(*_, **__):
        raise ImportError("engine ray is not installed: get it")

    monkeypatch.setattr(certificate, "run_benchmark", missing)
    (made,) = certify(Study.of(REFERENCE), ["ray"])
    assert "engine ray is not installed: get it" in made.not_run["ray"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ways": ["carrier pigeon"]}, "way must be one of environment alone, .*got 'carrier pigeon'"),
        ({"ways": []}, "ways must name at least one"),
        ({"frames": 1}, "frames >= 2"),
        ({"seeds": 0}, "seeds must be >= 1"),
    ],
)
def test_what_cannot_be_certified_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        certify(Study.of(REFERENCE), **changes)


def test_the_command_writes_the_certificate(capsys, tmp_path):
    arguments = ["certify", "reference-turn", "--ways", "one process,again", "--seeds", "1", "--frames", "3"]
    assert cli.main([*arguments, "--out", str(tmp_path / "certificate.json")]) == 0
    assert "the same every way" in capsys.readouterr().out
    written = json.loads((tmp_path / "certificate.json").read_text())
    (one,) = written["certificates"]
    assert one["holds"]
    assert one["ways"] == ["one process", "again"]
    assert len(one["sha256"]) == 64
    assert written["versions"]["numpy"]


def test_the_command_says_what_differs_with_exit_code_1(capsys, monkeypatch):
    numbers = itertools.count()
    monkeypatch.setattr(certificate, "digest_of_run", lambda run: str(next(numbers)))
    arguments = ["certify", "reference-turn", "--ways", "one process,again", "--seeds", "1", "--frames", "3"]
    assert cli.main(arguments) == 1
    out = capsys.readouterr().out
    assert "not the same" in out
    assert "reference-turn: filter inverse-depth differs in the way 'again'" in out


def test_the_command_refuses_in_a_line(capsys):
    assert cli.main(["certify", "nowhere"]) == 2
    assert capsys.readouterr().err.startswith("error: preset must be one of")
