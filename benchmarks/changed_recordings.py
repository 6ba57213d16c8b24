"""What a covariance is worth on recordings that are a little different: fewer frames, noise, a rig that is wrong.

    python benchmarks/changed_recordings.py DATA                                  # some minutes
    python benchmarks/changed_recordings.py DATA --recordings kitti07_tracks --changes "as it is" "every 2nd frame"
    python benchmarks/changed_recordings.py DATA --look 0                         # no future: what is assumed
    python benchmarks/changed_recordings.py DATA --causal                         # no future: measured on the way
    python benchmarks/changed_recordings.py DATA --options '{"iterations": 3}'    # of the filter
    python benchmarks/changed_recordings.py DATA --severe                         # what no filter survives
    python benchmarks/changed_recordings.py DATA --grades                         # noise and outliers in between
    python benchmarks/changed_recordings.py DATA --odometry                       # as stated and corrected
    python benchmarks/changed_recordings.py --rendered 6 --renderer gl            # right turns, all changes
    python benchmarks/changed_recordings.py --wrong-rigs 5 --rigs 4               # rendered drives, wrong rigs of each

DATA is the folder that holds the recordings of `benchmarks/real_covariances.py`. The tracks are changed, their noise is
measured again as a stranger's would be, and "coloured-noise" runs on them, vision only but for `--odometry`. NEES/6 of
the pose and of the motion over windows of 1 s and 3 s should be 1, with the number of windows; the log score is minus
the mean log likelihood of windows (nats, lower is better); ATE is rigid, m. NIS by its degrees of freedom, the share of
gated measurements and that of the frames in which the alarm of a `DivergenceMonitor` stands, %, are what a user sees
without a truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

import stereo_slam_env as sse
from filters import BodyVelocity, DivergenceMonitor, Pose, StereoCamera, StereoNoise, StereoObservation, nees
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from harness import arguments, show
from stereo_slam_env.datasets import layout_of, track_layouts
from stereo_slam_env.evaluation.trajectory_metrics import ate_rigid
from stereo_slam_env.evaluation.windows import window_ends
from stereo_slam_env.frontend import set_up_for_tracks, with_measured_noise
from stereo_slam_env.frontend.causal_noise import CausalNoiseEKF
from stereo_slam_env.frontend.track_noise import MISALIGNMENT, bring_R, stated_noise, track_noise
from stereo_slam_env.recording.recording import GIVEN_TRUTH, Frame, Recording
from stereo_slam_env.recording.trajectory import pose_errors

RECORDINGS: Mapping[str, int | None] = {
    "kitti06_stereo51": None,
    "kitti00_stereo_tracks": None,
    "kitti07_tracks": 600,
    "starry_night_a": None,
}
"""Recordings and how many of their frames are used, for the sake of time; None: all."""
WINDOWS = (1.0, 3.0)
WRONG_RIG = StereoCamera(420.0, 420.0, 317.0, 204.0, 0.12, 640, 400)
"""Of the rendered drives whose rig is wrong."""

Change = Callable[[Recording, np.random.Generator], Recording]


def measured_again(recording: Recording, look: int | None = None) -> Recording:
    """The recording with what its tracks, or those of its first frames, say now; a stranger states no more than R."""
    bare = replace(recording, noise=StereoNoise(recording.noise.R))
    if look is None:
        return with_measured_noise(bare)
    stranger = recording.truth_from.kind != "simulation"
    return replace(bare, noise=stated_noise(track_noise(bare[:look]), bare.noise, bring_R(bare), stranger))


def every(n: int) -> Change:
    """Every nth frame; odometry is of single steps and left out."""
    return lambda drive, rng: replace(drive, frames=tuple(replace(frame, odometry=None) for frame in drive.frames[::n]))


def late(frames: int) -> Change:
    """Odometry that comes so many frames late."""

    def change(drive: Recording, rng: np.random.Generator) -> Recording:
        told = [drive.frames[max(k - frames, 1)].odometry for k in range(len(drive))]
        return replace(drive, frames=tuple(replace(f, odometry=o) for f, o in zip(drive.frames, told, strict=True)))

    return change


def biased(*rates: float) -> Change:
    """A gyro with a bias, rad/s."""

    def off(odometry: BodyVelocity | None) -> BodyVelocity | None:
        return None if odometry is None else replace(odometry, angular=odometry.angular + rates)

    return lambda drive, rng: replace(drive, frames=tuple(replace(f, odometry=off(f.odometry)) for f in drive.frames))


def _seen(drive: Recording, change: Callable[[StereoObservation], StereoObservation]) -> Recording:
    return drive.with_observations([change(frame.observation) for frame in drive.frames])


def _moved(drive: Recording, error: Callable[[FloatArray], FloatArray]) -> Recording:
    return _seen(drive, lambda seen: replace(seen, uvd=seen.uvd + error(seen.uvd)))


def half_the_tracks(drive: Recording, rng: np.random.Generator) -> Recording:
    """Half of the landmarks, chosen at random."""
    ids = np.unique(np.concatenate([frame.observation.ids for frame in drive.frames]))
    kept = rng.choice(ids, len(ids) // 2, replace=False)
    return _seen(drive, lambda seen: seen.select(np.isin(seen.ids, kept)))


def outliers(share: float) -> Change:
    """Some measurements are wrong by some 20 px."""

    def change(drive: Recording, rng: np.random.Generator) -> Recording:
        return _moved(drive, lambda uvd: 20.0 * rng.normal(size=uvd.shape) * (rng.random((len(uvd), 1)) < share))

    return change


def white_noise(pixels: float) -> Change:
    """On each of u_left, v and u_right."""

    def change(drive: Recording, rng: np.random.Generator) -> Recording:
        def error(uvd: FloatArray) -> FloatArray:
            n = pixels * rng.normal(size=uvd.shape)
            return np.column_stack([n[:, 0], n[:, 1], n[:, 0] - n[:, 2]])

        return _moved(drive, error)

    return change


def focal_length(share: float) -> Change:
    """Focal lengths are stated too large."""
    return lambda drive, rng: replace(
        drive, camera=replace(drive.camera, fx=drive.camera.fx * (1 + share), fy=drive.camera.fy * (1 + share))
    )


def baseline(share: float) -> Change:
    """The baseline is stated too large."""
    return lambda drive, rng: replace(drive, camera=replace(drive.camera, baseline=drive.camera.baseline * (1 + share)))


def turned(degrees: float) -> Change:
    """The right camera is turned about its vertical axis."""

    def change(drive: Recording, rng: np.random.Generator) -> Recording:
        camera, angle = drive.camera, np.radians(degrees)

        def error(uvd: FloatArray) -> FloatArray:
            x_right = (uvd[:, 0] - uvd[:, 2] - camera.cx) / camera.fx
            return np.outer(camera.fx * angle * (1.0 + x_right**2), [0.0, 0.0, 1.0])

        return _moved(drive, error)

    return change


def rolled(radians: float) -> Change:
    """The right camera is turned about its optical axis."""
    return lambda drive, rng: _moved(
        drive, lambda uvd: np.outer(radians * (uvd[:, 1] - drive.camera.cy), [0.0, 0.0, 1.0])
    )


def shifted(pixels: float) -> Change:
    """All disparities are off."""
    return lambda drive, rng: _moved(drive, lambda uvd: np.tile([0.0, 0.0, pixels], (len(uvd), 1)))


def in_the_middle(seconds: float, change: Callable[[StereoObservation], StereoObservation]) -> Change:
    """Something else is seen for some time."""

    def changed_then(drive: Recording, rng: np.random.Generator) -> Recording:
        times = np.array([frame.timestamp for frame in drive.frames])
        then = np.abs(times - 0.5 * (times[0] + times[-1])) <= 0.5 * seconds
        seen = [frame.observation for frame in drive.frames]
        return drive.with_observations([change(one) if now else one for one, now in zip(seen, then, strict=True)])

    return changed_then


CHANGES: Mapping[str, Change] = {
    "as it is": lambda drive, rng: drive,
    "every 2nd frame": every(2),
    "every 3rd frame": every(3),
    "half the tracks": half_the_tracks,
    "2 % outliers": outliers(0.02),
    "+ 0.5 px white noise": white_noise(0.5),
    "focal + 0.5 %": focal_length(0.005),
    "baseline + 1 %": baseline(0.01),
    "right camera turned 0.1 deg": turned(0.1),
}


SEVERE: Mapping[str, Change] = {
    "every 10th frame": every(10),
    "30 % outliers": outliers(0.3),
    "+ 3 px white noise": white_noise(3.0),
    "identities mixed, 1 s": in_the_middle(1.0, lambda seen: replace(seen, ids=np.roll(seen.ids, 1))),
    "nothing seen, 3 s": in_the_middle(3.0, lambda seen: seen.select(np.zeros(len(seen), dtype=bool))),
    "focal + 10 %": focal_length(0.1),
    "right camera turned 1 deg": turned(1.0),
}
"""Changes that no filter is expected to survive: does it say so?"""
GRADES: Mapping[str, Change] = {
    **{f"+ {pixels:g} px white noise": white_noise(pixels) for pixels in (1.0, 2.0)},
    **{f"{100 * share:g} % outliers": outliers(share) for share in (0.1, 0.2)},
}
"""Noise and wrong matches in between."""
ODOMETRY: Mapping[str, Change] = {
    "as it is": lambda drive, rng: drive,
    "1 frame late": late(1),
    "rates + 11 mrad/s": biased(-0.011, -0.011, 0.010),
}
"""Odometry that is worse."""
OF_THE_RIG = (*tuple(CHANGES)[-3:], *tuple(SEVERE)[-2:])
"""Changes after which the rig is not as it is stated."""


@dataclass(frozen=True)
class Row:
    """Figures of a run."""

    pose: float
    """NEES / 6, mean over the frames."""
    windows: tuple[float, ...]
    """NEES / 6, mean over the windows of each length of `WINDOWS`."""
    scores: tuple[float, ...]
    """Minus the mean log likelihood of the windows, nats."""
    counts: tuple[int, ...]
    """Numbers of the windows."""
    ate: float
    """Rigid, m."""
    nis: float
    """By its degrees of freedom."""
    gated: float
    """Share of the measurements, %."""
    alarmed: float
    """Share of the frames in which the alarm of a `DivergenceMonitor` stands, %."""

    @property
    def cells(self) -> list[str]:
        """For a table."""
        windows = [f"{window:.2f} ({n:g})" for window, n in zip(self.windows, self.counts, strict=True)]
        scores = [f"{score:.1f}" for score in self.scores]
        return [
            f"{self.pose:.2f}",
            *windows,
            *scores,
            f"{self.ate:.2f}",
            f"{self.nis:.2f}",
            f"{self.gated:.1f}",
            f"{self.alarmed:.0f}",
        ]


HEADS = ("", "NEES/6", "1 s (n)", "3 s (n)", "score 1 s", "3 s", "ATE, m", "NIS", "gated, %", "alarm, %")


def scored(
    recording: Recording, slam: str | type = "coloured-noise", use_odometry: bool = False, **options: Any
) -> Row:
    """A filter on a recording, vision only unless said."""
    reference, frames = recording.reference, recording.frames
    times = np.array([frame.timestamp for frame in frames])
    scored_at = np.flatnonzero([frame.truth is not None for frame in frames] & reference.has_settled(times))
    ends = {s: {int(scored_at[j]): int(scored_at[i]) for i, j in window_ends(times[scored_at], s)} for s in WINDOWS}
    found: dict[float, list[tuple[float, float]]] = {seconds: [] for seconds in WINDOWS}
    pose, estimates, nis, dof, gated, measured = [], [], 0.0, 0, 0, 0
    monitor, alarmed = DivergenceMonitor(), 0
    for moment in sse.run(slam, recording, use_odometry=use_odometry, **options):
        k, running = moment.number, moment.slam
        nis, dof = nis + moment.report.nis, dof + moment.report.nis_dof
        gated, measured = gated + len(moment.report.gated), measured + len(moment.observation)
        monitor.look(times[k] - times[max(k - 1, 0)], moment.report, moment.pose)
        alarmed += monitor.standing is not None
        if k not in scored_at:
            continue
        pose.append(moment.nees)
        estimates.append((moment.pose.position, moment.truth.position))
        for seconds, first_of in ends.items():
            label = f"window-{seconds:g}"
            if k in first_of:
                moved, start = running.relative_pose(label), frames[first_of[k]].truth
                true = start.inverse() @ moment.truth
                parts = (moved.position, moved.orientation, true.position, true.orientation)
                error = pose_errors("position-rotation", *(part[None] for part in parts))
                P = moved.covariance + reference.relative_covariance(start, moment.truth)
                value = float(nees(error, P[None])[0])
                found[seconds].append((value, 0.5 * (value + np.linalg.slogdet(2.0 * np.pi * P)[1])))
                running.forget_clone(label)
            if k in first_of.values():
                running.clone_pose(label)
    means = [np.mean(found[s], axis=0) if found[s] else np.full(2, np.nan) for s in WINDOWS]
    estimated, true_positions = (np.array(part) for part in zip(*estimates, strict=True))
    return Row(
        float(np.mean(pose)) / 6,
        tuple(float(mean[0]) / 6 for mean in means),
        tuple(float(mean[1]) for mean in means),
        tuple(len(found[s]) for s in WINDOWS),
        ate_rigid(estimated, true_positions),
        nis / max(dof, 1),
        100.0 * gated / max(measured, 1),
        100.0 * alarmed / len(frames),
    )


def changed(drive: Recording, name: str, look: int | None = None) -> Recording:
    """The drive with a change of `CHANGES`, `SEVERE` or `GRADES`, always the same."""
    every_change = {**CHANGES, **SEVERE, **GRADES}
    change = every_change[name](drive, np.random.default_rng(list(every_change).index(name)))
    if name in OF_THE_RIG and drive.truth_from.kind == "simulation":
        change = replace(change, truth_from=GIVEN_TRUTH)  # its rig is not as stated any more
    return measured_again(change, look)


def show_changes(
    title: str,
    drives: Sequence[Recording],
    changes: Sequence[str],
    look: int | None,
    causal: bool,
    options: Mapping[str, Any],
) -> None:
    """A row for each change; means over the drives."""
    slam = CausalNoiseEKF if causal else "coloured-noise"
    rows = [
        (name, *_mean([scored(changed(drive, name, look), slam, **options) for drive in drives]).cells)
        for name in changes
    ]
    show(title, HEADS, rows)


def show_odometry(folder: Path, frames: int | None) -> None:
    """A row for each change of the odometry, as it is stated and corrected by the tracks; and without it."""
    layouts = {layout.NAME: layout for layout in track_layouts()}
    stated = layouts[layout_of(folder)].read(folder)[:frames]
    drive = set_up_for_tracks(with_measured_noise(stated))
    rows = [("vision only", *scored(drive).cells)]
    for name, change in ODOMETRY.items():
        wrong = change(replace(stated, noise=drive.noise), np.random.default_rng(0))
        for how, one in (
            ("as stated", replace(wrong, stated_setup=drive.stated_setup)),
            ("corrected", set_up_for_tracks(wrong)),
        ):
            rows.append((f"{name}, {how}", *scored(one, use_odometry=True).cells))
    show(f"odometry of {folder.name}, {len(drive)} frames", HEADS, rows)


def _mean(rows: Sequence[Row]) -> Row:
    figures: dict[str, Any] = {
        field.name: np.mean([getattr(row, field.name) for row in rows], axis=0) for field in fields(Row)
    }
    return Row(**{name: tuple(mean) if np.ndim(mean) else float(mean) for name, mean in figures.items()})


def rendered(seeds: Iterable[int], renderer: str, route: str, **options: Any) -> Iterator[Recording]:
    """Drives in rendered images."""
    for seed in seeds:
        yield sse.record("StereoSlam/Drive-v0", seed=seed, route=route, sensor="images", renderer=renderer, **options)


def mounted(drive: Recording, turn: FloatArray) -> Recording:
    """The drive with the poses of a body in which the camera is turned by a rotation vector, rad."""
    camera_in_body = Pose(np.zeros(3), rotations.exp_quaternion(turn))

    def of_body(frame: Frame) -> Frame:
        if frame.truth is None:
            return frame
        motion = start.inverse() @ frame.truth
        return replace(frame, truth=start @ (camera_in_body.inverse() @ motion @ camera_in_body))

    start = next(frame.truth for frame in drive.frames if frame.truth is not None)
    return replace(drive, frames=tuple(of_body(frame) for frame in drive.frames))


def with_wrong_rig(drive: Recording, seed: int, exact_mounting: bool = False) -> Recording:
    """The drive as a stranger's whose rig is wrong.

    Standard deviations: 0.5 % of the focal length, 1 % of the baseline, 0.1 degrees of yaw and of roll of the right
    camera, 0.3 px of disparity; and 5 mrad about each axis of how the camera is turned in the body of the truth, where
    it is not mounted exactly.
    """
    rng = np.random.default_rng(seed)
    draws = rng.normal(size=5)
    if not exact_mounting:
        drive = mounted(drive, MISALIGNMENT * rng.normal(size=3))
    errors = {focal_length: 0.005, baseline: 0.01, turned: 0.1, rolled: 0.00175, shifted: 0.3}
    for (change, sigma), drawn in zip(errors.items(), draws, strict=True):
        drive = change(sigma * drawn)(drive, rng)
    return measured_again(replace(drive, truth_from=GIVEN_TRUTH))


def main() -> None:
    """Run and print."""
    given = arguments(
        __doc__,
        "data?",
        data=Path,
        recordings=list(RECORDINGS),
        changes=list(CHANGES),
        severe=False,
        grades=False,
        look=int,
        causal=False,
        options={},
        rendered=0,
        wrong_rigs=0,
        rigs=1,
        exact_mounting=False,
        odometry=False,
        first_seed=0,
        renderer="gl",
        route="right-turn",
    )
    look = 0 if given.causal else given.look
    if given.odometry and given.data is not None:
        for name in set(given.recordings) & {"kitti07_tracks", "starry_night_a"}:
            show_odometry(given.data / name, RECORDINGS[name])
        return
    changes = list(SEVERE) if given.severe else list(GRADES) if given.grades else given.changes
    if given.data is not None:
        for name in given.recordings:
            if (given.data / name).is_dir():
                drive = sse.load(given.data / name)[: RECORDINGS[name]]
                show_changes(f"{name}, {len(drive)} frames", [drive], changes, look, given.causal, given.options)
    if given.rendered:
        seeds = range(given.first_seed, given.first_seed + given.rendered)
        drives = list(rendered(seeds, given.renderer, given.route))
        show_changes(f"{given.route} by {given.renderer}", drives, changes, look, given.causal, given.options)
    if given.wrong_rigs:
        seeds = range(given.first_seed, given.first_seed + given.wrong_rigs)
        show_wrong_rigs(
            rendered(seeds, given.renderer, given.route, rig=WRONG_RIG), seeds, given.rigs, given.exact_mounting
        )


def show_wrong_rigs(drives: Iterable[Recording], seeds: Sequence[int], rigs: int, exact_mounting: bool) -> None:
    """A row for each rig, some of each drive, and the means."""
    scores = {
        f"{seed}, {rig}": scored(with_wrong_rig(drive, rigs * seed + rig, exact_mounting))
        for seed, drive in zip(seeds, drives, strict=True)
        for rig in range(rigs)
    }
    rows = [(name, *row.cells) for name, row in scores.items()]
    show(f"rendered, {len(rows)} wrong rigs", HEADS, [*rows, ("mean", *_mean(list(scores.values())).cells)])


if __name__ == "__main__":
    main()
