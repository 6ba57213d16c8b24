"""What the pages of the manual take from their readers (`GIVEN`), and what must come out of their code (`SHOWS`)."""

import re
import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from filters import make_filter
from stereo_slam_env.benchmark import run_benchmark
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive, short_turn
from stereo_slam_env.benchmark.scenarios.study import study_from
from stereo_slam_env.datasets import open_image_sequence, write_recording
from stereo_slam_env.datasets.written_frame import KINDS
from stereo_slam_env.envs.recorder import RenderedDrive
from stereo_slam_env.evaluation import run_filter
from stereo_slam_env.rendering.renderers import make_renderer
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.routes import named_route
from stereo_slam_env.world.surroundings import build_scene

from ..stereo_slam_env.rendering.planes import AHEAD, skip_where_missing
from ..synthetic_runs import scored


def given_baselines():
    pytest.importorskip("gtsam", reason="needs the extra gtsam")
    recording = short_turn(0, landmarks=20)
    frames = iter(recording.frames)

    def make_and_drive(name, **how):
        """The drive that the page leaves to its reader."""
        slam = make_filter(name, **how)
        slam.reset(recording.start)
        slam.update(next(frames).observation)
        for frame in frames:
            slam.predict(0.1)
            slam.update(frame.observation)
        return slam

    return {"make_filter": make_and_drive, "camera": recording.camera, "noise": recording.noise}


def given_benchmark():
    pytest.importorskip("polars", reason="needs polars and pandas (extra dev)")
    run_benchmark("reference-turn", "runs/before", seeds=[0, 1])
    return {}


def given_environment():
    skip_where_missing("gl")
    return {"recording": short_turn(0)}


def given_front_end():
    drive = RenderedDrive({"route": "straight", "rig": "qvga"}, seed=0, frames=12)
    write_recording(drive, "PATH/kitti06_stereo51", "kitti", name="00", may_lose=KINDS)
    return {}


def given_your_data():
    drive = RenderedDrive({"route": "straight", "rig": "qvga"}, seed=0, frames=4)
    write_recording(drive, "PATH/dataset", "kitti", name="06", may_lose=KINDS)
    return {}


def given_rendering():
    skip_where_missing("gl")
    scene = build_scene("street", named_route("straight"), np.random.default_rng(0))
    names = {"WorldFrame": WorldFrame, "make_renderer": make_renderer}
    return {**names, "scene": scene, "camera": RIGS["qvga"], "pose": AHEAD}


def given_statistics():
    crossed = {"filter": "inverse-depth", "measurement": ["joint", "left"], "error": ["quaternion", "so3"]}
    study = study_from(
        {"name": "crossed", "kind": "reference", "options": {"name": "short_turn"}, "factorial": crossed}
    )
    choices = {choice.label: (choice.name, choice.options) for choice in study.cells[0].scenario.filters}
    choices |= {"inverse-depth": ("inverse-depth", {}), "euclidean": ("euclidean", {"min_disparity": 4.0})}
    runs = [
        run_filter(long_drive(seed, frames=50, landmarks=20), name, options, label=label, seed=seed)
        for seed in range(10)
        for label, (name, options) in choices.items()
    ]
    for which in ("before", "after"):
        run_benchmark("reference-turn", f"runs/{which}", seeds=[0, 1], filters=["inverse-depth"])
    summaries, figures = scored(runs)
    cell = SimpleNamespace(runs=runs, summaries=summaries, figures=figures)
    return {"study": study, "result": SimpleNamespace(runs=runs, cells=[cell])}


GIVEN = {
    "docs/baselines.md": given_baselines,
    "docs/benchmark.md": given_benchmark,
    "docs/environment.md": given_environment,
    "docs/front_end.md": given_front_end,
    "docs/rendering.md": given_rendering,
    "docs/statistics.md": given_statistics,
    "docs/your_data.md": given_your_data,
}
"""Names (and files in the current folder) that a page takes from its reader."""


def shows_readme(names, printed):
    assert np.nanmean([moment.nees for moment in names["sse"].run("inverse-depth", names["recording"])]) < 30.0
    assert names["evaluation"].figures.position_rmse_m < 0.5
    assert {summary.filter_name for summary in names["comparison"].summaries} == {"inverse-depth", "dual-bearing"}
    names["env"].reset(seed=0)
    assert np.isfinite(names["env"].step(names["env"].action_space.sample())[1])


def shows_active_perception(names, printed):
    assert "20 None" in printed  # frames, no failure
    assert np.isfinite(names["reward"]).all()


def shows_baselines(names, printed):
    smoothed = names["smoothed"]
    assert 0.7 < smoothed.chi_square / smoothed.degrees_of_freedom < 1.3


def shows_benchmark(names, printed):
    assert "Nothing has changed but perhaps the time." in printed  # the same filters on the same recordings
    assert len(names["trials"]) == 2 * len(names["result"].summaries)


def shows_correct(names, printed):
    told = names["told"]
    assert printed.startswith("False ")  # refused
    assert (told.used, told.nis_dof) == (False, 3)
    assert told.nis > 50.0


def shows_environment(names, printed):
    as_it_was, worse = names["recording"].frames, names["worse"].frames
    moved = [not np.array_equal(a.observation.uvd, b.observation.uvd) for a, b in zip(as_it_was, worse, strict=True)]
    assert all(moved[1:])
    assert len(names["drive"]) == 30
    assert names["pair"].left.std() > 10.0  # grey levels: there is something in the picture


def shows_faults(names, printed):
    assert printed.startswith("innovations larger than claimed | ")


def shows_front_end(names, printed):
    run = names["run"]
    assert np.linalg.norm(run.positions[-1] - run.true_positions[-1]) < 0.3
    assert len(names["tracked"].observation.ids) > 20
    (*_, last) = names["drive"].pairs()
    assert np.linalg.norm(names["slam"].pose.position - last.truth.position) < 0.3


def shows_nees(names, printed):
    assert names["low"] < names["mean"] < names["high"]


def shows_evaluate(names, printed):
    position, nees, verdict = printed.split(maxsplit=2)
    assert 0.0 < float(position) < 0.2
    assert 0.2 < float(nees) < 2.4
    assert verdict.strip() == "consistent, as far as one run can tell"


def shows_claim(names, printed):
    seconds, value = printed.split()
    assert seconds == "1.0"
    assert 0.05 < float(value) < 5.0  # one window of a short drive


def shows_vector(names, printed):
    assert printed.split("\n")[0] == "(16, 12, 6) (16, 3)"
    assert tuple(names["envs"].single_observation_space) == ("belief_sigmas", "head", "panorama")
    assert names["learner_env"].num_envs == 16


def shows_msckf(names, printed):
    assert names["plain"].clones == ()  # before the first frame
    assert [slam.camera for slam in (names["hybrid"], names["inertial"], names["monocular"])] == 3 * [names["camera"]]


def shows_covariances(names, printed):
    median = float(printed.rsplit(maxsplit=1)[1])
    assert 0.3 < median < 2.0  # one drive; errors are white and independent here
    assert median == pytest.approx(np.median(names["ratios"]), abs=0.005)


def shows_policies(names, printed):
    assert float(printed) < 0.65  # m; a fixed gaze has 0.69 on average, greedy 0.43


def shows_index(names, printed):
    numbers = np.array([float(found) for found in re.findall(r"-?[0-9][-+.e0-9]*", printed)])
    position, sigma, used, (nis, dof) = np.split(numbers[:11], [3, 6, 9])
    assert np.abs((position - [0.0, 0.0, 0.5]) / sigma).max() < 3.0
    assert used.tolist() == [0, 1, 2]
    assert chi2(dof).ppf(0.01) < nis < chi2(dof).ppf(0.99)
    error, covariance = names["error"], names["covariance"]
    assert np.linalg.norm(error[:3]) < 0.5
    assert error @ np.linalg.solve(covariance, error) < chi2(6).ppf(0.999)


def shows_rendering(names, printed):
    images = names["images"]
    assert images.left.std() > 10.0
    assert not np.array_equal(images.left, images.right)
    assert np.isfinite(images.depth).mean() > 0.3


def shows_scenes(names, printed):
    assert len(names["scene"].moving) > 10
    assert len(names["scene"].landmark_points) > 500


def shows_statistics(names, printed):
    assert names["verdict"].best in names["verdict"].headline
    assert "consistent" in names["verdict"].answers
    difference = names["table"].cells["position_rmse_m", "euclidean", "inverse-depth"]
    assert difference.count == 10
    low, high = difference.interval_percent
    assert low < difference.percent < high
    assert "measurement: 'left' instead of 'joint' makes it" in names["attribution"].conclusion


def shows_report(names, printed):
    page = names["out"] / "mine.html"
    assert "Errors of one drive." in page.read_text()
    assert {path.name for path in (names["out"] / "figures").iterdir()} == {"errors.png", "errors.svg"}


def shows_view(names, printed):
    assert Path("drive.png").stat().st_size > 20_000


def shows_wrappers(names, printed):
    assert np.isfinite(names["reward"])
    assert len(names["slam"].landmarks.ids) > 10


def shows_write_a_filter(names, printed):
    for name in ("Blind", "MyFilter"):
        assert re.search(rf"^{name}: .* checks passed, 0 failed$", printed, re.MULTILINE)
    table = printed[printed.index("MyFilter is\n") :]
    assert "\nposition error, m " in table
    assert ("worse: " in table) or ("better: " in table)
    assert "0 of 10   0 of 10" in table


def shows_write_a_part(names, printed):
    for part in ("InverseVector", "LooseCentre", "Coasting"):
        found = rf"^{part}: . checks passed, 0 failed; runs in machine code, with Jacobians by dual numbers$"
        assert re.search(found, printed, re.MULTILINE)
    assert re.search("^mine: .* checks passed, 0 failed$", printed, re.MULTILINE)
    figures = {summary.filter_name: summary for summary in names["comparison"].summaries}
    assert figures["mine"].position_rmse_m < 2.0 * figures["inverse-depth"].position_rmse_m


def shows_your_data(names, printed):
    written = open_image_sequence("out/sequences/00")
    assert len(written) == 4
    for one, again in zip(names["sequence"].pairs(), written.pairs(), strict=True):
        assert np.array_equal(one.left, again.left)
    run = names["run"]
    assert np.linalg.norm(run.positions[-1] - [0.0, 0.0, 0.87]) < 0.02
    assert 0.8 < np.nansum(run.nis) / run.nis_dof.sum() < 1.2
    assert Path("mine.npz").exists()


def shows_inertial(names, out):
    """Forces that cancel gravity for a tenth of a second leave the filter where it was."""
    slam = names["slam"]
    told, error = out.splitlines()
    assert told == f"{slam.belief('imu-bias').value} {slam.belief('gravity').value}"
    assert 0.0 < float(error) < 0.1  # m, over 24 m of a simulated drive
    np.testing.assert_allclose(slam.belief("imu-bias").value, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(slam.belief("gravity").value), 9.81, atol=0.01)
    np.testing.assert_allclose(slam.pose.position, 0.0, atol=1e-3)


def shows_moving_bodies(names, printed):
    belief = names["last"].slam.bodies
    assert printed.count("body-") == len(belief) >= 1
    np.testing.assert_allclose(names["later"].positions, belief.positions + belief.linear, atol=0.5)


SHOWS = {
    "README.md": shows_readme,
    "docs/active_perception.md": shows_active_perception,
    "docs/baselines.md": shows_baselines,
    "docs/benchmark.md": shows_benchmark,
    "docs/correct.md": shows_correct,
    "docs/covariances.md": shows_covariances,
    "docs/environment.md": shows_environment,
    "docs/evaluate.md": shows_evaluate,
    "docs/claim.md": shows_claim,
    "docs/faults.md": shows_faults,
    "docs/filters/inertial.md": shows_inertial,
    "docs/filters/moving_bodies.md": shows_moving_bodies,
    "docs/filters/msckf.md": shows_msckf,
    "docs/front_end.md": shows_front_end,
    "docs/index.md": shows_index,
    "docs/nees.md": shows_nees,
    "docs/policies.md": shows_policies,
    "docs/rendering.md": shows_rendering,
    "docs/report.md": shows_report,
    "docs/scenes.md": shows_scenes,
    "docs/statistics.md": shows_statistics,
    "docs/view.md": shows_view,
    "docs/wrappers.md": shows_wrappers,
    "docs/write_a_filter.md": shows_write_a_filter,
    "docs/write_a_part.md": shows_write_a_part,
    "docs/your_data.md": shows_your_data,
    "docs/vector.md": shows_vector,
}
"""Called with the names that a page leaves behind and what it printed."""


def diverged_and_failed(out):
    """Shares of the trials of a finished run."""
    with closing(sqlite3.connect(out / "trials.sqlite")) as table:
        rows = table.execute("select diverged, failure from trials").fetchall()
    assert rows
    return np.mean([row[0] > 0 for row in rows]), np.mean([bool(row[1]) for row in rows])
