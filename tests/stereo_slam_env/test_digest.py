"""Equal digests mean equal bits (< 1 s)."""

from dataclasses import dataclass

import numpy as np
import pytest

from .digest import Digest


def digest(value):
    made = Digest()
    made.add("value", value)
    return made.hex()


@dataclass
class Pair:
    a: float
    b: tuple


SAMPLE = {"a": np.arange(6.0), "b": [1.0, {"c": "text", "d": None}], "e": Pair(np.nan, (True, 2))}


def test_the_same_data_has_the_same_digest_in_whatever_order():
    again = {"e": Pair(np.nan, (True, 2)), "b": [1.0, {"d": None, "c": "text"}], "a": np.arange(6.0)}
    assert digest(SAMPLE) == digest(again)


def test_a_number_is_the_same_by_itself_and_out_of_an_array():
    assert digest(0.1) == digest(np.array([0.1])[0])
    assert digest(3) == digest(np.int64(3))


@pytest.mark.parametrize(
    "other",
    [
        {**SAMPLE, "a": np.nextafter(np.arange(6.0), 7.0)},
        {**SAMPLE, "a": np.arange(6.0).reshape(2, 3)},
        {**SAMPLE, "a": np.arange(6.0).astype(np.float32)},
        {**SAMPLE, "a": -np.arange(6.0)[::-1]},
        {**SAMPLE, "b": [{"c": "text", "d": None}, 1.0]},
        {**SAMPLE, "e": Pair(np.nan, (True, 3))},
        {**SAMPLE, "f": None},
        {key: value for key, value in SAMPLE.items() if key != "a"},
    ],
)
def test_other_data_has_another_digest(other):
    assert digest(other) != digest(SAMPLE)


def test_minus_zero_is_not_zero():
    assert digest(-0.0) != digest(0.0)


def test_what_has_no_bits_of_its_own_is_refused():
    with pytest.raises(TypeError, match=r"value\.a must be numbers or text"):
        digest({"a": object()})
