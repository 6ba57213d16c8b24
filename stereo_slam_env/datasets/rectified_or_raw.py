"""Whether images are rectified or raw: measured by the rows of their corners, stated only where these cannot say.

Rectified images stand beside the calibration of the raw cameras, and raw ones beside that of rectified images; names of
topics say either. Under the right reading a corner has one row in both images.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TypeVar

from stereo_slam_env.datasets.image_files import BrokenPair, read_grey
from stereo_slam_env.frontend.row_offsets import FEWEST, RowOffsets, row_offsets
from stereo_slam_env.recording.recording import GreyImage, StereoPair
from stereo_slam_env.sensing.lenses import Rectification
from stereo_slam_env.sensing.rig_files import Calibration

Images = Sequence[tuple[GreyImage, GreyImage]]
SAMPLE = 8
"""Pairs that are looked at."""
_EVERY = 5
"""They are so many pairs apart, in recordings that are long enough."""
_BETTER_BY, _SHARE = 0.15, 0.5
"""A reading that was not stated is taken where its rows agree better by so much, px, and to this share."""
_BEYOND_INFINITY = 0.1
"""Share of corners with disparities below -1 px that convicts a reading if the other one has none."""

log = logging.getLogger(__name__)


Read = TypeVar("Read", bound=Calibration)


def as_they_are(calibration: Read, sample: Callable[[], Images], what: str) -> tuple[Read, tuple[str, ...]]:
    """The calibration with its images read as raw or as rectified, and a note where that needs one.

    Parameters
    ----------
    calibration : StereoCamera or Rectification
        With the stated reading in `mapped`. A rig alone has no other reading.
    sample : callable
        Gives pairs of images as they were taken; called only where there is a choice.
    what : str
        Name of the images, for the note.
    """
    if not isinstance(calibration, Rectification) or not any(calibration.changes):
        return calibration, ()
    stated = calibration.mapped
    others = [one for one in _NAMES if one != stated]
    if stated[0] == stated[1]:
        others = [(not stated[0], not stated[1])]
    images = sample()
    rows = {one: _rows(replace(calibration, mapped=one), images) for one in (stated, *others)}
    best = min(others, key=lambda one: rows[one].spread)
    said, other = rows[stated], rows[best]
    if len(other.offset) < FEWEST and len(said.offset) < FEWEST:
        note = f"too few corners of {what} are in both images to tell whether these are rectified: read as stated, "
        return calibration, (_logged(note + _NAMES[stated], logging.INFO),)
    agree = f"rows agree to {other.spread:.2f} px {_HOW[best]}, to {said.spread:.2f} px {_HOW[stated]}"
    if _convicts(said, other):
        note = f"the images of {what} are {_NAMES[best]}, although their calibration or name says {_NAMES[stated]}: "
        return replace(calibration, mapped=best), (_logged(note + agree, logging.WARNING),)
    if min(said.spread, other.spread) > (1.0 - _SHARE) * max(said.spread, other.spread):
        note = f"the images of {what} are read as stated, {_NAMES[stated]}, which their rows do not decide: {agree}"
        return calibration, (_logged(note, logging.INFO),)
    return calibration, ()


def sample_of_pairs(pairs: Iterable[StereoPair], count: int) -> Images:
    """Images of some pairs of a sequence that has `count` of them; broken ones end it, and are met later."""
    taken: list[tuple[GreyImage, GreyImage]] = []
    try:
        for pair in islice(pairs, 0, SAMPLE * _EVERY, max(1, min(_EVERY, count // SAMPLE))):
            taken.append((pair.left, pair.right))
            if len(taken) == SAMPLE:
                break
    except BrokenPair:
        pass
    return taken


def sample_of_files(images: tuple[Mapping[int, Path], Mapping[int, Path]], size: tuple[int, int]) -> Images:
    """Some pairs of the files of both cameras by frame number; broken ones are left out, and met later."""
    numbers = sorted(images[0].keys() & images[1].keys())[: SAMPLE * _EVERY]
    taken = []
    for number in numbers[:: max(1, len(numbers) // SAMPLE)][:SAMPLE]:
        try:
            taken.append((read_grey(images[0][number], size), read_grey(images[1][number], size)))
        except BrokenPair:
            continue
    return taken


_NAMES = {(True, True): "raw", (False, False): "rectified", (True, False): "raw on the left alone"}
_NAMES[False, True] = "raw on the right alone"
_HOW = {(True, True): "after rectification", (False, False): "as they are"}
_HOW |= dict.fromkeys(((True, False), (False, True)), "after rectification of one")


def _rows(reading: Rectification, images: Images) -> RowOffsets:
    return row_offsets([reading(left, right) for left, right in images])


def _convicts(said: RowOffsets, other: RowOffsets) -> bool:
    """Whether the other reading is better than the stated one beyond doubt."""
    if len(other.offset) < FEWEST:
        return False
    if len(said.offset) < FEWEST:
        return len(other.offset) > 3 * len(said.offset) + FEWEST
    if said.beyond_infinity > _BEYOND_INFINITY and other.beyond_infinity == 0.0:
        return other.spread < said.spread
    return other.spread < _SHARE * said.spread and other.spread < said.spread - _BETTER_BY


def _logged(note: str, level: int) -> str:
    log.log(level, note)
    return note
