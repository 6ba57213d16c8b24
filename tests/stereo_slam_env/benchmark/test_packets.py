"""Packets of results: handed in, repeated, and used as the baseline of a gate (20 s)."""

import copy
import json
from dataclasses import replace

import pytest

from stereo_slam_env.benchmark import preset, run_benchmark
from stereo_slam_env.benchmark.gate import gate
from stereo_slam_env.benchmark.packets import packet_of, read_packet, verify, write_packet
from stereo_slam_env.cli import app as cli


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "run"
    run_benchmark("reference-turn", out, filters=["shared-anchor"], seeds=range(4), jobs=1)
    return out


@pytest.fixture(scope="module")
def packet(run):
    return packet_of(run)


def changed(packet, factor, name="position_rmse_m", only=None):
    other = copy.deepcopy(packet)
    for k, row in enumerate(other["cells"][0]["trials"]["shared-anchor"]):
        if only is None or k in only:
            row[name] *= factor
    return other


def test_a_packet_has_the_study_the_digests_of_the_recordings_and_the_figures(run, packet):
    summary = json.loads((run / "summary.json").read_text())
    (cell,) = packet["cells"]
    assert [one["stream_sha256"] for one in cell["recordings"]] == [r["stream_sha256"] for r in summary["recordings"]]
    rows = cell["trials"]["shared-anchor"]
    assert [row["seed"] for row in rows] == [0, 1, 2, 3]
    found = summary["filters"]["shared-anchor"]["position_rmse_by_run"]
    assert [row["position_rmse_m"] for row in rows] == pytest.approx(found, rel=1e-5)
    assert all(0.0 < row["claim"]["coverage_90"] <= 1.0 and row["claim"]["scale_gap"] > 0 for row in rows)


def test_a_packet_on_disk_names_each_figure_once_and_is_the_same_when_read(packet, tmp_path):
    path = tmp_path / "packet.json"
    rows = [{**row, "seed": seed} for seed in range(100) for row in packet["cells"][0]["trials"]["shared-anchor"][:1]]
    many = {**packet, "cells": [{**packet["cells"][0], "trials": {"shared-anchor": rows}}]}
    write_packet(path, many)
    assert path.read_text().count("position_rmse_m") == 1
    assert read_packet(path) == many
    write_packet(path, packet)
    assert path.stat().st_size < 4_000
    assert read_packet(path) == packet


def test_what_is_repeated_agrees_and_what_was_changed_does_not(packet, tmp_path):
    found = verify(packet, tmp_path / "again", seeds=2, jobs=1)
    assert found.agrees
    assert found.same_streams
    assert found.same_code
    assert not found.other_plugins
    assert (found.trials, found.of, found.largest) == (2, 4, 0.0)
    lied = changed(packet, 0.9)
    lied["cells"][0]["code_of_others"] = {"shared-anchor": "0123456789abcdef"}  # a filter of that name, once
    found = verify(lied, tmp_path / "lied", seeds=1, jobs=1)
    assert not found.agrees
    assert "position_rmse_m of shared-anchor" in found.words
    assert found.other_plugins == ("shared-anchor",)
    assert "by the same code and other code of shared-anchor, on" in found.words


def test_policies_measure_something_else_each_and_are_repeated_as_well(tmp_path):
    scenario = replace(preset("gaze"), frames=8)
    run_benchmark(scenario, tmp_path / "run", policies=["fixed", "sweep"], seeds=[3], jobs=1)
    packet = packet_of(tmp_path / "run")
    write_packet(tmp_path / "gaze.json", packet)
    (recording,) = read_packet(tmp_path / "gaze.json")["cells"][0]["recordings"]
    assert set(recording["stream_sha256"]) == {"fixed", "sweep"}
    assert len(set(recording["stream_sha256"].values())) == 2
    assert verify(packet, tmp_path / "again", jobs=1).same_streams
    recording["stream_sha256"]["sweep"] = 64 * "0"
    other = {**packet, "cells": [{**packet["cells"][0], "recordings": [recording]}]}
    assert not verify(other, tmp_path / "other", jobs=1).same_streams


def test_which_recordings_are_repeated_hangs_on_the_results(packet, tmp_path):
    """So that nobody can know, before a figure is made, whether it will be checked."""
    picked = set()
    for k in range(4):
        other = changed(packet, 1.0 + 1e-9 * k)
        out = tmp_path / str(k)
        verify(other, out, seeds=1, jobs=1)
        picked.add(json.loads((out / "settings.json").read_text())["scenario"]["seeds"][0])
    assert len(picked) > 1


def test_a_packet_that_is_none_is_refused_in_one_line(packet, tmp_path):
    path = tmp_path / "packet.json"
    write_packet(path, packet)
    good = json.loads(path.read_text())
    (cell,) = good["cells"]
    columns = cell["trials"]["shared-anchor"]
    short, rows = {**columns, "path_m": [1.0]}, [{"seed": 0}]
    damaged = [{**good, "cells": [{**cell, "trials": {"shared-anchor": each}}]} for each in (short, rows, 3)]
    studies = ({**good, "cells": []}, {**good, "cells": 1}, {**good, "more": 1}, {**good, "study": {}})
    for content in ({}, [], {"format": "x"}, *damaged, *studies):
        path.write_text(json.dumps(content))
        with pytest.raises(ValueError, match=r"packet\.json") as refused:
            read_packet(path)
        assert "\n" not in str(refused.value)
    with pytest.raises(ValueError, match="does not exist"):
        read_packet(tmp_path / "nothing.json")


def test_the_gate_passes_what_is_the_same_and_stops_what_is_worse(packet):
    assert gate([packet], [packet]).passed
    worse = gate([packet], [changed(packet, 1.2)])
    assert not worse.passed
    assert "position error, m of shared-anchor: more than 5 % is worse" in worse.headline
    assert gate([packet], [changed(packet, 1.2)], limit_percent=25.0).passed
    assert gate([packet], [changed(packet, 0.5)]).passed
    row = next(row for row in worse.rows if row.measure.startswith("position"))
    assert row.change_percent == pytest.approx(20.0)


def test_with_enough_recordings_the_gate_asks_what_is_shown():
    """A change that scatters about none is not worse, one that all have is, however small."""
    many = packet_like([1.0 + 0.01 * k for k in range(20)])
    scattered = packet_like([(1.0 + 0.01 * k) * (1.3 if k % 2 else 0.75) for k in range(20)])
    assert gate([many], [scattered]).passed
    small = gate([many], [packet_like([1.02 * (1.0 + 0.01 * k) + 1e-3 * (k % 3) for k in range(20)])])
    assert not small.passed
    assert small.rows[1].by == "recordings"


def test_several_runs_of_one_recording_are_two_groups():
    before = [packet_like([1.0 + 0.02 * k]) for k in range(8)]
    assert gate(before, [packet_like([1.01 + 0.02 * k]) for k in range(8)]).passed
    worse = gate(before, [packet_like([1.4 + 0.02 * k]) for k in range(8)])
    assert not worse.passed
    assert worse.rows[1].by == "runs"


def test_what_is_missing_or_diverges_does_not_pass(packet):
    diverged = copy.deepcopy(packet)
    diverged["cells"][0]["trials"]["shared-anchor"][0]["diverged"] = 1
    assert not gate([packet], [diverged]).passed
    fewer = copy.deepcopy(packet)
    del fewer["cells"][0]["trials"]["shared-anchor"][0]
    assert "was not run on 1 of 4 recordings" in gate([packet], [fewer]).headline
    with pytest.raises(ValueError, match="no filter in common"):
        gate([packet], [packet_like([1.0])])


def test_the_commands_say_it_by_their_exit_codes(run, packet, tmp_path, capsys):
    path, worse = tmp_path / "packet.json", tmp_path / "worse.json"
    assert cli.main(["submit", str(run), "--out", str(path)]) == 0
    write_packet(worse, changed(packet, 2.0))
    assert cli.main(["gate", str(path), str(run), "--markdown", str(tmp_path / "gate.md")]) == 0
    assert (tmp_path / "gate.md").read_text().startswith("**Passed")
    assert cli.main(["gate", str(path), str(worse)]) == 1
    assert cli.main(["gate", str(path), str(tmp_path / "nothing")]) == 2
    assert cli.main(["verify", str(worse), "--seeds", "1", "--jobs", "1", "--json"]) == 1
    assert '"agrees": false' in capsys.readouterr().out


def packet_like(errors):
    """A packet as far as a gate looks at it: a position error for each recording."""
    rows = [
        {"recording": f"drive {k}", "seed": k, "position_rmse_m": error, "diverged": 0}
        for k, error in enumerate(errors)
    ]
    rest = dict.fromkeys(("rotation_rmse_deg", "pose_anees", "ms_per_frame"))
    return {"cells": [{"name": "one", "trials": {"mine": [{**rest, **row} for row in rows]}}]}
