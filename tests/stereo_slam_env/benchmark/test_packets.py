"""Packets of results: handed in, repeated, and used as the baseline of a gate (20 s)."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.benchmark import preset, run_benchmark
from stereo_slam_env.benchmark.gate import GATED, Gate, gate
from stereo_slam_env.benchmark.packet_form import checked_packet, columns_of, missing_in, with_trials
from stereo_slam_env.benchmark.packets import packet_of, read_packet, verify, write_packet
from stereo_slam_env.benchmark.scenarios.study import Study
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
    write_packet(path, packet)
    assert path.read_text().count("position_rmse_m") == 1
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
    scenario = preset("gaze").replaced(frames=8)
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


def test_which_recordings_are_repeated_nobody_can_know(packet, tmp_path):
    """Not before, and not from the packet: a forger would turn a figure until honest trials are drawn."""

    def drawn(packet, name, **options):
        found = verify(packet, tmp_path / name, seeds=1, jobs=1, **options)
        return found.draw, json.loads((tmp_path / name / "settings.json").read_text())["scenario"]["seeds"]

    turned = changed(packet, 1.5, "ms_per_frame")
    of_draw = {draw: drawn(packet, f"a{draw}", draw=draw)[1] for draw in (0, 1, 2)}
    assert len({tuple(seeds) for seeds in of_draw.values()}) > 1
    assert drawn(turned, "b", draw=2)[1] == of_draw[2]
    draws = [drawn(packet, f"c{k}")[0] for k in range(2)]
    assert draws[0] != draws[1]
    assert "(--draw 2)" in verify(packet, tmp_path / "a2", seeds=1, jobs=1, draw=2).words


def forged(packet, change):
    """A packet after a change of its cell."""
    other = copy.deepcopy(packet)
    change(other["cells"][0], other)
    return other


def rows_of(cell):
    return cell["trials"]["shared-anchor"]


CONTRADICTIONS = {
    "each row many times": lambda cell, _: cell["trials"].update({"shared-anchor": 20 * rows_of(cell)}),
    "a row twice, another one not": lambda cell, _: rows_of(cell).__setitem__(1, dict(rows_of(cell)[0])),
    "a row is missing": lambda cell, _: rows_of(cell).pop(),
    "another system": lambda cell, _: cell["trials"].update({"<script>alert(1)</script>": rows_of(cell)}),
    "no system": lambda cell, _: cell["trials"].clear(),
    "the system has another name": lambda cell, _: cell["trials"].update(best=cell["trials"].pop("shared-anchor")),
    "another seed": lambda cell, _: rows_of(cell)[0].update(seed=77),
    "another recording": lambda cell, _: rows_of(cell)[0].update(recording="mine"),
    "recordings of another seed": lambda cell, _: [r[0].update(seed=77) for r in (cell["recordings"], rows_of(cell))],
    "a recording twice": lambda cell, _: cell["recordings"].append(cell["recordings"][0]),
    "recordings in another order": lambda cell, _: cell["recordings"].reverse(),
    "measurements of another system": lambda cell, _: cell["recordings"][0].update(stream_sha256={"best": 64 * "0"}),
    "code of another system": lambda cell, _: cell["code_of_others"].update(best="0"),
    "nothing is missing": lambda cell, _: rows_of(cell)[0].update(failure="it crashed"),
    "something is missing": lambda cell, packet: packet.update(missing=["one: nothing"]),
    "the truth is none": lambda cell, _: cell["recordings"][0].update(reference="none"),
}
DAMAGE = {
    "a figure is a text": lambda cell, _: rows_of(cell)[0].update(nis="1"),
    "a figure is a list": lambda cell, _: rows_of(cell)[0].update(nis=[1.0]),
    "a figure is not finite": lambda cell, _: rows_of(cell)[0].update(nis=float("nan")),
    "a figure is infinite": lambda cell, _: rows_of(cell)[0].update(path_m=float("inf")),
    "a figure has too many digits": lambda cell, _: rows_of(cell)[0].update(nis=10**400),
    "another figure": lambda cell, _: rows_of(cell)[0].update(best=1.0),
    "diverged": lambda cell, _: rows_of(cell)[0].update(diverged="no"),
    "a claim is a number": lambda cell, _: rows_of(cell)[0].update(claim=1.0),
    "a claim lacks a figure": lambda cell, _: rows_of(cell)[0]["claim"].pop("log_score"),
    "a negative scale": lambda cell, _: rows_of(cell)[0]["claim"].update(scale_gap=-1.0),
    "a coverage of 2": lambda cell, _: rows_of(cell)[0]["claim"].update(coverage_90=2.0),
    "a name is a list": lambda cell, _: cell["recordings"][0].update(name=[]),
    "a seed is a dict": lambda cell, _: cell["recordings"][0].update(seed={}),
    "no digest": lambda cell, _: cell["recordings"][0].update(stream_sha256="x"),
    "a digest is a number": lambda cell, _: cell["recordings"][0].update(stream_sha256=3),
    "no recordings": lambda cell, _: cell.pop("recordings"),
    "code of others is a list": lambda cell, _: cell.update(code_of_others=[]),
    "a key of its own": lambda cell, _: cell.update(more=1),
    "missing is a number": lambda cell, packet: packet.update(missing=3),
    "missing has a number": lambda cell, packet: packet.update(missing=[3]),
    "versions is a list": lambda cell, packet: packet.update(versions=[]),
    "versions has a list": lambda cell, packet: packet["versions"].update(code=[]),
    "the study is a list": lambda cell, packet: packet.update(study=[]),
    "the study has a name of its own": lambda cell, packet: packet["study"].update(name=["x"]),
    "factors are a number": lambda cell, packet: packet["study"]["cells"][0].update(factors=3),
    "filters are a number": lambda cell, packet: packet["study"]["cells"][0]["scenario"].update(filters=3),
    "too many seeds": lambda cell, packet: packet["study"]["cells"][0]["scenario"].update(seeds=[*range(1_000_001)]),
    "too many cells": lambda cell, packet: packet["study"].update(cells=10_001 * [{"scenario": {}}]),
    "too many frames": lambda cell, packet: packet["study"]["cells"][0]["scenario"].update(frames=10**9),
}


@pytest.mark.parametrize("change", [*CONTRADICTIONS, *DAMAGE])
def test_what_the_study_does_not_say_is_refused_in_a_line(packet, tmp_path, capsys, change):
    other = forged(packet, {**CONTRADICTIONS, **DAMAGE}[change])
    (tmp_path / "p.json").write_text(json.dumps({**other, "cells": with_trials(other["cells"], columns_of)}))
    for command in (["verify"], ["report", "--fail-if-worse", str(tmp_path / "p.json")]):
        assert cli.main([*command, str(tmp_path / "p.json")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "p.json is a damaged packet" in line


def test_claims_beyond_the_first_ten_recordings_are_refused(packet):
    other = copy.deepcopy(packet)
    cell, scenario = other["cells"][0], other["study"]["cells"][0]["scenario"]
    scenario["seeds"] = [*range(12)]
    cell["recordings"] = [{**cell["recordings"][0], "seed": k} for k in range(12)]
    row = rows_of(cell)[0]
    name = cell["recordings"][0]["name"]
    cell["trials"]["shared-anchor"] = [{**row, "recording": name, "seed": k} for k in range(12)]
    with pytest.raises(ValueError, match="has claims of shared-anchor beyond the first 10 recordings"):
        checked_packet({**other, "cells": with_trials(other["cells"], columns_of)})


OTHER = "has other measurements here"


@pytest.mark.parametrize(
    ("of", "lies", "said"),
    [
        ("claim", {"scale_gap": 1.0}, "scale_gap of shared-anchor"),
        ("claim", {"coverage_90": 0.5}, "coverage_90 of shared-anchor"),
        ("claim", {"log_score": -99.0}, "log_score of shared-anchor"),
        ("claim", {"gauge": "start"}, "claim of shared-anchor"),
        ("claim", None, "claim of shared-anchor"),
        ("recordings", {"stream_sha256": 64 * "0"}, OTHER),
        ("recordings", {"frames": 500}, OTHER),
        ("recordings", {"reference": "ins"}, OTHER),
    ],
    ids=str,
)
def test_what_was_made_up_is_found(packet, tmp_path, capsys, of, lies, said):
    def change(cell, _):
        for row, recording in zip(rows_of(cell), cell["recordings"], strict=True):
            if lies is None:
                del row[of]
            else:
                (row["claim"] if of == "claim" else recording).update(lies)

    write_packet(tmp_path / "p.json", forged(packet, change))
    assert cli.main(["verify", str(tmp_path / "p.json"), "--seeds", "1", "--jobs", "1"]) == 1
    assert said in " ".join(capsys.readouterr().out.split())


def test_limits_of_time_are_not_those_of_the_packet(packet, tmp_path):
    other = copy.deepcopy(packet)
    other["study"]["cells"][0]["scenario"].update(frame_time_limit=1e6, recording_time_limit=1e6, kept_seeds=1)
    verify(other, tmp_path, seeds=1, jobs=1)
    scenario = json.loads((tmp_path / "settings.json").read_text())["scenario"]
    assert (scenario["frame_time_limit"], scenario["recording_time_limit"]) == (60.0, 600.0)


def test_what_a_packet_says_is_no_markup_and_moves_no_cursor(packet, capsys, tmp_path):
    def hostile(cell, packet):
        text = "\x1b[2J<script>|[a](javascript:b)`"
        for row in rows_of(cell):
            row["failure"] = text
        for k, one in enumerate(cell["recordings"]):
            one.update(name=f"{text}{k}", reference=text)
            rows_of(cell)[k]["recording"] = f"{text}{k}"
        packet["study"]["name"] = text
        packet["missing"] = list(missing_in(cell, Study.from_dict(packet["study"]).cells[0].scenario))

    other = forged(packet, hostile)
    write_packet(tmp_path / "p.json", other)
    page = gate([read_packet(tmp_path / "p.json")], [read_packet(tmp_path / "p.json")]).as_markdown()
    cli.main(["verify", str(tmp_path / "p.json"), "--seeds", "1", "--jobs", "1"])
    cli.main(["report", str(tmp_path / "p.json"), str(tmp_path / "p.json"), "--fail-if-worse"])
    said = page + capsys.readouterr().out
    assert "\x1b" not in said
    assert "<script>" not in page
    assert "a](java" not in page
    assert "|[a]" not in page
    row = gate([packet_like([1.0])], [packet_like([2.0])]).rows[0]
    assert "<b>" not in Gate((replace(row, filter_name="<b>\x1b|"),), ("<b>\x1b is missing",)).as_markdown()


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


def test_the_gate_shows_what_the_tables_of_bench_show():
    """Root mean square of errors over recordings, where the median orders these two the other way round."""
    steady, astray = packet_like([1.0, 1.0, 1.0]), packet_like([0.9, 0.9, 4.0])
    (row,) = (row for row in gate([steady], [astray]).rows if row.measure.startswith("position error"))
    assert row.before == pytest.approx(1.0)
    assert row.after == pytest.approx(np.sqrt((2 * 0.81 + 16.0) / 3))
    assert "root mean square" in gate([steady], [astray]).as_markdown()


def test_every_measure_of_the_gate_is_combined_as_in_the_summary(packet, run):
    figures = json.loads((run / "summary.json").read_text())["filters"]["shared-anchor"]
    rows = {row.measure: row for row in gate([packet], [packet]).rows}
    for measure in GATED:
        assert rows[measure.title].before == pytest.approx(measure.of(figures), rel=1e-5)


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
    assert cli.main(["report", str(path), str(run), "--fail-if-worse", "--markdown", str(tmp_path / "gate.md")]) == 0
    assert (tmp_path / "gate.md").read_text().startswith("**Passed")
    assert cli.main(["report", str(path), str(worse), "--fail-if-worse"]) == 1
    assert cli.main(["report", str(path), str(tmp_path / "nothing"), "--fail-if-worse"]) == 2
    assert cli.main(["verify", str(worse), "--seeds", "1", "--jobs", "1", "--json"]) == 1
    assert '"agrees": false' in capsys.readouterr().out


def packet_like(errors):
    """A packet as far as a gate looks at it: a position error for each recording."""
    rest = {**dict.fromkeys(("rotation_rmse_deg", "pose_anees", "ms_per_frame")), "diverged": 0}
    rows = [{**rest, "recording": f"drive {k}", "seed": k, "position_rmse_m": e} for k, e in enumerate(errors)]
    return {"cells": [{"name": "one", "trials": {"mine": rows}}]}
