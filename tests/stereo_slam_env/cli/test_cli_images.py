"""The command on images, as a user meets it. About 15 s."""

import dataclasses
import json
import shutil

import cv2
import numpy as np
import pytest

from stereo_slam_env import datasets
from stereo_slam_env.benchmark.recordings import sources
from stereo_slam_env.cli import app as cli
from stereo_slam_env.envs.recorder import RenderedDrive
from stereo_slam_env.frontend import make_front_end

from ..datasets.small_image_folders import FRAMES, kitti_odometry
from ..rendering.planes import skip_where_missing

DRIVE = ("right-turn", "--rig", "qvga")
QUICK = ("--jobs", 1, "--filters", "inverse-depth")


@pytest.fixture(params=[80])
def command(request, capsys, monkeypatch, tmp_path):
    """Run the command in an empty folder, with a report that costs no time: exit code, stdout, stderr."""
    monkeypatch.setenv("COLUMNS", str(request.param))
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    sources._tracked.cache_clear()
    sources._opened.cache_clear()

    def write_report(out, *_, **__):
        (out / "report.html").write_text("a report")
        return out / "report.html"

    monkeypatch.setattr("stereo_slam_env.report.benchmark_report.write_report", write_report)

    def run(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture
def street(tmp_path):
    """A short scenario of the simulated street."""
    options = {"route": "right-turn", "rig": "qvga", "max_landmarks": 40}
    noise = {"independent_pixels": 1.0}
    data = {"kind": "street", "name": "short", "options": options, "frames": 3, "noise": noise, "gate": None}
    (tmp_path / "short.json").write_text(json.dumps(data))
    return tmp_path / "short.json"


@pytest.fixture
def folder(tmp_path):
    kitti_odometry(tmp_path / "kitti")
    return tmp_path / "kitti"


def pictures(path):
    film = cv2.VideoCapture(str(path))
    count = int(film.get(cv2.CAP_PROP_FRAME_COUNT))
    film.release()
    return count


def stored(out):
    return json.loads((out / "settings.json").read_text())["scenario"]


def refused(result, hint):
    code, _, err = result
    assert code == 2, err
    (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
    assert hint in line
    assert "Traceback" not in err
    return True


# --- bench -----------------------------------------------------------------------------------------------------------


def test_bench_on_images(command, street, tmp_path):
    code, out, err = command("bench", "--scenario", street, "--sensor", "images", *QUICK, "--out", tmp_path / "run")
    assert code == 0, err
    for said in ("short-tiny-images", "as each measurement says", "0.99 per landmark", "the same for all filters"):
        assert said in out
    scenario = stored(tmp_path / "run")
    assert (scenario["options"]["sensor"], scenario["options"]["renderer"]) == ("images", "tiny")
    assert (scenario["noise"], scenario["search"], scenario["consensus"]) == (None, "flow", True)
    (recording,) = json.loads((tmp_path / "run" / "summary.json").read_text())["recordings"]
    assert recording["source"]["renderer"]["name"] == "tiny"


def test_bench_with_a_guided_search_and_a_film_of_it(command, street, tmp_path):
    guided = ("--sensor", "images", "--set", "search=forecast", "--set", "gate=none", "--frames", 2)
    code, out, err = command(
        "bench", "--scenario", street, *guided, *QUICK, "--record", "film.mp4", "--out", tmp_path / "run"
    )
    assert code == 0, err
    assert "guided by each filter" in out
    assert "film.mp4" in out
    assert pictures("film.mp4") == 2
    scenario = stored(tmp_path / "run")
    assert (scenario["search"], scenario["gate"], scenario["consensus"]) == ("forecast", None, False)


def test_bench_with_gl(command, street, tmp_path):
    skip_where_missing("gl")
    images = ("--sensor", "images", "--renderer", "gl")
    code, _, err = command("bench", "--scenario", street, *images, *QUICK, "--out", tmp_path / "run")
    assert code == 0, err
    assert stored(tmp_path / "run")["options"]["renderer"] == "gl"
    other = command("bench", "--scenario", street, "--sensor", "images", *QUICK, "--out", tmp_path / "run")
    assert refused(other, 'holds a run with options.renderer = "gl", now it is "tiny"')


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        (("--sensor", "foo"), "--sensor must be one of landmarks, images, got 'foo'"),
        (("--sensor", "images", "--renderer", "foo"), "--renderer must be one of tiny, gl, got 'foo'"),
        (("--renderer", "gl"), "--renderer needs --sensor images"),
        (("--sensor", "images", "--set", "search=foo"), "search must be one of flow, forecast, got 'foo'"),
        (("--set", "search=forecast"), "search 'forecast' needs images"),
        (
            ("--sensor", "images", "--set", "noise.independent_pixels=2"),
            "must not assume a noise: in images each measurement",
        ),
        (("--sensor", "images", "--frames", "81"), "frames must be at most 80 on route 'right-turn', got 81"),
        (("--sensor", "images", "--record", "film.avi"), "film.avi must end in .mp4"),
        (("--sensor", "images", "--record", "nowhere/film.mp4"), "the folder nowhere does not exist"),
        (("--record", "film.mp4"), "has no images"),
        (("--sensor", "images", "--record", "film.mp4", "--filters", "inverse-dept"), "did you mean 'inverse-depth'"),
    ],
)
def test_wrong_options_of_bench_are_refused_before_any_work(command, street, tmp_path, monkeypatch, options, hint):
    monkeypatch.setattr("stereo_slam_env.world.physics.PhysicsWorld.build", lambda *_: pytest.fail("work was done"))
    assert refused(command("bench", "--scenario", street, *options, "--jobs", 1, "--out", tmp_path / "run"), hint)
    assert not (tmp_path / "run" / "trials").exists()
    assert list((tmp_path / "work").iterdir()) == []


def test_pure_geometry_has_no_images(command):
    assert refused(command("bench", "--preset", "reference-turn", "--sensor", "images"), "of kind 'street'")


def test_a_used_folder_is_refused_before_any_work(command, street, tmp_path, monkeypatch):
    monkeypatch.setattr("stereo_slam_env.world.physics.PhysicsWorld.build", lambda *_: pytest.fail("work was done"))
    images = ("bench", "--scenario", street, "--sensor", "images")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("years of work")
    thesis = ("--record", "film.mp4", "--out", tmp_path / "thesis")
    assert refused(command(*images, *thesis), "is not empty and holds no run")


def test_a_missing_gl_gets_one_line_from_every_command(command, street, missing_gl):
    for arguments in (
        ("bench", "--scenario", street, "--sensor", "images"),
        ("scenes", "render", *DRIVE, "--out", "x.png"),
        ("scenes", "record", *DRIVE, "--out", "x"),
        ("scenes", "noise", *DRIVE),
    ):
        assert refused(command(*arguments, "--renderer", "gl"), missing_gl)


# --- replay ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [80, 120], indirect=True)
def test_replay_of_images_says_what_was_read(command, folder, tmp_path):
    code, out, err = command("replay", folder, *QUICK, "--out", tmp_path / "run")
    assert code == 0, err
    assert f"kitti_odometry_07: {FRAMES} frames" in out
    assert "front end  disparity_offset_sigma = 0.25\n" in out  # six pairs say nothing of it
    assert "an R for each measurement" in out
    assert "min_score" not in out
    front_end = json.loads((tmp_path / "run" / "summary.json").read_text())["recordings"][0]["source"]["front_end"]
    assert front_end["min_score"] == 0.8


def test_replay_of_some_frames_with_a_film(command, folder, tmp_path):
    options = ("--frames", 4, "--set", "search=forecast", "--record", "film.mp4")
    code, out, err = command("replay", folder, *options, *QUICK, "--out", tmp_path / "run")
    assert code == 0, err
    assert "4 frames" in out
    assert pictures("film.mp4") == 4
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["filters"]["inverse-depth"]["frames"] == 3


def test_replay_in_the_folder_itself_has_a_name(command, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    assert command("replay", ".", *QUICK, "--frames", 2, "--out", tmp_path / "run")[0] == 0
    assert stored(tmp_path / "run")["name"] == "replay-kitti"


def test_the_report_of_a_replay_outlives_the_recording(command, folder, tmp_path):
    command("replay", folder, *QUICK, "--frames", 3, "--out", tmp_path / "run")
    shutil.rmtree(folder)
    code, out, _ = command("report", tmp_path / "run")
    assert code == 0
    assert "inverse-depth" in out


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        (("--record", "film.avi"), "must end in .mp4"),
        (("--record", "nowhere/film.mp4"), "the folder nowhere does not exist"),
        (("--filters", "inverse-dept"), "did you mean 'inverse-depth'"),
        (("--set", "search=foo"), "search must be one of"),
        (("--set", "noise.independent_pixels=2"), "each measurement comes with its own covariance"),
        (("--set", "gate=none", "--set", "consensus=true"), "consensus needs a gate"),
    ],
)
def test_wrong_options_of_replay_are_refused_before_any_work(command, folder, tmp_path, monkeypatch, options, hint):
    monkeypatch.setattr(datasets, "open_for_front_end", lambda *_, **__: pytest.fail("work was done"))
    assert refused(command("replay", folder, *options, "--out", tmp_path / "run"), hint)
    assert not (tmp_path / "run").exists()


def test_a_missing_right_image_is_named(command, folder, tmp_path):
    (folder / "sequences" / "07" / "image_1" / "000003.png").unlink()
    assert refused(command("replay", folder, *QUICK, "--out", tmp_path / "run"), "image_1 has no image")
    assert not (tmp_path / "run").exists()


# --- scenes ----------------------------------------------------------------------------------------------------------


def test_what_scenes_record_wrote_can_be_replayed(command, tmp_path):
    code, out, err = command("scenes", "record", *DRIVE, "--frames", 5, "--seed", 1, "--out", tmp_path / "mine")
    assert code == 0, err
    assert out.strip() == str(tmp_path / "mine" / "sequences" / "00")
    code, out, err = command("replay", tmp_path / "mine", *QUICK, "--out", tmp_path / "run")
    assert code == 0, err
    assert "5 with a reference pose" in out
    error = json.loads((tmp_path / "run" / "summary.json").read_text())["filters"]["inverse-depth"]["position_rmse_m"]
    assert error < 0.1
    again = command("scenes", "record", *DRIVE, "--frames", 5, "--out", tmp_path / "mine")
    assert refused(again, "sequences/00 is not empty: choose another name or folder")


def test_the_noise_of_a_scene_is_a_table_that_fits(command):
    code, out, err = command("scenes", "noise", *DRIVE, "--frames", 3)
    assert code == 0, err
    assert max(map(len, out.splitlines())) <= 80
    (everything,) = [line.split() for line in out.splitlines() if line.startswith(" all") or line.startswith("all")]
    count, coordinate, *figures, outliers = everything[1:]
    assert (int(count) > 20, coordinate, outliers[-1]) == (True, "u", "%")
    assert len(figures) == 5
    assert np.isfinite([float(figure) for figure in figures]).all()


@pytest.fixture
def klt_tracks(tmp_path):
    """What `klt` measures in rendered pairs, as a program that has only the pictures would write it."""
    drive = RenderedDrive({"route": "right-turn", "rig": "qvga"}, seed=1, frames=4)
    front_end = make_front_end(drive.camera, dataclasses.replace(drive.front_end, method="klt"))
    rows = []
    for number, pair in enumerate(drive.pairs()):
        tracked = front_end.track(pair.left, pair.right, 0.1 if number else None)
        for landmark, uvd, R in zip(tracked.ids, tracked.uvd, tracked.R, strict=True):
            rows.append(" ".join(repr(float(x)) for x in (number, landmark, *uvd, *R[np.triu_indices(3)])))
    (tmp_path / "tracks.txt").write_text("\n".join(rows))
    return tmp_path / "tracks.txt"


def test_tracks_of_another_program_are_judged_as_ours_to_the_last_digit(command, klt_tracks):
    ours = command("scenes", "noise", *DRIVE, "--frames", 4, "--seed", 1, "--front-end", "klt")
    theirs = command("scenes", "noise", *DRIVE, "--seed", 1, "--tracks", klt_tracks)
    assert (ours[0], theirs[0]) == (0, 0), theirs[2]
    assert theirs[1] == ours[1]
    figures = json.loads(command("scenes", "noise", *DRIVE, "--seed", 1, "--tracks", klt_tracks, "--json")[1])
    assert figures["measurements"] == len(klt_tracks.read_text().splitlines())
    assert figures["remarks"]
    assert f" {figures['ranges'][-1]['sigma'][0]:.3f} " in ours[1]


def test_tracks_of_another_seed_are_doubted(command, klt_tracks):
    code, out, err = command(
        "scenes", "noise", *DRIVE, "--seed", 2, "--surroundings", "corridor", "--tracks", klt_tracks
    )
    assert code == 0, err
    assert "are these tracks of this scene and seed? the median error of d is" in " ".join(out.split())


def test_a_disparity_image_is_measured_without_tracks_and_claims(command, tmp_path):
    """OpenCV's semi-global matching at corners: each is a match by itself, so only d has an error."""
    rows = []
    for number, pair in enumerate(RenderedDrive({"route": "right-turn", "rig": "qvga"}, seed=1, frames=2).pairs()):
        disparity = cv2.StereoSGBM_create(0, 64, 5).compute(pair.left, pair.right) / 16.0
        for u, v in cv2.goodFeaturesToTrack(pair.left, 300, 0.01, 5)[:, 0]:
            if (d := disparity[round(v), round(u)]) > 0:
                rows.append(f"{number},{len(rows)},{u},{v},{d}")
    (tmp_path / "sgbm.csv").write_text("\n".join(rows))
    code, out, err = command("scenes", "noise", *DRIVE, "--seed", 1, "--tracks", tmp_path / "sgbm.csv", "--json")
    assert code == 0, err
    everything = json.loads(out)["ranges"][-1]
    assert everything["count"] > 50
    assert everything["sigma"][:2] == [None, None]
    assert everything["sigma"][2] < 0.5
    assert abs(everything["bias"][2]) < 0.25
    assert everything["claimed"] == [None, None, None]


def test_tracks_that_cannot_be_of_the_drive_are_refused(command, tmp_path):
    def refusal(text, *options):
        (tmp_path / "t.txt").write_text(text)
        return command("scenes", "noise", *DRIVE, "--tracks", tmp_path / "t.txt", *options)

    assert refused(
        refusal("0 1 9 9 3\n5 1 9 9 3\n", "--frames", 5), "a measurement in frame 5, but the drive has frames 0 to 4"
    )
    assert refused(refusal("0 1 400 9 3\n"), "u of id 1 in frame 0 is 400, outside the image of 320x240 px")
    assert refused(refusal("0 1 9 9 3\n", "--front-end", "klt"), "leave --front-end out")
    assert refused(refusal("0 1 9 9\n"), "has 4 columns")


def test_scenes_render_draws_with_the_options_given(command, tmp_path):
    code, _, err = command("scenes", "render", *DRIVE, "--surroundings", "field", "--out", tmp_path / "field.png")
    assert code == 0, err
    assert cv2.imread(str(tmp_path / "field.png")).shape == (260, 644, 3)


def test_scenes_list_names_everything_that_can_be_asked_for(command):
    out = command("scenes", "list")[1]
    for name in ("right-turn", "corridor", "field", "tiny", "gl", "reference-drive"):
        assert f"  {name} " in out


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (("render", "right-turn", "--surroundings", "foo", "--out", "x.png"), "surroundings must be one of"),
        (("render", "right-turn", "--renderer", "foo", "--out", "x.png"), "renderer must be one of"),
        (("render", *DRIVE, "--frame", "-1", "--out", "x.png"), "--frame"),
        (("record", "twon", "--out", "x"), "'town'"),
        (("record", *DRIVE, "--frames", "81", "--out", "x"), "frames must be from 1 to 80"),
        (("record", *DRIVE, "--name", "a/b", "--frames", "2", "--out", "x"), "name must be a plain folder name"),
        (("noise", *DRIVE, "--frames", "81"), "frames must be at most 80"),
        (("noise", "right-turn", "--rig", "imax"), "rig must be one of"),
        (("noise", *DRIVE, "--moving-cars", "1000"), "moving_cars must be a whole number from 0 to 100"),
    ],
)
def test_wrong_use_of_scenes_gets_one_line(command, tmp_path, arguments, hint):
    assert refused(command("scenes", *arguments), hint)
    assert list((tmp_path / "work").iterdir()) == []
