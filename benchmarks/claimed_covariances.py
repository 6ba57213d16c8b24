"""Covariances of `calibrate` and `claim`, held against drives that they were not learned from.

    python benchmarks/claimed_covariances.py --out runs/claimed                 # 20 + 20 drives: an hour on one core
    python benchmarks/claimed_covariances.py --out runs/claimed --data FOLDER   # and real ones
    python benchmarks/claimed_covariances.py --out runs/claimed --drives 4 --halvings 2 --only simulated

`frame-to-frame` on simulated and on rendered drives: learned from one half, held against the other, for random halves.
With `--data` (KITTI 00, 06, 07, Starry Night, published trajectories of KITTI 00, field samples): each of a group of
sequences by the model of the others, and likewise the quarters of one sequence, which are of the same system in one
place. The drives are kept in `--out`, and are not made again. NEES / 6 should be 1 and 90 % should be inside, over
windows of 1 and 10 s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
from scipy.stats import chi2

import stereo_slam_env as sse
from filters import nees
from harness import arguments, show
from stereo_slam_env.cli.app import main as command
from stereo_slam_env.evaluation.synchronisation import paired
from stereo_slam_env.evaluation.windows import motion_covariances, motions
from stereo_slam_env.recording.trajectory import pose_errors

LENGTHS = (1.0, 10.0)
SIMULATED = {
    "simulated": ["--preset", "quick"],
    "rendered": ["--preset", "quick", "--sensor", "images", "--renderer", "gl"],
}
REPLAYED = ("kitti00_stereo_tracks", "kitti06_stereo51", "kitti07_tracks", "starry_night_a")
FIELD = {
    "stereo VIO, EuRoC MH_03": ("rpg_stereo_vio/vio_stereo_MH_03.txt", "rpg_stereo_vio/MH_03_medium.txt"),
    "estimate of EuRoC V1_02": ("euroc_v102/V102.txt", "euroc_v102/V102_groundtruth.csv"),
    "ORB-SLAM, TUM fr2_desk": ("tum_fr2_desk/fr2_desk_ORB.txt", "tum_fr2_desk/fr2_desk_groundtruth.txt"),
}
RUNS = {
    f"cnspy run {k}": (f"cnspy_mc/ID1-pose-est-posorient-cov-run{k}.csv", "cnspy_mc/ID1-pose-gt.csv") for k in (6, 7, 8)
}
Drive = tuple[sse.Trajectory, sse.Trajectory]
"""An estimate and its truth."""
Found = Mapping[float, tuple[float, float]]
"""NEES / 6 and the share inside the 90 % ellipsoid, by the length of windows."""


def judged(drive: Drive, model: sse.DriftModel) -> Found:
    """A drive under the model of others."""
    pairs = paired(sse.claim(drive[0], model), drive[1])
    times = pairs.reference.timestamps
    assert times is not None
    found = {}
    for length in LENGTHS:
        last = np.searchsorted(times, times + length - 1e-6)
        first = np.flatnonzero(last < len(times))
        first = first[times[last[first]] - times[first] <= 1.2 * length]
        if not len(first):
            continue
        last = last[first]
        errors = pose_errors("right", *motions(pairs.estimate, first, last), *motions(pairs.reference, first, last))
        covariances = motion_covariances(pairs.estimate, first, last)
        assert covariances is not None
        values = nees(errors, covariances)
        found[length] = (float(values.mean()) / 6.0, float(np.mean(values <= chi2.ppf(0.9, 6))))
    return found


def halved(drives: Sequence[Drive], halvings: int) -> list[Found]:
    """The drives of one half by the model of the other."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(halvings):
        order = rng.permutation(len(drives))
        learned, held = order[: len(order) // 2], order[len(order) // 2 :]
        model = sse.calibrate([drives[k][0] for k in learned], [drives[k][1] for k in learned])
        each = [judged(drives[k], model) for k in held]
        found.append({length: tuple(np.mean([one[length] for one in each], axis=0).tolist()) for length in each[0]})
    return found


def left_out(drives: Sequence[Drive]) -> list[tuple[Found, str]]:
    """Each drive by the model of the others, and where that expects the NEES / 6 of a new drive."""
    found = []
    for k in range(len(drives)):
        others = [drive for j, drive in enumerate(drives) if j != k]
        model = sse.calibrate([one[0] for one in others], [one[1] for one in others])
        expected = "" if model.drive_range is None else "{:.2g} to {:.2g}".format(*model.drive_range)
        found.append((judged(drives[k], model), expected))
    return found


def quarters(drive: Drive) -> list[Drive]:
    """Four consecutive parts of a drive."""
    estimate, truth = drive
    parts = np.array_split(np.arange(len(estimate)), 4)
    return [(estimate.rows(part), truth) for part in parts]


def run_of(folder: Path, arguments: Sequence[str]) -> list[Drive]:
    """The drives of `frame-to-frame` in a run directory, which is made where there is none."""
    if not (folder / "summary.json").exists() and command([*arguments, "--out", str(folder)]):
        raise SystemExit(f"{' '.join(arguments)} failed")
    if arguments[0] == "bench" and command(["report", str(folder), "--trajectories"]):
        raise SystemExit(f"the trajectories of {folder} cannot be written")
    found = []
    for seed in sorted((folder / "trajectories").iterdir()):
        estimate, truth = (sse.load_trajectory(seed / f"{name}.square") for name in ("frame-to-frame", "truth"))
        found.append((replace(estimate, covariances=None), replace(truth, covariances=None)))
    return found


def published(data: Path) -> list[Drive]:
    """Two systems on KITTI 00."""
    times = np.loadtxt(data / "kitti_poses" / "00_times.txt")
    names = ("kitti00_published_results/KITTI_00_ORB.txt", "kitti00_published_results/KITTI_00_SPTAM.txt")
    truth, *estimates = (
        replace(sse.load_trajectory(data / name), timestamps=times) for name in ("kitti_poses/00.txt", *names)
    )
    return [(estimate, truth) for estimate in estimates]


def main() -> None:
    """Print one table for the drives made here, and one for those of others."""
    given = arguments(__doc__, out=Path("runs/claimed"), data=Path, drives=20, halvings=20, only=[*SIMULATED, "real"])
    rows: list[Sequence[str]] = []
    for name, options in SIMULATED.items():
        if name in given.only:
            how = ["bench", *options, "--filters", "frame-to-frame", "--seeds", str(given.drives), "--jobs", "1"]
            drives = run_of(given.out / name, how)
            found = halved(drives, given.halvings)
            for length in LENGTHS:
                values, shares = np.array([one[length] for one in found]).T * [[1.0], [100.0]]
                figures = (
                    f"{values.mean():.2f} ({values.min():.2f} to {values.max():.2f})",
                    f"{shares.mean():.0f} ({shares.min():.0f} to {shares.max():.0f})",
                )
                rows.append((f"{len(drives)} {name}", f"{length:g}", *figures))
    heads = ("drives", "windows, s", "NEES / 6 (of halvings)", "inside, % (of halvings)")
    show("half of the drives by the model of the other half", heads, rows)
    if given.data is None or "real" not in given.only:
        return
    replayed = {
        name: run_of(given.out / name, ["replay", str(given.data / name), "--filters", "frame-to-frame"])[0]
        for name in REPLAYED
    }
    folder = given.data / "field" / "trajectories"
    field, runs = (
        {name: (sse.load_trajectory(folder / a), sse.load_trajectory(folder / b)) for name, (a, b) in files.items()}
        for files in (FIELD, RUNS)
    )
    orb, sptam = published(given.data)
    of_one = {
        "frame-to-frame, KITTI 07": replayed["kitti07_tracks"],
        "frame-to-frame, Starry Night": replayed["starry_night_a"],
        "ORB-SLAM2, KITTI 00": orb,
        "S-PTAM, KITTI 00": sptam,
        **field,
    }
    groups = {
        name: {f"{name}, part {k}": part for k, part in enumerate(quarters(drive), 1)} for name, drive in of_one.items()
    }
    groups |= {
        "runs of an EKF on one drive": runs,
        "two systems on KITTI 00": {"ORB-SLAM2": orb, "S-PTAM": sptam},
        "frame-to-frame, four recordings": replayed,
        "three systems, indoors": field,
    }
    rows = []
    for group, members in groups.items():
        for name, (found, expected) in zip(members, left_out(list(members.values())), strict=True):
            cells = []
            for length in LENGTHS:
                cells += [f"{found[length][0]:.2f}", f"{100.0 * found[length][1]:.0f}"] if length in found else ["", ""]
            rows.append((group, name, expected, *cells))
    heads = (
        "group",
        "held out",
        "NEES / 6 expected",
        *chain(*((f"NEES / 6, {s:g} s", f"inside, {s:g} s, %") for s in LENGTHS)),
    )
    show("each by the model of the others of its group", heads, rows)


if __name__ == "__main__":
    main()
