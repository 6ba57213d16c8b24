"""The long benchmarks in short: they run, and what they show holds in the small already."""

from __future__ import annotations

import importlib
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereo_slam_env.datasets.settings_files import Topics, settings_files
from stereo_slam_env.envs.recorder import RenderedDrive
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all
from stereo_slam_env.evaluation.trajectory_score import evaluate_trajectory
from stereo_slam_env.sensing.sensor_suite import SensorSuite

pytestmark = pytest.mark.slow

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


sys.path.insert(0, str(BENCHMARKS))  # as when one of them is run
script = importlib.import_module
soak = script("covariance_soak")


@pytest.mark.parametrize("name", sorted({path.stem for path in BENCHMARKS.glob("*.py")} - {"harness"}))
def test_every_benchmark_finds_what_it_imports(name: str) -> None:
    assert callable(script(name).main)


def test_filters_of_all_forms_are_timed_beside_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """20 landmarks, 6 frames; the benchmarks have up to 200, and 60."""
    beside_rivals, alone = script("rival_speed"), script("filter_speed")
    monkeypatch.setattr(beside_rivals, "WARM_UP", 2)
    seconds, entering = beside_rivals.measure(20, 4)
    assert entering > 0.0
    assert {"shared anchors", "6-D", "filterpy EKF, 6-D state"} <= set(seconds)
    monkeypatch.setattr(alone, "FILTERS", {name: alone.FILTERS[name] for name in (alone.SHARED, "one clone")})
    assert all(time > 0.0 for time in (*seconds.values(), *alone.measure(20, alone.BURST).values()))


@pytest.mark.parametrize("case", soak.CASES, ids=str)
def test_the_covariance_stays_a_covariance(case: soak.Case, monkeypatch: pytest.MonkeyPatch) -> None:
    """300 updates and five blind stretches; the benchmark has 100,000."""
    monkeypatch.setattr(soak, "LOOK_EVERY", 50)
    health, error, _ = soak.soak(case, 300)
    # Six numbers for each landmark repeat their anchor: singular by construction, on either side of zero.
    assert health.smallest_eigenvalue > (-1e-12 if case.landmark == "inverse-depth" else 1e-12)
    assert health.smallest_variance > 0
    assert health.asymmetry <= 1e-12
    assert health.failed == 0
    assert error < 0.2


def test_consensus_keeps_a_filter_consistent_under_heavy_tails_and_wrong_associations() -> None:
    """2 drives of 30 frames; the gate alone is overconfident several times over."""
    heavy_tails = script("heavy_tails")
    labels = ["gate", "consensus", "consensus + re-weighting"]
    by_seed = [heavy_tails.run_seed(seed, 30, heavy_tails.ASSUMED_SIGMA, labels) for seed in range(2)]
    runs = [run for of_seed in by_seed for run in of_seed]
    figures = dict(zip(labels, summarise_all(runs, figures_of(runs, divergence_percent=10.0)), strict=True))
    for label in labels[1:]:
        assert figures[label].diverged == 0
        assert figures[label].pose_anees / 6 < 1.5
    assert figures["gate"].pose_anees / 6 > 3.0


def test_files_of_a_filter_are_judged_as_true_as_the_filter_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """3 flights of 40 frames: mean NEES of 3 runs, with 99.99 % below 3.5, which a state of another sign exceeds."""
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    monte_carlo = script("foreign_monte_carlo")
    monkeypatch.setattr(sys, "argv", ["", "--out", str(tmp_path), "--seeds", "3", "--frames", "40", "--jobs", "1"])
    monte_carlo.main()
    told = capsys.readouterr().out
    assert told.count("3 runs together") == 3
    runs = [
        evaluate_trajectory(folder / "state_estimate.txt", folder / "mav0/state_groundtruth_estimate0/data.csv")
        for folder in sorted(tmp_path.iterdir())
    ]
    for name in ("pose", "velocity", "gyro-bias", "accelerometer-bias"):
        assert 0.2 < np.mean([run.claims[name].nees.mean / run.claims[name].dof for run in runs]) < 3.5


def test_a_filter_ends_where_smoothing_ends() -> None:
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    efficiency = script("efficiency")
    found = efficiency.run_seed(0, 60, "pixels", ["shared-anchor", efficiency.BATCH])
    batch, filtered = found[efficiency.BATCH], found["shared-anchor"]
    assert batch.chi2 == pytest.approx(1.0, abs=0.05)
    assert abs(batch.end - filtered.end) < 0.05
    assert batch.ate < filtered.ate


def test_sky_and_haze_cost_little_beside_the_bare_calls() -> None:
    """The median of 15 ratios; the benchmark has every size."""
    speed = script("rendering_speed")
    times = speed.measure("320x240", 50, 5, names=[speed.BARE, speed.TINY])
    assert np.median(np.divide(times[speed.TINY], times[speed.BARE])) < 1.25


def test_kills_lose_nothing() -> None:
    """Two kills; the benchmark has as many as one likes."""
    tally = script("kill_anywhere").disturb(kills=2, jobs=1)
    assert tally.kills == 2


def test_who_knows_how_the_car_accelerates_has_a_lower_bound_and_xyz_gives_most_away() -> None:
    """One drive of 20 frames."""
    efficiency = script("efficiency")
    filters = ["shared-anchor", "stacked", "dual-bearing", "euclidean"]
    found = efficiency.run_seed(0, 20, "pixels", filters)
    bound, as_driven = found[efficiency.BOUND], found[efficiency.AS_DRIVEN]
    assert as_driven.position < bound.position
    assert as_driven.rotation < bound.rotation
    assert max(filters, key=lambda label: found[label].anees) == "euclidean"


def test_rates_are_those_of_whole_episodes_beside_a_yardstick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One environment and four together; the benchmark has up to 256."""
    speed = script("environment_speed")
    kinds = {"CartPole": speed.KINDS["CartPole"], **{str(n): ("StereoSlam/Gaze-v0", n, {}) for n in (1, 4)}}
    monkeypatch.setattr(speed, "KINDS", kinds)
    one, four = speed.rates("Gaze", 1, time.process_time, (1, 2))
    assert [one[:2], four[:2]] == [["1", "1"], ["4", "4"]]
    assert one[3] == ""
    assert all(float(rate.replace(",", "")) > 0.0 for rate in (one[2], *four[2:4]))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("", {"seeds": 20, "only": ["a", "b"], "noise": "pixels", "quick": False, "options": {}, "images": None}),
        ("--seeds 3 --only b --noise uvd --quick", {"seeds": 3, "only": ["b"], "noise": "uvd", "quick": True}),
        ('--options {"gate":0.9} --images pictures', {"options": {"gate": 0.9}, "images": Path("pictures")}),
    ],
)
def test_an_argument_has_the_type_of_its_default(
    line: str, expected: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["script.py", "DATA", *line.split()])
    options = {"seeds": 20, "only": ["a", "b"], "noise": ("pixels", "uvd"), "quick": False, "options": {}}
    given = vars(script("harness").arguments("", "data", "more?", data=Path, more=Path, images=Path, **options))
    assert (given["data"], given["more"]) == (Path("DATA"), None)
    assert {name: given[name] for name in expected} == expected


def test_a_drive_through_files_is_the_drive_in_memory_and_its_covariance_is_true(tmp_path: Path) -> None:
    """80 small pairs: the mean NEES / 6 of a run lies in 0.3 to 2.5, files and memory differ by rounding."""
    written = script("written_drives")
    (nees, error, apart), *by_images = written.judged(0, tmp_path, "right-turn", 80, "qvga", "tiny")
    assert 0.3 < np.nanmean(nees) < 2.5
    assert error < 0.5
    assert apart < 1e-9
    assert max(apart for _, _, apart in by_images) < 1e-9
    score = evaluate_trajectory(
        tmp_path / "000" / written.ESTIMATE, tmp_path / "000/mav0/state_groundtruth_estimate0/data.csv"
    )
    assert score.position_rmse_m == pytest.approx(error, rel=0.05)  # of the body, a lever arm away
    assert score.claims["pose"].nees.mean / 6.0 == pytest.approx(np.nanmean(nees), rel=0.05)


def test_a_filter_and_an_environment_stay_sound_while_they_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """500 updates and 100 steps; the benchmark has 1,000,000 and 100,000."""
    long_run = script("soak")
    monkeypatch.setattr(long_run, "LOOKS", 10)
    of_filter, _ = long_run.soak_filter("shared-anchor", 500)
    assert of_filter.worst["quaternion_off_unit"] < 1e-12
    assert of_filter.worst["asymmetry"] < 1e-12
    assert of_filter.worst["lack_of_definiteness"] < 0.0
    of_env = long_run.soak_environment("StereoSlam/Drive-v0", {**long_run.CHEAP, "max_landmarks": 20}, 100)
    assert of_env.worst["quaternion_off_unit"] < 1e-12
    assert of_env.worst["outside_of_its_space"] == of_env.worst["not_finite"] == 0.0
    assert of_env.done == list(range(10, 101, 10))


def test_a_leak_and_a_slow_down_would_be_seen() -> None:
    """2 MB per 100,000 and a tenth slower at the end; NaN is the worst of all."""
    long_run = script("soak")
    done = list(range(1000, 101_000, 1000))
    log = long_run.Log(done, [80.0 + 2e-5 * k for k in done], [1.0] * 90 + [1.1] * 10)
    assert log.slope == pytest.approx(2.0)
    assert log.slower == pytest.approx(1.1)
    for value in (1.0, float("nan"), 2.0):
        log.note(anything=value)
    assert np.isnan(log.worst["anything"])


def test_the_same_corners_are_compared_with_every_blur() -> None:
    """16 frames of a small image; the benchmark has 8 drives of 60 frames of a large one."""
    image_blur = script("image_blur")
    drive = RenderedDrive({"route": "straight", "rig": "qvga"}, seed=0, frames=16)
    blocks = list(image_blur.displacements(drive.camera, drive.pairs(), drive.front_end, [0.0, 1.0]))
    assert len(blocks) == 2
    for without, matched in blocks:
        assert without.shape == matched.shape
        assert len(without) > 0
        assert 0.0 < np.abs(matched - without).max() < 2 * image_blur.OUTLIER
    mean, error, _ = image_blur.summary([matched for _, matched in blocks])
    everything = np.concatenate([matched for _, matched in blocks])
    np.testing.assert_allclose(mean, 1e3 * everything.mean(axis=0) / image_blur.LATER)
    assert np.all(error > 0.0)


def test_the_filter_of_the_gaze_tasks_does_not_stretch_the_way_and_one_that_relinearises_everything_does() -> None:
    """64 drives with a narrow baseline: the signed error ahead over its claim is within 4 over the root of 64."""
    relinearising = script("relinearising")

    def signed(options: dict[str, object]) -> float:
        errors, P = relinearising.ends("groves", 0.12, "fixed", options, 64, 910_000)
        return float(np.mean(errors[:, 2] / np.sqrt(P[:, 2, 2])))

    assert abs(signed({})) < 0.5
    assert signed(relinearising.UPDATES["two passes"]) < -0.5


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """A drive of 12 pairs in the layout of EuRoC, with its settings."""
    drive = RenderedDrive({"rig": "vga"}, frames=12)
    for name, text in settings_files(SensorSuite(drive.camera, 10.0), "street", Topics()).items():
        (tmp_path / "settings" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "settings" / name).write_text(text, encoding="utf-8")
    pairs = {round(1e9 * pair.timestamp): (pair.left, pair.right) for pair in drive.pairs()}
    for side, camera in enumerate(("cam0", "cam1")):
        images = tmp_path / "mav0" / camera / "data"
        images.mkdir(parents=True)
        rows = ["#timestamp [ns],filename", *(f"{ns},{ns}.png" for ns in pairs)]
        (images.parent / "data.csv").write_text("\n".join(rows), encoding="utf-8")
        for ns, both in pairs.items():
            cv2.imwrite(str(images / f"{ns}.png"), both[side])
    return tmp_path


def test_a_vocabulary_of_the_pictures_is_a_tree_of_descriptors(street: Path) -> None:
    run = script("orb_slam3_run")
    words = run.train_vocabulary([left for _, left, _ in run.pairs_of(street)][::4], street / "words.txt")
    head, *lines = (street / "words.txt").read_text().split("\n")
    nodes = [line.split() for line in lines]
    assert head == f"{run.BRANCHES} {run.LEVELS} 0 0"
    assert sum(node[1] == "1" for node in nodes) == words > 500
    assert {len(node) for node in nodes} == {35}
    leaves = {number for number, node in enumerate(nodes, 1) if node[1] == "1"}
    assert all(int(node[0]) < number and int(node[0]) not in leaves for number, node in enumerate(nodes, 1))
    assert min(float(node[34]) for node in nodes) > 0.0


def test_orb_slam3_takes_the_settings_and_follows_the_drive(street: Path) -> None:
    """12 pairs, in a process of its own."""
    pytest.importorskip("pyorbslam3", reason="needs pyorbslam3")
    line = [BENCHMARKS / "orb_slam3_run.py", street, street / "estimate.tum", "--vocabulary", "own"]
    subprocess.run([sys.executable, *map(str, line)], check=True, timeout=200)
    estimate = np.loadtxt(street / "estimate.tum")
    truth = np.array([pair.truth.position for pair in RenderedDrive({"rig": "vga"}, frames=12).pairs()])
    assert len(estimate) == 12
    assert np.linalg.norm(estimate[:, 1:4] - truth, axis=1).max() < 0.02 * np.linalg.norm(truth[-1])
