"""Rigs by name, as a camera and by numbers: from the function to the command line (10 s)."""

import copy
import json
import pickle
from dataclasses import asdict, replace

import gymnasium as gym
import numpy as np
import pytest

from stereo_slam_env.benchmark import Scenario, Study, preset_study
from stereo_slam_env.benchmark.campaign import check_study
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.benchmark.recordings.sources import StreetSource, source_of
from stereo_slam_env.benchmark.scenarios.streams import make_recording, stream_digest
from stereo_slam_env.benchmark.scenarios.study import study_from
from stereo_slam_env.cli import app as cli
from stereo_slam_env.cli.shared_options import rig_from
from stereo_slam_env.envs.recorder import record
from stereo_slam_env.sensing.rigs import RIGS, camera_of

VGA, QVGA = RIGS["vga"], RIGS["qvga"]
WIDE = replace(QVGA, baseline=1.2)
GRID = {"name": "s", "kind": "reference", "options": {"name": "short_turn"}, "frames": 3, "filters": ["inverse-depth"]}


# --- what is a rig ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rig", "camera"),
    [
        ("vga", VGA),
        (WIDE, WIDE),
        (asdict(WIDE), WIDE),
        ({"name": "qvga", "baseline": 1.2}, WIDE),
        ({"baseline": 0.2}, replace(RIGS["reference"], baseline=0.2)),
        ({"name": "vga"}, VGA),
        ({**asdict(WIDE), "fx": 230, "width": np.int64(320), "baseline": np.float64(1.2)}, WIDE),
    ],
    ids=str,
)
def test_a_name_a_camera_and_numbers_are_a_rig(rig, camera):
    made = camera_of(rig)
    assert made == camera
    assert [type(value) for value in asdict(made).values()] == [float] * 5 + [int] * 2


WRONG = [
    ("imax", r"rig must be one of 'reference', 'vga', .* or a calibration file \(.*\*\.yaml.*\), got 'imax'"),
    (7, r"rig must be one of 'reference', .*, a StereoCamera or a table of its numbers, got 7"),
    ("none.yaml", r"none\.yaml does not exist: give a calibration file"),
    ({"left": "l.yaml"}, "rig must have the files of both cameras, left and right"),
    ({"name": "imax", "baseline": 0.2}, r"rig\.name must be one of .*, got 'imax'"),
    ({"name": {}}, r"rig\.name must be one of .*, got \{\}"),
    ({"basline": 0.2}, "rig has no number 'basline', did you mean 'baseline'"),
    ({"baseline": 0.0}, r"rig\.baseline must be a number from 0\.001 to 10 m, got 0\.0"),
    ({"baseline": 571}, r"rig\.baseline must be a number from 0\.001 to 10 m, got 571"),
    ({"baseline": "0.2"}, r"rig\.baseline must be a finite number, got '0\.2'"),
    ({"baseline": True}, r"rig\.baseline must be a finite number, got True"),
    ({"fx": float("nan")}, r"rig\.fx must be a finite number, got nan"),
    ({"fx": 10**400}, r"rig\.fx must be a finite number, got 1000"),
    ({"width": 640.0}, r"rig\.width must be a whole number from 1 to 8192, px, got 640\.0"),
    ({"height": 1_000_000}, r"rig\.height must be a whole number from 1 to 8192, px, got 1000000"),
    ({"width": 640}, r"rig\.cx must be a number from 0 to 639 px, inside the image: give it with the size, got 672\.0"),
    (replace(VGA, baseline=50.0), r"rig\.baseline must be a number from 0\.001 to 10 m, got 50\.0"),
    ({"name": "vga", **asdict(VGA)}, "rig must not have a name beside all its numbers, got name 'vga': leave it out"),
]


@pytest.mark.parametrize(("rig", "complaint"), WRONG, ids=str)
def test_what_is_no_rig_is_refused_in_one_line(rig, complaint):
    with pytest.raises(ValueError, match=complaint) as error:
        camera_of(rig)
    assert "\n" not in str(error.value)


# --- environments ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "usual"), [("Drive", "reference"), ("Gaze", "vga"), ("DriveGaze", "vga")])
def test_numbers_that_are_not_given_are_those_of_the_usual_rig_of_the_environment(name, usual):
    with gym.make(f"StereoSlam/{name}-v0", rig={"baseline": 0.2}) as env:
        assert env.unwrapped.camera == replace(RIGS[usual], baseline=0.2)
        json.loads(env.spec.to_json())  # a table is JSON


def test_an_environment_with_a_rig_of_its_own_can_be_copied_and_made_again():
    env = gym.make("StereoSlam/Drive-v0", route="right-turn", rig={"name": "qvga", "baseline": 1.2}).unwrapped
    assert env.camera == WIDE
    stored = json.loads(json.dumps(env.options.as_dict()))
    assert stored["rig"] == asdict(WIDE)
    for again in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env), type(env)(**stored)):
        assert again.options == env.options
        assert again.observation_space == env.observation_space
        again.close()
    env.close()


def test_images_have_the_size_of_the_rig():
    numbers = {"fx": 80.0, "fy": 80.0, "cx": 59.5, "cy": 39.5, "baseline": 0.3, "width": 120, "height": 80}
    with gym.make("StereoSlam/Drive-v0", route="right-turn", rig=numbers, render_images=True) as env:
        observation, _ = env.reset(seed=0)
        assert observation["left"].shape == observation["right"].shape == (80, 120, 3)
        assert not np.array_equal(observation["left"], observation["right"])


def test_the_numbers_of_a_name_give_the_bits_of_the_name():
    digests = {stream_digest(record({"route": "right-turn", "rig": rig}, 3, 4)) for rig in ("vga", VGA, asdict(VGA))}
    assert len(digests) == 1
    digests = {stream_digest(short_turn(3, **given)) for given in ({}, {"rig": {}}, {"rig": "reference"})}
    assert len(digests) == 1


def test_a_recording_says_its_rig():
    assert record({"rig": WIDE}, 0, 2).source["arguments"]["rig"] == asdict(WIDE)
    assert record({"rig": "qvga"}, 0, 2).source["arguments"]["rig"] == "qvga"
    assert short_turn(0, rig={"name": "qvga", "baseline": 1.2}).source["rig"] == asdict(WIDE)


@pytest.mark.parametrize("kind", ["street", "reference"])
def test_disparity_grows_with_the_baseline(kind):
    def disparities(baseline):
        most = {"max_landmarks": 400, "route": "right-turn"} if kind == "street" else {"landmarks": 400}
        made = {"sigma": 1e-6, "rig": {"name": "vga", "baseline": baseline}, **most}
        seen = record(made, 0, 2) if kind == "street" else short_turn(0, frames=2, **made)
        assert seen.camera.baseline == baseline
        return dict(
            zip(seen.frames[0].observation.ids.tolist(), seen.frames[0].observation.uvd[:, 2].tolist(), strict=True)
        )

    narrow, wide = disparities(0.2), disparities(0.5)
    both = narrow.keys() & wide.keys()
    assert len(both) > 20
    np.testing.assert_allclose([wide[i] / narrow[i] for i in both], 2.5, rtol=1e-4)


# --- scenarios and grids ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", [WIDE, asdict(WIDE), {"name": "qvga", "baseline": 1.2}], ids=["camera", "all", "some"])
@pytest.mark.parametrize("options", [{"name": "short_turn"}, {"route": "right-turn"}], ids=["reference", "street"])
def test_a_scenario_takes_a_rig_and_survives_json(rig, options):
    source = source_of("reference" if "name" in options else "street", {**options, "rig": rig})
    scenario = Scenario("s", source, frames=2)
    again = Scenario.from_dict(json.loads(json.dumps(scenario.as_dict())))
    assert again == scenario
    assert make_recording(again, 0).camera == WIDE


@pytest.mark.parametrize("own", [{}, {"rig": "vga"}, {"rig": {"name": "vga"}}, {"rig": asdict(VGA)}], ids=str)
def test_the_baseline_is_a_factor_of_a_grid_whatever_the_rig(own):
    base = camera_of(own.get("rig", "reference"))
    options = {"name": "short_turn", **own}
    study = study_from({**GRID, "options": options, "grid": {"options.rig.baseline": [0.1, 0.8]}})
    check_study(study)
    assert [cell.name for cell in study.cells] == ["baseline-0.1", "baseline-0.8"]
    cameras = [make_recording(cell.scenario, 0).camera for cell in study.cells]
    assert cameras == [replace(base, baseline=0.1), replace(base, baseline=0.8)]


def test_whole_rigs_are_levels():
    rigs = ["qvga", {"name": "qvga", "baseline": 1.2}]
    study = study_from({**GRID, "grid": {"options.rig": rigs}})
    assert [make_recording(cell.scenario, 0).camera for cell in study.cells] == [QVGA, WIDE]


@pytest.mark.parametrize("kind", ["street", "reference", "gaze"])
def test_a_wrong_rig_is_refused_before_any_work(kind):
    options = {"rig": {"baseline": -1.0}} | ({"name": "short_turn"} if kind == "reference" else {})
    looks = {"policies": ["fixed"]} if kind == "gaze" else {}
    study = study_from({**GRID, "kind": kind, "options": options, **looks})
    for work in (lambda: check_study(study), lambda: gym.make("StereoSlam/Drive-v0", rig={"baseline": -1.0})):
        with pytest.raises(ValueError, match=r"rig\.baseline must be a number from 0\.001 to 10 m, got -1\.0"):
            work()


def test_a_problem_with_a_camera_of_its_own_takes_no_rig():
    study = study_from({**GRID, "options": {"name": "relative_noise_loop", "rig": "vga"}})
    with pytest.raises(ValueError, match="the problem relative_noise_loop has no option 'rig'"):
        check_study(study)


# --- the command line ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "rig"),
    [
        ("vga", "vga"),
        ("baseline=0.3,width=640", {"baseline": 0.3, "width": 640}),
        ("vga, baseline=1", {"name": "vga", "baseline": 1}),
        ("name=vga,fx=4.6e2", {"name": "vga", "fx": 460.0}),
        ('{"name": "vga", "baseline": 0.2}', {"name": "vga", "baseline": 0.2}),
        ("mine/calib.txt,baseline=0.2", {"name": "mine/calib.txt", "baseline": 0.2}),
    ],
)
def test_the_option_says_a_rig(text, rig):
    assert rig_from(text) == rig
    assert str(rig_from(text)) == str(rig)  # whole numbers stay whole


@pytest.mark.parametrize("text", ["baseline=", "baseline=wide", "vga,qvga", "baseline=1,baseline=2"])
def test_the_option_refuses_another_form(text):
    with pytest.raises(ValueError, match="--rig must"):
        rig_from(text)


@pytest.mark.parametrize(
    ("own", "given", "camera"),
    [
        ({}, "vga", VGA),
        ({"rig": asdict(WIDE)}, "vga", VGA),
        ({"rig": "qvga"}, {"baseline": 1.2}, WIDE),
        ({"rig": {**asdict(VGA), "baseline": 0.1}}, {"baseline": 0.571}, VGA),
        ({"rig": {"name": "vga", "baseline": 0.1}}, {"name": "qvga", "baseline": 1.2}, WIDE),
    ],
    ids=str,
)
def test_a_name_replaces_the_rig_of_a_scenario_and_numbers_change_it(own, given, camera):
    scenario = Scenario("s", StreetSource({"route": "right-turn", **own}))
    (cell,) = Study.of(scenario).with_settings({"options.rig": given}).cells
    assert camera_of(cell.scenario.source.options["rig"]) == camera
    assert cell.scenario.source.options["route"] == "right-turn"


def test_a_grid_over_the_baseline_stays_one_with_another_camera():
    study = preset_study("baseline")
    assert [
        camera_of(cell.scenario.source.options["rig"]) for cell in study.with_settings({"options.rig": "vga"}).cells
    ] == [replace(VGA, baseline=cell.factors["options.rig.baseline"]) for cell in study.cells]
    with pytest.raises(ValueError, match=r"options\.rig\.baseline must not be set: the grid of baseline varies it"):
        study.with_settings({"options.rig": {"baseline": 0.3}})


def test_a_grid_over_the_names_of_rigs_keeps_the_numbers_that_stand_or_are_given_beside_them():
    tables = {"name": "rigs", "kind": "street", "options": {"route": "right-turn", "rig": {"baseline": 0.2}}}
    study = study_from({**tables, "grid": {"options.rig.name": ["vga", "qvga"]}})

    def rigs(one):
        return [cell.scenario.source.options["rig"] for cell in one.cells]

    assert rigs(study) == [{"name": "vga", "baseline": 0.2}, {"name": "qvga", "baseline": 0.2}]
    assert rigs(study.with_settings({"options.rig": {"baseline": 0.3}})) == [
        {"name": "vga", "baseline": 0.3},
        {"name": "qvga", "baseline": 0.3},
    ]
    with pytest.raises(ValueError, match=r"options\.rig\.name must not be set: the grid of rigs varies it"):
        study.with_settings({"options.rig": "vga"})


def test_bench_takes_a_rig(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "stereo_slam_env.report.benchmark_report.write_report", lambda out, *_, **__: out / "report.html"
    )
    bench = ("bench", "--preset", "reference-turn", "--seeds", "1", "--frames", "4", "--filters", "inverse-depth")
    assert cli.main([*bench, "--jobs", "1", "--out", str(tmp_path / "run"), "--rig", "vga,baseline=0.2"]) == 0
    settings = json.loads((tmp_path / "run" / "settings.json").read_text())
    assert settings["scenario"]["options"]["rig"] == {"name": "vga", "baseline": 0.2}
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["recordings"][0]["source"]["rig"] == asdict(replace(VGA, baseline=0.2))
    capsys.readouterr()
    assert cli.main([*bench, "--out", str(tmp_path / "no"), "--rig", "baseline=0"]) == 2
    said = capsys.readouterr().err
    assert said == "error: rig.baseline must be a number from 0.001 to 10 m, got 0\n"
    real = tmp_path / "real.toml"
    real.write_text('name = "real"\nkind = "dataset"\noptions = { path = "x" }\n')
    assert cli.main(["bench", "--scenario", str(real), "--out", str(tmp_path / "no"), "--rig", "vga"]) == 2
    assert "--rig needs a simulated camera, got a scenario of kind 'dataset'" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()
