"""Many charts at once: the files and drawings of one by one (5 s)."""

import os
import sys

import pytest

from stereo_slam_env.report.charts import saving
from stereo_slam_env.report.charts.axes import PALETTE, Axis
from stereo_slam_env.report.charts.drawing import Curve, Panel, figure


def chart(number):
    panel = Panel(Axis(0, 10), Axis(0, 10), 300, 200)
    panel.lines([Curve(f"line {number}", [0, 5, number], [0, 1, number], PALETTE[number])])
    return figure([panel], {f"line {number}": PALETTE[number]})


def pictures(folder, count=8):
    folder.mkdir()
    return [(chart(i % 5), (folder / f"{i}.png", folder / f"{i}.svg")) for i in range(count)]


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr(saving, "_cores", lambda: 2)


def test_they_are_those_of_one_by_one(tmp_path, two_cores):
    together, alone = pictures(tmp_path / "together"), pictures(tmp_path / "alone")
    assert saving.save_all(together) == [one.save(*paths) for one, paths in alone]
    for (_, paths), (_, others) in zip(together, alone, strict=True):
        for path, other in zip(paths, others, strict=True):
            assert path.read_bytes() == other.read_bytes()


def test_some_are_drawn_in_another_process(tmp_path, two_cores, monkeypatch):
    here = []
    saved = saving._saved
    monkeypatch.setattr(saving, "_saved", lambda picture: here.append(picture) or saved(picture))
    assert len(saving.save_all(pictures(tmp_path / "figures"))) == 8
    assert len(here) == 4


def test_where_a_process_fails_they_are_drawn_here(tmp_path, two_cores, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false" if os.path.exists("/bin/false") else "false")
    assert all(drawing.startswith("<svg") for drawing in saving.save_all(pictures(tmp_path / "figures")))
    assert len([*(tmp_path / "figures").iterdir()]) == 16


def test_few_are_drawn_here(tmp_path, two_cores, monkeypatch):
    monkeypatch.setattr(saving, "_elsewhere", None)
    assert len(saving.save_all(pictures(tmp_path / "figures", 3))) == 3
    assert saving.save_all([]) == []
