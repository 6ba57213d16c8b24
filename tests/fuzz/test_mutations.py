"""A short, deterministic part of what `fuzz/run.py` does for hours: no input may crash, hang or lead out (10 s)."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest

from fuzz.harness import GONE, HEADER, LINK, RAW, Finding, Harness
from fuzz.mutations import mutated
from fuzz.targets import Target, targets

INPUTS = 30


@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_changed_files_are_read_or_refused_in_one_line(target: Target, tmp_path: Path) -> None:
    harness = Harness((target,), tmp_path)
    seeds, rng = harness.seeds(0), random.Random(target.name)
    assert [harness.run(data) for data in seeds[:: max(len(seeds) // 20, 1)]].count(None) >= 20 or len(seeds) < 20
    inputs = [mutated(rng.choice(seeds), seeds, rng) for _ in range(INPUTS)]
    assert [finding for finding in map(harness.run, inputs) if finding is not None] == []


@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_the_seeds_are_valid(target: Target, tmp_path: Path) -> None:
    Harness((target,), tmp_path)
    assert target.read(tmp_path / "0" / target.name) is not None


def found(read, tmp_path: Path, how: int = RAW, content: bytes = b"x") -> Finding | None:
    return Harness((Target("toy", {"a/file": b"1\n"}, read),), tmp_path).run(bytes([0, 0, how]) + content)


class TestTheHarnessSees:
    def test_what_is_no_value_error(self, tmp_path: Path) -> None:
        finding = found(lambda folder: {}[(folder / "a" / "file").read_text()], tmp_path)
        assert finding is not None
        assert finding.what == "KeyError: 'x'"

    def test_a_message_of_several_lines(self, tmp_path: Path) -> None:
        def read(folder: Path) -> None:
            raise ValueError("one\ntwo")

        assert found(read, tmp_path) is not None

    def test_a_slow_reader(self, tmp_path: Path) -> None:
        def read(folder: Path) -> None:
            while time.process_time() < end:
                pass

        end = time.process_time() + 1.1
        finding = found(read, tmp_path)
        assert finding is not None
        assert finding.what.startswith("slow")

    def test_a_link_that_is_followed(self, tmp_path: Path) -> None:
        finding = found(lambda folder: (folder / "a" / "file").read_text(), tmp_path, LINK)
        assert finding is not None
        assert "link" in finding.what

    def test_a_missing_file(self, tmp_path: Path) -> None:
        assert found(lambda folder: (folder / "a" / "file").read_text(), tmp_path, GONE) is not None

    def test_nothing_where_nothing_is_wrong(self, tmp_path: Path) -> None:
        assert found(lambda folder: (folder / "a" / "file").read_text(), tmp_path) is None


def test_an_input_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    harness = Harness((Target("toy", {"a/file": b"1\n"}, lambda folder: None),), tmp_path)
    for how in range(5):
        harness.run(bytes([0, 0, how]) + b"x")
        assert (tmp_path / "0" / "toy" / "a" / "file").read_bytes() == b"1\n"


def test_mutations_change_the_content_alone() -> None:
    rng = random.Random(0)
    seed = b"abc" + b"1 2 3\n4 5 6\n"
    made = {mutated(seed, [seed], rng) for _ in range(50)}
    assert {data[:HEADER] for data in made} == {b"abc"}
    assert len(made) > 40
