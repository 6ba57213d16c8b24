"""SHA-256 of nested data, bit for bit: equal digests mean the same numbers of the same types in the same order."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np


class Digest:
    """A hash that grows. Mappings are taken by key, so that their order does not matter."""

    def __init__(self) -> None:
        self._sha256 = hashlib.sha256()

    def add(self, name: str, value: Any) -> None:
        """Take in a value under a name: an array, a number, text, None, or mappings, sequences, dataclasses of them.

        Numbers are taken as float64, so that a Python number and an entry of an array are the same.

        Raises
        ------
        TypeError
            It is something else.
        """
        if dataclasses.is_dataclass(value):
            value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        if isinstance(value, Mapping):
            for key in sorted(value, key=str):
                self.add(f"{name}.{key}", value[key])
        elif isinstance(value, (list, tuple)):
            for number, entry in enumerate(value):
                self.add(f"{name}.{number}", entry)
        elif value is None or isinstance(value, str):
            self._take(name, "text", repr(value).encode())
        else:
            self._take_array(name, np.asarray(value))

    def hex(self) -> str:
        """The digest so far."""
        return self._sha256.hexdigest()

    def _take_array(self, name: str, array: np.ndarray[Any, Any]) -> None:
        if array.dtype.kind not in "biuf":
            raise TypeError(f"{name} must be numbers or text, got {array.dtype}")
        if array.ndim == 0:
            array = array.astype(np.float64)
        self._take(name, f"{array.dtype.str} {array.shape}", np.ascontiguousarray(array).tobytes())

    def _take(self, name: str, kind: str, content: bytes) -> None:
        self._sha256.update(f"{name}|{kind}|{len(content)}|".encode() + content)
