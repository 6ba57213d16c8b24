"""Grey images from PNG and JPEG files, with everything checked that a decoder would hide.

Decoders fill up what is missing in a cut file and return it as an image, and allocate whatever size the header asks
for. So the size is read from the header first, and the file is walked through to its end mark.
"""

from __future__ import annotations

import re
import stat
import zlib
from pathlib import Path

import cv2
import numpy as np

from stereo_slam_env.datasets.broken import BrokenPair
from stereo_slam_env.recording.image_sequence import GreyImage

MAX_PIXELS = 40_000_000
"""Larger images are refused before they are decoded."""

MAX_BYTES = 256_000_000
"""Larger files are refused before they are read."""

MOST_FRAMES = 1_000_000
"""Images with a number from here on are refused: tables have a row for every number up to the last."""

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_SIZED_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_WITHOUT_LENGTH = {0x01, *range(0xD0, 0xD9)}
_END_OF_SCAN = 0xD9
_START_OF_SCAN = 0xDA


def numbered_images(folder: Path, prefix: str = "") -> dict[int, Path]:
    """The images `<prefix><digits>.png|jpg|jpeg` of a folder by their number; empty where there is no folder.

    Raises
    ------
    ValueError
        Two files have the same number, or one of them a number that no recording comes to.
    """
    pattern = re.compile(re.escape(prefix) + r"(\d+)\.(png|jpg|jpeg)", re.IGNORECASE)
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        match = pattern.fullmatch(path.name)
        if match is None:
            continue
        number = int(match[1])
        if number >= MOST_FRAMES:
            raise ValueError(f"{path} is image {number}: numbers from {MOST_FRAMES} on are refused, rename it")
        if number in found:
            raise ValueError(f"{path} and {found[number].name} are both image {number}: remove one of them")
        found[number] = path
    return found


def read_grey(path: Path, size: tuple[int, int] | None = None) -> GreyImage:
    """Read an image as grey values.

    Parameters
    ----------
    path : Path
        PNG or JPEG, grey or colour.
    size : (int, int), optional
        Width and height that it must have, px.

    Returns
    -------
    (H, W) uint8

    Raises
    ------
    BrokenPair
        Missing, cut, damaged, of another size, too large, or no PNG or JPEG: one line that names the file.
    """
    data = _content(path)
    found = _checked_size(path, data)
    if size is not None and found != size:
        raise BrokenPair(
            "image of another size",
            f"{path} is {found[0]}x{found[1]} where {size[0]}x{size[1]} was expected: "
            "all images of a recording must be of the size that it was calibrated for",
        )
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None or image.shape != (found[1], found[0]) or image.dtype != np.uint8:
        raise _damaged(path, "it cannot be decoded")
    return np.asarray(image, dtype=np.uint8)


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image, px; raises as `read_grey`."""
    return _checked_size(path, _content(path))


def _content(path: Path) -> bytes:
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise _damaged(path, "it is no file")
        if found.st_size > MAX_BYTES:
            raise BrokenPair("image too large", f"{path} has {found.st_size} bytes: more than {MAX_BYTES} are refused")
        data = path.read_bytes()
    except FileNotFoundError:
        raise BrokenPair("image missing", f"{path} is missing: copy it again, or skip broken pairs") from None
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise BrokenPair("image unreadable", f"{path} cannot be read ({reason}): check the file") from error
    if not data:
        raise _damaged(path, "it is empty")
    return data


def _checked_size(path: Path, data: bytes) -> tuple[int, int]:
    if data.startswith(_PNG):
        size = _png_size(path, data)
    elif data.startswith(_JPEG):
        size = _jpeg_size(path, data)
    else:
        raise _damaged(path, "it is no PNG and no JPEG")
    width, height = size
    if width < 1 or height < 1:
        raise _damaged(path, f"its header says {width}x{height}")
    if width * height > MAX_PIXELS:
        raise BrokenPair(
            "image too large",
            f"{path} says that it is {width}x{height}: images above {MAX_PIXELS / 1e6:.0f} million pixels are refused",
        )
    return size


def _png_size(path: Path, data: bytes) -> tuple[int, int]:
    """Width and height, after every chunk up to the end mark was found whole."""
    size, at = None, len(_PNG)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        kind, end = data[at + 4 : at + 8], at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise _damaged(path, f"the check sum of a part ({kind.decode('latin-1')}) is wrong")
        if size is None:
            if kind != b"IHDR" or length != 13:
                raise _damaged(path, "it has no header")
            size = int.from_bytes(data[at + 8 : at + 12], "big"), int.from_bytes(data[at + 12 : at + 16], "big")
        if kind == b"IEND":
            return size
        at = end
    raise _cut(path, len(data))


def _jpeg_size(path: Path, data: bytes) -> tuple[int, int]:
    """Width and height, after the end mark was found behind the first scan."""
    size, at = None, len(_JPEG)
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            raise _damaged(path, "its parts do not follow each other")
        marker = data[at + 1]
        if marker == 0xFF or marker in _WITHOUT_LENGTH:
            at += 1 if marker == 0xFF else 2
            continue
        if marker in _SIZED_FRAMES and at + 9 <= len(data):
            size = int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        if marker == _START_OF_SCAN:
            # Inside a scan 0xFF is always followed by 0, so this can only be the end mark.
            if data.find(bytes([0xFF, _END_OF_SCAN]), at) < 0:
                break
            if size is None:
                raise _damaged(path, "it has no header")
            return size
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    raise _cut(path, len(data))


def _cut(path: Path, length: int) -> BrokenPair:
    return _damaged(path, f"it is cut off after {length} bytes")


def _damaged(path: Path, what: str) -> BrokenPair:
    return BrokenPair("image damaged", f"{path} is damaged, {what}: copy it again, or skip broken pairs")
