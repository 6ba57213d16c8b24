"""`stereo-slam paper`, from the command line to the page, on very little (20 s)."""

import csv
import json
from html import escape

import pytest

from stereo_slam_env.cli import app as cli
from stereo_slam_env.files import claimed_folder
from stereo_slam_env.paper import EXPERIMENTS, FIGURES, FULL, QUICK, PaperSettings, drives, run_paper
from stereo_slam_env.paper.paper_claims import (
    PLACES,
    REAL,
    RENDERED,
    SENTENCES,
    SIMULATION,
    Claim,
    ClaimFinding,
    Interval,
)
from stereo_slam_env.paper.report import contradictions

TINY = PaperSettings(
    **{"samples": 300, "turn_seeds": 1, "drive_seeds": 1, "drive_frames": 30, "rendered_turns": 1},
    **{"rendered_drives": 1, "sizes": (8, 12), "repeats": 2},
)
RENDERS = not drives.refusal_to_render()


@pytest.fixture(scope="module", autouse=True)
def without_gtsam():
    """Its drive would take most of the time; `test_drives` has a real one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drives, "_has_gtsam", lambda: False)
        yield


@pytest.fixture(scope="module")
def pages():
    """What the page said after each section."""
    return []


@pytest.fixture(scope="module")
def result(tmp_path_factory, pages):
    out = tmp_path_factory.mktemp("paper")

    def look(done, total):
        if (out / "report.html").exists():
            pages.append((out / "report.html").read_text())

    return run_paper(out, TINY, progress=look)


def test_everything_is_there(result):
    names = {path.name for path in result.out.iterdir() if not path.name.startswith(".")}
    files = {"paper.json", "paper_settings.json", "claims.csv", "claims.md", "report.html"}
    assert names == files | {"figures", "trials"}
    figures = {path.name for path in (result.out / "figures").iterdir()}
    for name in FIGURES:
        wanted = {f"figure-{name}.png"} if name == "3" else {f"figure-{name}.png", f"figure-{name}.svg"}
        assert wanted <= figures or (name == "3" and not RENDERS)


def test_the_page_shows_what_is_finished_while_the_rest_runs(result, pages):
    assert "Still running" in pages[0]
    assert '<figure id="figure-figure-1"' in pages[0]
    assert '<figure id="figure-figure-speed"' not in pages[0]
    sizes = [page.count("<figure ") for page in pages]
    assert sizes == sorted(sizes)


def test_claims_have_numbers_settings_and_versions(result):
    written = json.loads((result.out / "paper.json").read_text())
    assert written["settings"]["samples"] == 300
    assert written["versions"]["numpy"]
    keys = [claim["key"] for claim in written["claims"]]
    assert keys == list(SENTENCES)
    for claim in written["claims"]:
        assert claim["places"].keys() == PLACES.keys()
        assert claim["verdict"] in ("holds", "holds only if", "does not hold", "not shown")
        for finding in claim["findings"]:
            assert finding.keys() == {"place", "condition", "measured", "interval", "asked", "verdict"}


def test_rows_of_the_csv_are_the_findings(result):
    with (result.out / "claims.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == sum(len(claim.findings) for claim in result.claims)
    assert {row["place"] for row in rows} == {"simulation", RENDERED} if RENDERS else {"simulation"}


def test_the_page_has_every_claim_and_figure_and_says_how_to_get_the_recordings(result):
    page = result.report.read_text()
    assert page.count('<figure id="figure-') == len(FIGURES) - (not RENDERS)
    assert "Still running" not in page
    assert "Not judged on real drives" in page
    for claim in result.claims:
        assert escape(claim.sentence.claim) in page
    assert "www.cvlibs.net/datasets/karlsruhe_sequences" in page
    assert ">nan" not in page
    assert escape(TINY.remark) in page
    assert json.loads((result.out / "paper.json").read_text())["remark"] == TINY.remark


def test_the_page_names_what_is_refuted_outside_the_simulation():
    """Only with a finding on each side; what is undecided there is not called refuted."""
    sentence = SENTENCES["consistent"]

    def finding(place, value, spread, **condition):
        return ClaimFinding(condition, Interval(value, value - spread, value + spread), sentence.asked, place)

    held = finding(SIMULATION, 1.0, 0.05, noise="a")
    refuted, undecided = finding(REAL, 50.0, 20.0, drive="KITTI 00"), finding(REAL, 1.6, 1.0, drive="KITTI 07")
    said = contradictions([Claim(sentence, (held, refuted, undecided))])
    assert "KITTI 00 (50, asked: 0.8264 to 1.21)" in said
    assert "KITTI 07" not in said
    for findings in ((held, undecided), (refuted, undecided)):
        assert contradictions([Claim(sentence, findings)]) == ""


def test_a_run_that_is_smaller_than_the_full_one_says_so():
    assert FULL.remark == PaperSettings(drive_seeds=50).remark == ""
    assert "drive seeds 6 of 20" in QUICK.remark
    assert "turn seeds 3 of 200" in PaperSettings(turn_seeds=3).remark


def test_one_recording_shows_nothing_of_drives_in_general(result):
    judged = {claim.sentence.key: claim.verdict.value for claim in result.claims}
    assert judged["trajectory"] == judged["range-helps"] == "not shown"


def test_one_figure_runs_what_it_needs_and_has_its_sentences_alone(tmp_path):
    result = run_paper(tmp_path, TINY, figure="2")
    assert not list((tmp_path / EXPERIMENTS).iterdir())
    assert result.report.read_text().count("<figure ") == 1
    with pytest.raises(ValueError, match=r"figure must be one of 1, 2, .*, got '7'"):
        run_paper(tmp_path, TINY, figure="7")


@pytest.fixture
def quick_report(monkeypatch):
    """A page that costs no time; the whole one was written above."""
    monkeypatch.setattr("stereo_slam_env.paper.report.Page.write", lambda *_: None)


def test_the_same_call_computes_nothing_again(result, quick_report):
    kept = list((result.out / EXPERIMENTS).glob("*.npz"))
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
    monkeypatch.setattr("stereo_slam_env.paper.QUICK", TINY)
    monkeypatch.setenv("COLUMNS", "160")
    assert cli.main(["paper", "--quick", "--jobs", "1", "--out", str(result.out)]) == 0
    out = capsys.readouterr().out
    assert "holds" in out
    assert "Not judged on the Karlsruhe sequences" in out
    assert "Not judged on real drives: install the extra gtsam" in out
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
