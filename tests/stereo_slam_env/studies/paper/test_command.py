"""`stereo-slam paper`, from the command line to the page, on very little (20 s)."""

import csv
import json
from html import escape

import pytest

from stereo_slam_env.cli import app as cli
from stereo_slam_env.files import claimed_folder
from stereo_slam_env.studies.paper import EXPERIMENTS, FULL, QUICK, PaperSettings, run_paper

TINY = PaperSettings(samples=300, turn_seeds=1, drive_seeds=1, drive_frames=30, sizes=(8, 12), repeats=2)


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return run_paper(tmp_path_factory.mktemp("paper"), TINY)


def test_everything_is_there(result):
    names = {path.name for path in result.out.iterdir() if not path.name.startswith(".")}
    assert names == {"paper.json", "paper_settings.json", "claims.csv", "figures", "report.html", "trials"}
    figures = {path.name for path in (result.out / "figures").iterdir()}
    for stem in ("figure-1", "figure-2", "figure-4", "figure-5", "figure-6", "figure-nees", "figure-speed"):
        assert {f"{stem}.png", f"{stem}.svg"} <= figures


def test_claims_have_numbers_settings_and_versions(result):
    written = json.loads((result.out / "paper.json").read_text())
    assert written["settings"]["samples"] == 300
    assert written["versions"]["numpy"]
    keys = [claim["key"] for claim in written["claims"]]
    assert len(keys) == len(set(keys)) == 20
    for claim in written["claims"]:
        assert claim["verdict"] in ("holds", "holds only if", "does not hold", "not shown")
        for finding in claim["findings"]:
            assert finding.keys() == {"condition", "measured", "interval", "asked", "verdict"}


def test_rows_of_the_csv_are_the_findings(result):
    with (result.out / "claims.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == sum(len(claim.findings) for claim in result.claims)
    assert rows[0]["section"] == "4.1"


def test_the_page_has_every_claim_and_figure_and_says_how_to_get_the_recordings(result):
    page = result.report.read_text()
    assert page.count('<figure id="figure-') == 7
    for claim in result.claims:
        assert escape(claim.sentence.claim) in page
    assert "www.cvlibs.net/datasets/karlsruhe_sequences" in page
    assert ">nan" not in page
    assert escape(TINY.remark) in page
    assert json.loads((result.out / "paper.json").read_text())["remark"] == TINY.remark


def test_a_run_that_is_smaller_than_the_full_one_says_so():
    assert FULL.remark == PaperSettings(drive_seeds=50).remark == ""
    assert "drive seeds 6 of 20" in QUICK.remark
    assert "turn seeds 3 of 200" in PaperSettings(turn_seeds=3).remark


def test_one_recording_shows_nothing_of_drives_in_general(result):
    judged = {claim.sentence.key: claim.verdict.value for claim in result.claims}
    assert judged["trajectory"] == judged["smoother"] == "not shown"


@pytest.fixture
def quick_report(monkeypatch):
    """A page that costs no time; the whole one was written above."""
    monkeypatch.setattr("stereo_slam_env.studies.paper.report.write_report", lambda out, *_: out / "report.html")


def test_the_same_call_computes_nothing_again(result, quick_report):
    kept = [*(result.out / EXPERIMENTS).glob("*.npz"), *result.out.glob("trials/drives-30/cells/*/trials/*/*.npz")]
    written = {path: path.stat().st_mtime_ns for path in kept}
    told = []
    run_paper(result.out, TINY, progress=lambda done, total: told.append((done, total)))
    assert {path: path.stat().st_mtime_ns for path in kept} == written
    assert told[-1] == (len(kept),) * 2


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(ValueError, match="is not empty and holds no run of the paper"):
        run_paper(tmp_path, TINY)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_command_shows_verdicts_and_where_everything_is(result, quick_report, monkeypatch, capsys):
    monkeypatch.setattr("stereo_slam_env.studies.paper.QUICK", TINY)
    monkeypatch.setenv("COLUMNS", "160")
    assert cli.main(["paper", "--quick", "--jobs", "1", "--out", str(result.out)]) == 0
    out = capsys.readouterr().out
    assert "holds" in out
    assert "Not judged on the Karlsruhe sequences" in out
    assert str(result.report) in out


def test_a_wrong_folder_gets_one_line(tmp_path, capsys):
    assert cli.main(["paper", "--quick", "--karlsruhe", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error:")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_one_process_at_a_time_writes_into_the_folder(tmp_path):
    with claimed_folder(tmp_path / "paper"), pytest.raises(ValueError, match="is in use by another process"):
        run_paper(tmp_path / "paper", TINY)
