"""The hint about an unknown word."""

from filters.suggestions import did_you_mean


def test_the_nearest_known_word_is_named_or_none():
    assert did_you_mean("sgima", ["sigma", "share"]) == ", did you mean 'sigma'?"
    assert did_you_mean("wxyz", ["sigma", "share"]) == ""
    assert did_you_mean(3, ["sigma"]) == ""
