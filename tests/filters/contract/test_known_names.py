"""The hint about an unknown word."""

import pytest

from filters.contract.validation import did_you_mean, require_known


def test_the_nearest_known_word_is_named_or_none():
    assert did_you_mean("sgima", ["sigma", "share"]) == ", did you mean 'sigma'?"
    assert did_you_mean("wxyz", ["sigma", "share"]) == ""
    assert did_you_mean(3, ["sigma"]) == ""


def test_the_first_unknown_name_is_refused_with_the_known_ones():
    require_known("there is no", ["a", "b"], ["b", "a"])
    with pytest.raises(ValueError, match=r"there is no 'sgima', did you mean 'sigma'\? Known: sigma, share"):
        require_known("there is no", ["share", "sgima", "x"], ["sigma", "share"])
    with pytest.raises(ValueError, match=r"there is no 'x'\. Known: none"):
        require_known("there is no", ["x"], [])
