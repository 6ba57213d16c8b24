"""Grey values of the messages Image and CompressedImage, in whatever encoding, with one scale for a recording."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters.contract.validation import plain
from stereo_slam_env.datasets.image_files import MAX_PIXELS, BrokenPair, as_grey, decoded_pixels, shift_of
from stereo_slam_env.recording.recording import GreyImage

_CHANNELS = {
    **dict.fromkeys(("mono8", "8UC1", "mono16", "16UC1"), 1),
    **dict.fromkeys(("bgr8", "rgb8", "8UC3", "bgr16", "rgb16", "16UC3"), 3),
    **dict.fromkeys(("bgra8", "rgba8", "8UC4", "bgra16", "rgba16", "16UC4"), 4),
    **dict.fromkeys(("yuv422", "uyvy", "yuv422_yuy2", "yuyv"), 2),
    **{f"bayer_{pattern}{bits}": 1 for pattern in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)},
}
"""Numbers of a pixel by encoding."""
_BAYER = {"rggb": "BayerBG2GRAY", "bggr": "BayerRG2GRAY", "gbrg": "BayerGR2GRAY", "grbg": "BayerGB2GRAY"}
"""OpenCV's names, by the pixels of the second row and column."""
Pixels = NDArray[Any]
"""Of 8 or 16 bits."""


def grey_of(message: Any, size: tuple[int, int], what: str, shift: int = 8) -> GreyImage:
    """Grey values (H, W) of a `sensor_msgs/Image`; a `BrokenPair` that begins with `what` says why it is none.

    Values of 16 bits are shifted right by `shift` bits: one number for a whole recording, see `shift_of_messages`.
    """
    found = int(message.width), int(message.height)
    pixels = _pixels(message, what)
    if found != size:
        said = f"{what} is {found[0]}x{found[1]} where CameraInfo says {size[0]}x{size[1]}: calibrate for these images"
        raise BrokenPair("image of another size", said)
    return _grey(pixels, str(message.encoding), shift)


def grey_of_compressed(message: Any, size: tuple[int, int], path: Path, shift: int = 8) -> GreyImage:
    """The same of a `sensor_msgs/CompressedImage`, with `path` for messages; its `format` says what its pixels are."""
    encoding = _encoding_of(message)
    pixels = decoded_pixels(path, bytes(message.data), size, colour=encoding.startswith("bayer_"))
    return _grey(pixels, encoding, shift)


def size_of_message(message: Any, path: Path) -> tuple[int, int]:
    """Width and height of either, px."""
    if hasattr(message, "format"):
        height, width = decoded_pixels(path, bytes(message.data)).shape[:2]
        return width, height
    return int(message.width), int(message.height)


def shift_of_messages(messages: Iterable[Any], what: str) -> int:
    """Bits by which values of 16 bits are shifted right, so that those of all these messages fit into 8."""
    most = 0
    for message in messages:
        try:
            if hasattr(message, "format"):
                pixels = decoded_pixels(Path(what), bytes(message.data))
            else:
                pixels = _pixels(message, what)
        except BrokenPair:  # met when it is read
            continue
        if pixels.dtype == np.uint8:
            return 8
        most = max(most, int(pixels.max(initial=0)))
    return shift_of(most)


def _encoding_of(message: Any) -> str:
    """Encoding of decoded pixels by the format: `bayer_rggb8; png compressed`, `rgb8; jpeg compressed bgr8`, `jpeg`."""
    of_source, _, rest = str(message.format).partition(";")
    target = rest.partition("compressed")[2].strip()
    return target or of_source.strip()


def _pixels(message: Any, what: str) -> Pixels:
    """(H, W) or (H, W, channels) of an uncompressed image, 8 or 16 bits."""
    encoding, width, height = str(message.encoding), int(message.width), int(message.height)
    channels = _CHANNELS.get(encoding)
    if channels is None:
        known = ", ".join(_CHANNELS)
        raise BrokenPair("image unreadable", f"{what} has the encoding {plain(encoding)!r}: known are {known}")
    wide = re.search(r"16", encoding) is not None
    of_row = width * channels * (2 if wide else 1)
    step, data = int(message.step), np.asarray(message.data, dtype=np.uint8)
    if width * height > MAX_PIXELS or step < of_row or data.size < step * height:
        raise BrokenPair("image damaged", f"{what} has {data.size} bytes, too few for its size: record it again")
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :of_row])
    if wide:
        rows = rows.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    return rows if channels == 1 else rows.reshape(height, width, channels)


def _grey(pixels: Pixels, encoding: str, shift: int) -> GreyImage:
    import cv2

    if encoding in ("yuv422", "uyvy"):
        return np.ascontiguousarray(pixels[..., 1], dtype=np.uint8)
    if encoding in ("yuv422_yuy2", "yuyv"):
        return np.ascontiguousarray(pixels[..., 0], dtype=np.uint8)
    if encoding.startswith("bayer_") and pixels.ndim == 2:
        code = getattr(cv2, f"COLOR_{_BAYER.get(encoding[6:10], 'BayerBG2GRAY')}")
        pixels = cv2.cvtColor(np.ascontiguousarray(pixels), code)
    return as_grey(pixels, shift, rgb=encoding.startswith("rgb"))
