"""Changes in words: signed numbers and percentages, as every sentence and table prints them."""

from __future__ import annotations

from collections.abc import Sequence

_MOST_DIGITS = 1e6


def signed(value: float, digits: int = 0) -> str:
    """With its sign, as in print: "+1,200", "−3"; what is rounded to zero has none."""
    if abs(value) >= _MOST_DIGITS:
        return f"{value:+.1e}".replace("-", "−")
    text = f"{value:+,.{digits}f}"
    return (text if any(digit in text for digit in "123456789") else text[1:]).replace("-", "−")


def percent_words(percent: float, more: str = "larger", less: str = "smaller") -> str:
    """A change in percent, in words: "20 % larger", "1,200 % larger", "4 % smaller"."""
    size = abs(percent)
    amount = f"{size:.1e}" if size >= _MOST_DIGITS else f"{size:,.{0 if size >= 10.0 else 1}f}"
    return f"{amount} % {less if percent < 0.0 else more}"


def listed(words: Sequence[str]) -> str:
    """Words in a sentence: "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]
