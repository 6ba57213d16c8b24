"""`stereo-slam view`, as a user meets it (8 s)."""

import sys

import pytest

from stereo_slam_env.cli import app as cli


@pytest.fixture
def command(capsys, finished_run):
    """Run it on the finished run: exit code, stdout, stderr."""

    def run(*arguments):
        code = cli.main(["view", str(finished_run), *map(str, arguments)])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def test_a_still_and_a_film_need_no_extra(command, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    code, out, _ = command("--filter", "euclidean", "--still", tmp_path / "x.png", "--film", tmp_path / "x.mp4")
    assert code == 0
    assert "euclidean: short turn, seed 3, 8 frames" in out
    assert str(tmp_path / "x.png") in out
    assert (tmp_path / "x.png").stat().st_size > 20_000
    assert (tmp_path / "x.mp4").stat().st_size > 20_000


def test_a_file_for_rerun(command, tmp_path):
    pytest.importorskip("rerun", reason="needs the extra viewer")
    code, out, _ = command("--save", tmp_path / "x.rrd", "--seed", 4)
    assert code == 0
    assert "for Rerun: " in out
    assert (tmp_path / "x.rrd").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "stereo-slam-env[viewer]"),
        (("--filter", "foo", "--still", "x.png"), "filter must be one of inverse-depth, euclidean"),
        (("--frame", "2"), "--frame needs --still"),
        (("--still", "x.gif"), "must end in .png"),
        (("--film", "x.gif"), "must end in .mp4"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(command, arguments, message, monkeypatch):
    for module in ("rerun", "rerun.blueprint"):
        monkeypatch.setitem(sys.modules, module, None)
    code, _, err = command(*arguments)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
