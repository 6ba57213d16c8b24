"""Entries of calibrations in YAML and JSON: numbers, sizes, transforms and lenses, each checked where it stands."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.validation import first_line, plain
from filters.geometry.arrays import FloatArray
from stereo_slam_env.files.readers import read_json, read_text
from stereo_slam_env.files.yaml_files import parse_yaml
from stereo_slam_env.sensing.lenses import Lens, LensModel, require_rotation

Size = tuple[int, int]
MOST_BYTES = 300_000
"""Larger calibrations are refused: no rig has so many numbers."""
MOST_PIXELS = 40_000_000
"""Images of more are refused."""
_MODELS: Mapping[str, LensModel] = {
    **dict.fromkeys(("radtan", "radtan4", "radtan5", "radial-tangential", "plumb_bob"), "radial-tangential"),
    **dict.fromkeys(("rational_polynomial", "pinhole", "none", ""), "radial-tangential"),
    **dict.fromkeys(("equidistant", "equi", "equid4", "kannalabrandt8", "fisheye", "opencv_fisheye"), "equidistant"),
    **dict.fromkeys(("kannala_brandt", "kannala_brandt4", "kb4"), "equidistant"),
}


def table_of(path: Path) -> dict[str, Any]:
    """Content of a YAML or JSON file; what OpenCV writes beyond YAML is taken out."""
    if path.suffix == ".json":
        content = read_json(path)
    else:
        text = re.sub(r"^%YAML.*$|!!opencv-\w+", "", read_text(path, most_bytes=MOST_BYTES), flags=re.MULTILINE)
        try:
            content = parse_yaml(text)
        except ValueError as error:
            raise ValueError(f"{path} is no YAML that is read ({error}): take the calibration again") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds no entries 'name: value': take the calibration again")
    return {str(key): value for key, value in content.items()}


def first_of(table: Mapping[str, Any], *names: str) -> Any:
    """Value of the first of these entries that is there; None: of none."""
    return next((table[name] for name in names if name in table), None)


def numbers_of(path: Path, table: Mapping[str, Any], names: str | Sequence[str], *counts: int) -> FloatArray:
    """The numbers of the first of these entries, flat, of one of these counts (none: of any)."""
    names = (names,) if isinstance(names, str) else names
    value = first_of(table, *names)
    if value is None:
        raise ValueError(f"{path} lacks '{names[0]}': take the calibration of this rig")
    value = value.get("data", value) if isinstance(value, dict) else value
    try:
        numbers = np.array(list(_flat(value)), dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"{path}: '{names[0]}' holds no numbers ({first_line(error)}): correct it") from error
    if counts and numbers.size not in counts:
        counts_words = " or ".join(map(str, counts))
        raise ValueError(f"{path}: '{names[0]}' has {numbers.size} numbers where {counts_words} were expected")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{path}: '{names[0]}' has NaN or infinity: take the calibration again")
    return numbers


def _flat(value: Any) -> Iterator[float]:
    if isinstance(value, list):
        for one in value:
            yield from _flat(one)
    else:
        yield float(value)


def size_of(path: Path, table: Mapping[str, Any], names: Sequence[str], given: Size | None) -> Size:
    """Width and height of the images, px: as given, or by one of these entries."""
    if given is None and first_of(table, *names) is None and "image_width" not in table:
        raise ValueError(f"{path} does not say the size of the images: give width and height with it")
    if given is not None:
        width, height = given
    elif first_of(table, *names) is not None:
        width, height = (int(n) for n in numbers_of(path, table, names, 2))
    else:
        width, height = (int(numbers_of(path, table, name, 1)[0]) for name in ("image_width", "image_height"))
    if width < 1 or height < 1 or width * height > MOST_PIXELS:
        raise ValueError(f"{path}: resolution {width}x{height} is none of an image that is read: correct it")
    return width, height


def lens_of(path: Path, intrinsics: FloatArray, size: Size, distortion: FloatArray, model: Any) -> Lens:
    """A lens of (fx, fy, cx, cy) or K (9), px."""
    name = plain(str(model)).strip().lower().replace("_tangential", "-tangential")
    if name not in _MODELS:
        models = ", ".join(models for models in _MODELS if models)
        raise ValueError(f"{path}: the lens model {name!r} cannot be rectified by OpenCV; known are {models}")
    fx, fy, cx, cy = (float(n) for n in (intrinsics if intrinsics.size == 4 else intrinsics[[0, 4, 2, 5]]))
    if _MODELS[name] == "equidistant" and not any(distortion[4:]):
        distortion = distortion[:4]  # drivers fill up what the message has room for
    try:
        return Lens(fx, fy, cx, cy, *size, tuple(map(float, distortion)), _MODELS[name])
    except ValueError as error:
        raise ValueError(f"{path}: {error}: take the calibration again") from error


def transform_of(path: Path, table: Mapping[str, Any], name: str) -> FloatArray:
    """(4, 4) of an entry; a `ValueError` where it holds no rotation."""
    T = numbers_of(path, table, name, 16).reshape(4, 4)
    require_rotation(T[:3, :3], str(path), name)
    return T
