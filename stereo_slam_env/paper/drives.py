"""The drives of sections 4.3 and 4.4: simulated measurements, rendered images, real recordings.

Simulated ones obey the filters' models; there is one for each seed. Rendered ones go through the front end, which makes
mistakes, and their truth is exact. Real ones are whatever `replay` takes, one of each, with the truth that they bring.
"""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from filters import StereoNoise
from stereo_slam_env import Recording, load
from stereo_slam_env.benchmark import StreetSource, long_drive, short_turn
from stereo_slam_env.datasets import holds_images, layout_of
from stereo_slam_env.paper.paper_claims import (
    ASSUMED,
    ASSUMED_NAMES,
    COUPLED,
    DIAGONAL,
    GATED,
    NOISES,
    OWN,
    PLACES,
    REAL,
    RENDERED,
    RIGHT,
    SIMULATION,
    UNGATED,
    Arrays,
    Claim,
    Interval,
    Measured,
    claim,
)

KITTI_00 = "gtsam"
"""The example data of the gtsam wheel: 135 frames of KITTI 00."""
KITTI_00_FOLDER = "kitti00_stereo_tracks"
"""Layout of the same tracks with their true poses."""
KARLSRUHE_TURN, KARLSRUHE_DRIVE = "2009_09_08_drive_0010", "2009_09_08_drive_0015"
FRAMES_OF_THE_PAPER: Mapping[str, tuple[int, int]] = {KARLSRUHE_TURN: (61, 72), KARLSRUHE_DRIVE: (0, 799)}
"""First and last, both included, of the recordings that the paper uses."""
HOW_TO_GET_KARLSRUHE = (
    f"Not judged on the Karlsruhe sequences: get {KARLSRUHE_TURN} and {KARLSRUHE_DRIVE} with 2009_09_08_calib.txt from "
    "www.cvlibs.net/datasets/karlsruhe_sequences and give their folder with --karlsruhe."
)
MOST_FRAMES = 1200
"""Of a real recording; more would take longer than everything else."""
TURN, DRIVE = "turn", "drive"
"""What is driven: 4.3 and 4.4."""
ROUTES = {TURN: "right-turn", DRIVE: "town"}


@dataclass(frozen=True)
class RealDrive:
    """A real recording: what `load` takes, and the frames of images that are used, first and last included."""

    source: str
    first: int | None = None  # where the truth has settled
    last: int = MOST_FRAMES - 1

    def load(self) -> Recording:
        """The tracks, with the setup that real ones need."""
        if self.source != KITTI_00 and holds_images(self.source):
            return load(self.source, first=self.first, last=self.last, on_broken="skip")
        return load(self.source)[: self.last + 1]

    @property
    def state(self) -> list[float]:
        """Fingerprint of its files, so that results of other files are told apart."""
        path = Path(self.source)
        files = [file for file in (path.iterdir() if path.is_dir() else [path]) if file.is_file()]
        about = [file.stat() for file in files]
        return [len(files), sum(one.st_size for one in about), max((one.st_mtime for one in about), default=0.0)]


def real_drives(paths: Iterable[Path], karlsruhe: Path | None = None) -> dict[str, RealDrive]:
    """The recordings by name: KITTI 00 where gtsam is installed, those given, those of the paper in a folder.

    The poses in the wheel of gtsam are of visual odometry; given with true poses, KITTI 00 is not taken from there.

    Raises
    ------
    ValueError
        A path that is not there or no recording, two of one name, or a folder for `karlsruhe` that has none of the
        paper's.
    """
    folders = [path.resolve() for path in (*paths, *([] if karlsruhe is None else _of_the_paper(karlsruhe)))]
    for path in folders:
        if not path.exists():
            raise ValueError(f"real drive {path} does not exist: give what `stereo-slam replay` takes")
        if path.is_dir() and layout_of(path) is None and not holds_images(path):
            raise ValueError(f"real drive {path} has no known layout: give what `stereo-slam replay` takes")
        if path.suffix == ".npz":
            load(path)
    with_truth = any(path.is_dir() and layout_of(path) == KITTI_00_FOLDER for path in folders)
    drives = {"KITTI 00": RealDrive(KITTI_00)} if _has_gtsam() and not with_truth else {}
    for path in folders:
        name = re.sub(r"[^\w-]+", "_", path.stem if path.is_file() else path.name)
        if name in drives:
            raise ValueError(f"two real drives have the name {name!r}: rename one of their folders")
        drives[name] = RealDrive(str(path), *FRAMES_OF_THE_PAPER.get(name, ()))
    return drives


def _has_gtsam() -> bool:
    return importlib.util.find_spec("gtsam") is not None


def _of_the_paper(folder: Path) -> list[Path]:
    places = [
        place
        for name in FRAMES_OF_THE_PAPER
        for place in (folder / name, folder)
        if place.name == name and place.is_dir() and layout_of(place) == "karlsruhe"
    ]
    if not places:
        raise ValueError(
            f"{folder} holds neither {KARLSRUHE_TURN} nor {KARLSRUHE_DRIVE} with images I1_*.png, I2_*.png and "
            f"2009_09_08_calib.txt in it or beside it"
        )
    return places


def refusal_to_render() -> str:
    """Reason that nothing is judged in rendered images; empty where the renderer `gl` runs here."""
    try:
        StreetSource().with_images("gl").check()
    except ValueError as error:
        return f"Not judged in rendered images: {error}"
    return ""


def simulated(what: str, noise: str, seed: int, frames: int) -> Recording:
    """A drive past a cloud of points, or the beginning of one."""
    problem = {TURN: short_turn, DRIVE: long_drive}[what]
    return problem(seed, noise, frames=frames)


def rendered(what: str, seed: int, frames: int) -> Recording:
    """Tracks of the front end in images of the simulated street, drawn by the renderer `gl`."""
    return StreetSource({"route": ROUTES[what]}).with_images("gl").record(seed, frames)


@dataclass(frozen=True)
class Setting:
    """Setup of the filters on some drives, and the names of these in results."""

    key: str  # a noise, "rendered", or "real-" and the name of the drive
    place: str  # of `PLACES`
    condition: Mapping[str, str]  # what tells the drives from others of the place
    right: str  # R that describes the measurements as well as it is known

    @property
    def levels(self) -> tuple[str, str]:
        """R that filters assume: the paper's, and the other one."""
        return DIAGONAL, COUPLED if self.place == SIMULATION else OWN

    @property
    def pairs(self) -> Mapping[str, tuple[str, str]]:
        """Comparisons: the R of the paper's filter, and that of its competitor.

        In simulation one is between different R: two images with errors of 1 px each are what the full R describes.
        """
        same = {ASSUMED_NAMES[R]: (R, R) for R in self.levels}
        if self.place != SIMULATION:
            return same
        return {**same, f"{ASSUMED_NAMES[DIAGONAL]}, competitor, 1 px an image": (DIAGONAL, COUPLED)}

    @property
    def options(self) -> Mapping[str, Any]:
        """Options of every filter."""
        return UNGATED if self.place == SIMULATION else GATED

    def seen(self, recording: Recording, R: str) -> tuple[Recording, StereoNoise | None]:
        """The recording for filters that assume that R, and the noise that they are given; None: the recording's."""
        if R == OWN:
            return recording, None
        if self.place == SIMULATION:
            return recording, ASSUMED[R]
        plain = (replace(frame.observation, R=None) for frame in recording.frames)
        return recording.with_observations(plain), ASSUMED[R]


def setting(key: str) -> Setting:
    """The setting of that key."""
    if key in NOISES:
        return Setting(key, SIMULATION, {"noise": NOISES[key]}, RIGHT[key])
    if key == RENDERED:
        return Setting(key, RENDERED, {}, OWN)
    return Setting(key, REAL, {"drive": key.removeprefix(f"{REAL}-")}, OWN)


def settings_of(results: Mapping[str, Arrays], what: str) -> dict[str, list[Arrays]]:
    """The results of 4.3 or 4.4, by key of the setting: simulated ones first, real ones last."""
    by_key: dict[str, list[Arrays]] = {}
    for name, arrays in sorted(results.items()):
        kind, _, rest = name.partition(".")
        if kind == what and arrays:  # a recording may be too short
            by_key.setdefault(rest.rpartition(".")[0], []).append(arrays)
    order = [*NOISES, RENDERED]
    return dict(sorted(by_key.items(), key=lambda item: (order.index(item[0]) if item[0] in order else 9, item[0])))


class Results(Protocol):
    """Results of one setting."""

    @property
    def setting(self) -> Setting:
        """Setting of the drives."""
        ...


Some = TypeVar("Some", bound=Results)


def judged(quantities: Mapping[str, Callable[[Some], Measured]], every: Sequence[Some]) -> tuple[Claim, ...]:
    """The sentences by their keys, judged by a quantity in each setting; values that are not known are left out."""
    claims = []
    for key, measured in quantities.items():
        by_place: dict[str, list[tuple[Mapping[str, str], Interval]]] = {place: [] for place in PLACES}
        for one in every:
            pairs = [({**one.setting.condition, **more}, value) for more, value in measured(one)]
            by_place[one.setting.place] += [pair for pair in pairs if not math.isnan(pair[1].value)]
        claims.append(claim(key, *by_place.values()))
    return tuple(claims)


def experiments(
    what: str,
    work: Callable[..., Arrays],
    seeds: Mapping[str, int],
    frames: int,
    real: Mapping[str, RealDrive],
    at_once: int,
) -> Iterator[tuple[str, partial[Arrays]]]:
    """The work on all drives, by name: `work` of a key, and seeds and frames, or a real drive and its state.

    `seeds` are numbers of drives by key; `at_once` of them make one experiment.
    """
    for key, count in seeds.items():
        for first in range(0, count, at_once):
            yield f"{what}.{key}.{first:04d}", partial(work, key, first, min(first + at_once, count), frames)
    for name, drive in real.items():
        key = f"{REAL}-{name}"
        yield f"{what}.{key}.0000", partial(work, key, drive.source, drive.first, drive.last, drive.state)


def recordings_of(what: str, key: str, *about: Any) -> Iterator[tuple[int, Recording]]:
    """Number and recording of each drive of an experiment, see `experiments`."""
    if key.startswith(REAL):
        source, first, last, _ = about
        yield 0, RealDrive(source, first, last).load()
        return
    first, end, frames = about
    for seed in range(first, end):
        yield seed, rendered(what, seed, frames) if key == RENDERED else simulated(what, key, seed, frames)
