"""Checks of arguments and names, and texts of strangers made fit to print.

A check raises one `ValueError` that names the argument, the value and the remedy; an unknown name gets the nearest
known one. Names, messages and fields of files may hold what a terminal obeys, and an exception of somebody's code may
raise even when it is asked for its message: whatever is shown or stored of them goes through here.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from html import escape
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from filters.geometry.arrays import FloatArray, IntArray

Made = TypeVar("Made")
_ROUNDING = 1e-15
"""Of the norm of a quaternion that has been normalised: it keeps its bits."""


def unchecked(kind: type[Made], **fields: Any) -> Made:
    """An instance of a frozen dataclass without the checks and copies of its `__post_init__`.

    For values that were just computed from checked ones and that nobody else holds: arrays become read-only.
    """
    instance = object.__new__(kind)
    for value in fields.values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    vars(instance).update(fields)
    return instance


def finite_array(name: str, value: ArrayLike, shape: tuple[int | str, ...]) -> FloatArray:
    """Return `value` as a read-only float64 copy of the wanted shape.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like
        What the caller passed.
    shape : tuple of int or str
        Wanted shape; a string stands for any length (it is only shown in the message).

    Raises
    ------
    ValueError
        Not numeric, wrong shape, NaN or infinite.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be numeric with shape {_shown(shape)}, got {value!r}") from error
    if array.ndim == len(shape) and array.size == 0 and "M" in shape:
        array = array.reshape([0 if isinstance(n, str) else n for n in shape])
    wrong = len(array.shape) != len(shape) or any(
        isinstance(expected, int) and expected != got for expected, got in zip(shape, array.shape, strict=True)
    )
    if wrong:
        raise ValueError(f"{name} must have shape {_shown(shape)}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity: remove or mask those entries first")
    array.flags.writeable = False
    return array


def positive(name: str, value: Any, *, allow_zero: bool = False) -> float:
    """Return `value` as a finite float > 0 (or >= 0)."""
    bound = ">= 0" if allow_zero else "> 0"
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be a number {bound}, got {value!r}") from error
    if not math.isfinite(number) or number < 0 or (number == 0 and not allow_zero):
        raise ValueError(f"{name} must be a finite number {bound}, got {value!r}")
    return number


def finite_number(name: str, value: Any) -> float:
    """Return `value` as a finite float."""
    number = not isinstance(value, bool) and isinstance(value, float | int | np.number)
    if not number or not abs(value) <= sys.float_info.max:  # a whole number can be larger
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return float(value)


def whole_number(name: str, value: Any, low: int, high: int | None = None) -> int:
    """Return `value`, an int from `low` to `high` (None: no upper limit)."""
    if isinstance(value, bool) or not isinstance(value, int) or value < low or (high is not None and value > high):
        range_words = f">= {low}" if high is None else f"from {low} to {high}"
        raise ValueError(f"{name} must be a whole number {range_words}, got {value!r}")
    return value


def probability(name: str, value: Any) -> float:
    """Return `value` as a float from 0 to 1."""
    if isinstance(value, bool) or not isinstance(value, float | int | np.number) or not 0.0 <= value <= 1.0:
        raise ValueError(f"{name} must be a probability from 0 to 1, got {value!r}")
    return float(value)


def gate_probability(value: Any) -> float | None:
    """Return the probability of a gate, between 0 and 1, or None for no gate."""
    if value is not None and not (isinstance(value, float | int) and 0.0 < value < 1.0):
        raise ValueError(f"gate must be a probability between 0 and 1, or None for no gate, got {value!r}")
    return value


def covariance_matrix(
    name: str, value: ArrayLike, size: int, *, batch: int | None = None, definite: bool = False
) -> FloatArray:
    """Return `value` as a symmetric positive (semi-)definite matrix, or a batch of them.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : array_like, (size, size) or (batch, size, size)
        Covariance.
    size : int
        Rows of one matrix.
    batch : int, optional
        Number of matrices; None for a single one.
    definite : bool
        Refuse singular matrices too.
    """
    shape: tuple[int | str, ...] = (size, size) if batch is None else (batch, size, size)
    matrix = finite_array(name, value, shape)
    scale = np.abs(matrix).max(axis=(-2, -1), initial=0.0)
    asymmetry = np.abs(matrix - np.swapaxes(matrix, -1, -2)).max(axis=(-2, -1), initial=0.0)
    if (asymmetry > 1e-9 * scale).any():
        raise ValueError(f"{name} must be symmetric: average it with its transpose first")
    try:
        np.linalg.cholesky(matrix)  # far cheaper than eigenvalues
        return matrix
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(matrix)[..., 0]
    if (smallest < -1e-12 * scale).any() or (definite and (smallest <= 0).any()):
        property_words = "definite" if definite else "semi-definite"
        raise ValueError(f"{name} must be positive {property_words}, smallest eigenvalue is {smallest.min():.3g}")
    return matrix


def at_most(name: str, values: ArrayLike, limit: float, unit: str) -> None:
    """Refuse numbers that are larger in size than `limit`: beyond it no filter is tested."""
    largest = np.abs(values).max(initial=0.0)
    if largest > limit:
        raise ValueError(f"{name} must be at most {limit:g} {unit} in size, got {largest:.3g}: check its unit")


def unit_quaternion(name: str, value: ArrayLike) -> FloatArray:
    """Return `value` (xyzw) normalised; refuses anything whose norm is not 1 to 1e-3."""
    quaternion = finite_array(name, value, (4,))
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > 1e-3:
        raise ValueError(f"{name} must be a unit quaternion (xyzw), got norm {norm:.6g}: normalise it")
    return quaternion if abs(norm - 1.0) < _ROUNDING else quaternion / norm


def unique_ids(name: str, value: ArrayLike) -> IntArray:
    """Return `value` as a read-only (M,) int64 array without repetitions."""
    raw = np.asarray(value)
    if raw.ndim != 1:
        raise ValueError(f"{name} must have shape (M,), got {raw.shape}")
    if raw.size == 0:
        raw = raw.astype(np.int64)
    if raw.dtype.kind not in "iu":
        raise ValueError(f"{name} must be integers (int64), got dtype {raw.dtype}")
    ids = raw.astype(np.int64)
    ordered = np.sort(ids)
    again = ordered[1:] == ordered[:-1]
    if again.any():
        repeated = np.unique(ordered[1:][again])[:5].tolist()
        raise ValueError(f"{name} must be unique, repeated: {repeated}: keep one measurement per landmark")
    ids.flags.writeable = False
    return ids


def _shown(shape: tuple[int | str, ...]) -> str:
    return "(" + ", ".join(str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"


def did_you_mean(word: object, known: Iterable[object]) -> str:
    """`, did you mean 'x'?` with the nearest of the `known` words, or nothing where none is near.

    Parameters
    ----------
    word : object
        What somebody wrote.
    known : iterable
        What there is.
    """
    near = get_close_matches(str(word), [str(name) for name in known], n=1)
    return f", did you mean {near[0]!r}?" if near else ""


def require_known(subject: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise a `ValueError` for the first of the `given` names that is not `known`.

    Parameters
    ----------
    subject : str
        How the message begins: "the reader has no option".
    given : iterable of str
        Names somebody wrote.
    known : iterable of str
        Names there are.
    """
    names = list(known)
    for name in given:
        if name not in names:
            raise ValueError(
                f"{subject} {name!r}{did_you_mean(name, names) or '.'} Known: {', '.join(names) or 'none'}"
            )


def one_of(name: str, value: object, allowed: Collection[object]) -> None:
    """Raise a `ValueError` if the argument `name` has a `value` that is not `allowed`."""
    if not any(value == choice and type(value) is type(choice) for choice in allowed):
        raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")


MOST_CHARACTERS = 2000
"""Longer lines are cut."""
_MOST_READ = 100_000
_NAME: Any = vars(type)["__name__"]
_CONTROLS = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def plain(text: str) -> str:
    """The text with every character that does not print written out in ASCII; line ends stay."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def without_controls(document: str) -> str:
    """A page with a replacement character for what controls a terminal or turns the direction of a text around."""
    return _CONTROLS.sub("\N{REPLACEMENT CHARACTER}", document)


def markdown(text: str) -> str:
    """The text for a line or a cell of a table in Markdown: no markup in it is one."""
    return re.sub(r"([\\|\[\]`])", r"\\\1", escape(" ".join(plain(text).split()), quote=False))


def first_line(error: BaseException, *, empty: str | None = None) -> str:
    """First line of an exception's message, plain; of an empty one `empty`, or its type."""
    try:
        text = str.__getitem__(str(error), slice(_MOST_READ))  # its own __str__ may return a text of a class of its own
    except BaseException:  # ... or raise anything
        text = "its message cannot be read"
    lines = text.strip().splitlines()
    if not lines:
        return type_name(error) if empty is None else empty
    return plain(lines[0][:MOST_CHARACTERS])


def type_name(error: BaseException) -> str:
    """Name of an exception's type, plain."""
    name: str = _NAME.__get__(type(error))  # a metaclass may give `__name__` a meaning of its own
    return plain(name[:MOST_CHARACTERS])


def error_line(error: BaseException) -> str:
    """Type and message of an exception in a line."""
    return f"{type_name(error)}: {first_line(error, empty='no message')}"
