"""Grey images from PNG and JPEG files, with everything checked that a decoder would hide.

OpenCV fills up what is missing in a cut file and returns it as an image, and allocates whatever size the header asks
for. So Pillow reads the size from the header first, and looks at the file to its end.
"""

from __future__ import annotations

import io
import re
import struct
import warnings
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from filters.contract.validation import first_line
from stereo_slam_env.files.folders import write_atomically
from stereo_slam_env.files.opening import NotOpened, open_regular, read_bytes
from stereo_slam_env.recording.recording import GreyImage

MAX_PIXELS = 40_000_000
"""Larger images are refused before they are decoded."""
MAX_BYTES = 256_000_000
"""Larger files are refused before they are read."""
MOST_FRAMES = 1_000_000
"""Images with a number from here on are refused: tables have a row for every number up to the last."""
_SIGNIFICANT = (10, 12, 14)
"""Bits of sensors that write values of 16 bits."""
_SAMPLE = 16
"""So many images of a camera tell how many bits its values have."""
_DAMAGE = (OSError, SyntaxError, ValueError, TypeError, LookupError, EOFError, OverflowError, struct.error, zlib.error)
"""What Pillow raises where a file is not what it says."""


class BrokenPair(ValueError):
    """A pair cannot be used.

    Parameters
    ----------
    reason : str
        A few words to count by, the same for all pairs with that fault.
    message : str
        One line that names the file and the remedy.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


def write_image(path: Path, image: GreyImage, size: tuple[int, int], number: int) -> None:
    """Write an image of a pair as PNG; one of no size was written before.

    Raises
    ------
    ValueError
        It is no grey image (H, W) uint8 of this width and height.
    """
    if image.size == 0 and path.is_file():
        return
    if image.dtype != np.uint8 or image.shape != size[::-1]:
        raise ValueError(
            f"pair {number} cannot be written to {path}: its images must be uint8 of shape {size[::-1]}, got "
            f"{image.dtype} of shape {image.shape}"
        )
    write_atomically(path, lambda stream: stream.write(png_of(image)))


def png_of(image: GreyImage) -> bytes:
    """PNG of an image (H, W) uint8; a `ValueError` where OpenCV has no such encoder."""
    done, data = cv2.imencode(".png", image)
    if not done:
        raise ValueError("OpenCV could not encode an image as PNG: install opencv-python-headless with PNG support")
    return bytes(data)


def numbered_images(folder: Path, prefix: str = "", suffix: str = "") -> dict[int, Path]:
    """The images `<prefix><digits><suffix>.png|jpg|jpeg` of a folder by their number; none where there is no folder."""
    pattern = re.compile(re.escape(prefix) + r"(\d+)" + re.escape(suffix) + r"\.(png|jpg|jpeg)", re.IGNORECASE)
    images_by_number: dict[int, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        match = pattern.fullmatch(path.name)
        if match is None:
            continue
        number = int(match[1])
        if number >= MOST_FRAMES:
            raise ValueError(f"{path} is image {number}: numbers from {MOST_FRAMES} on are refused, rename it")
        if number in images_by_number:
            raise ValueError(f"{path} and {images_by_number[number].name} are both image {number}: remove one of them")
        images_by_number[number] = path
    return images_by_number


def read_grey(path: Path, size: tuple[int, int] | None = None, shift: int = 8) -> GreyImage:
    """Grey values (H, W) of a PNG or JPEG; a `BrokenPair` names what is wrong with the file.

    Missing, cut, damaged, too large, no PNG or JPEG, or not of the width and height in `size`. Values of 16 bits are
    shifted right by `shift` bits: one number for a whole recording, see `shift_of_files`.
    """
    return as_grey(decoded_pixels(path, _content(path), size), shift)


def decoded_pixels(
    path: Path, data: bytes, size: tuple[int, int] | None = None, *, colour: bool = False
) -> NDArray[Any]:
    """Pixels (H, W) of the content of a PNG or JPEG, as `read_grey`; with `colour`, or of 16 bits, (H, W, 3) BGR."""
    pixels = _checked_size(path, data)
    if size is not None and pixels != size:
        raise BrokenPair(
            "image of another size",
            f"{path} is {pixels[0]}x{pixels[1]} where {size[0]}x{size[1]} was expected: "
            "all images of a recording must be of the size that it was calibrated for",
        )
    deep = data[:4] == b"\x89PNG" and data[24:25] == b"\x10"
    how = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR if deep or colour else cv2.IMREAD_GRAYSCALE
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), how | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None or image.shape[:2] != (pixels[1], pixels[0]) or image.dtype not in (np.uint8, np.uint16):
        raise _damaged(path, "it cannot be decoded")
    return np.asarray(image)


def as_grey(pixels: NDArray[Any], shift: int = 8, *, rgb: bool = False) -> GreyImage:
    """Grey values (H, W) uint8 of pixels (H, W), or (H, W, 3 or 4) in the order BGR or RGB, of 8 or 16 bits."""
    if pixels.ndim == 3:
        code = cv2.COLOR_RGB2GRAY if rgb else cv2.COLOR_BGR2GRAY
        pixels = np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels[..., :3]), code))
    if pixels.dtype == np.uint16:
        pixels = np.minimum(pixels >> shift, 255)
    return np.ascontiguousarray(pixels, dtype=np.uint8)


def shift_of(most: int) -> int:
    """Bits that values of 16 bits are shifted right by, where the largest of a recording is `most`: 2, 4, 6 or 8."""
    return next((bits - 8 for bits in _SIGNIFICANT if most < 1 << bits), 8)


def shift_of_files(images: tuple[Mapping[int, Path], Mapping[int, Path]]) -> int:
    """The same by some of the images of both cameras by frame number."""
    most = 0
    for side in images:
        numbers = sorted(side)
        for number in numbers[:: max(1, len(numbers) // _SAMPLE)]:
            try:
                with open_regular(side[number]) as stream:
                    head = stream.read(25)
                if head[:4] != b"\x89PNG" or head[24:25] != b"\x10":
                    return 8
                most = max(most, int(decoded_pixels(side[number], _content(side[number])).max(initial=0)))
            except (OSError, ValueError):  # met when it is read
                continue
    return shift_of(most)


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image, px; raises as `read_grey`."""
    return _checked_size(path, _content(path))


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path, most_bytes=MAX_BYTES)
    except FileNotFoundError:
        raise BrokenPair("image missing", f"{path} is missing: copy it again, or skip broken pairs") from None
    except NotOpened as error:
        raise BrokenPair("image too large" if error.too_large else "image unreadable", str(error)) from error


def _checked_size(path: Path, data: bytes) -> tuple[int, int]:
    """Width and height, after the file was looked at to its end."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # its limit is wider than ours
            with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
                width, height = image.size
                if width * height > MAX_PIXELS:
                    raise BrokenPair(
                        "image too large",
                        f"{path} says that it is {width}x{height}: "
                        f"images above {MAX_PIXELS / 1e6:.0f} million pixels are refused",
                    )
                if image.format == "PNG":
                    image.verify()  # the check sums of all parts, up to the end mark
                else:
                    image.draft("L", (1, 1))  # all of the file, an eighth of the size
                    image.load()
    except Image.DecompressionBombError as error:
        raise BrokenPair("image too large", f"{path} is too large to be decoded ({first_line(error)})") from error
    except BrokenPair:
        raise
    except UnidentifiedImageError as error:
        raise _damaged(path, "it is no whole PNG or JPEG") from error
    except _DAMAGE as error:
        raise _damaged(path, first_line(error)) from error
    return width, height


def _damaged(path: Path, what: str) -> BrokenPair:
    return BrokenPair("image damaged", f"{path} is damaged, {what}: copy it again, or skip broken pairs")
