"""How much is measured. The conditions that everything is measured under, and their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.util import find_spec

from filters import StereoNoise

UVD, PIXELS = "uvd", "pixels"
"""Noise of the measurements: u, v, d independent (the paper's assumption); u_l, v_l, u_r, v_r independent."""
NOISES: Mapping[str, str] = {UVD: "as the paper assumes", PIXELS: "independent pixels"}

DIAGONAL, COUPLED = "diagonal", "full"
ASSUMED: Mapping[str, StereoNoise] = {
    DIAGONAL: StereoNoise.diagonal(1.0, 1.0, 1.0),
    COUPLED: StereoNoise.independent_pixels(1.0),
}
"""R that a filter assumes, px^2: the paper's ("in our experiments 1 pixel" each), and that of independent pixels."""
RIGHT = {UVD: DIAGONAL, PIXELS: COUPLED}
"""The R that describes a noise."""
ASSUMED_NAMES: Mapping[str, str] = {DIAGONAL: "the paper's", COUPLED: "of independent pixels"}

JOINT, DUAL, EUCLIDEAN = "inverse-depth", "dual-bearing", "euclidean"
"""The paper's filter, its rival with one bearing update an eye, and the classic with points XYZ."""
EUCLIDEAN_GUARD = 5.0
"""px; the classic starts no landmark with less disparity, or it diverges on far points."""

COMPILED = find_spec("numba") is not None
COMMON_OPTIONS: Mapping[str, object] = {"gate": None, "compiled": COMPILED}
"""Of every filter here: nothing is gated, so nothing is hidden; compiled, where it can be, is the same but faster."""


@dataclass(frozen=True)
class PaperSettings:
    """How much is measured.

    Attributes
    ----------
    samples : int
        Of each Monte-Carlo cloud of section 4.1.
    turn_seeds : int
        Recordings of 4.3, for each noise.
    drive_seeds, drive_frames : int
        Recordings of 4.4, for each noise, and their length.
    sizes : tuple of int
        Numbers of landmarks that the speed is measured at.
    repeats : int
        Rounds of that measurement.

    Raises
    ------
    ValueError
        A number is not positive.
    """

    samples: int = 10_000
    turn_seeds: int = 200
    drive_seeds: int = 20
    drive_frames: int = 800
    sizes: tuple[int, ...] = (25, 50, 100, 200)
    repeats: int = 30

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            numbers = value if isinstance(value, tuple) else (value,)
            if not numbers or any(type(number) is not int or number < 1 for number in numbers):
                raise ValueError(f"{field.name} must be whole numbers >= 1, got {value!r}")


FULL = PaperSettings()
QUICK = PaperSettings(turn_seeds=20, drive_seeds=6, drive_frames=150, sizes=(25, 50, 100), repeats=8)
"""To see that everything works, within a minute; most intervals are then too wide to show anything."""
