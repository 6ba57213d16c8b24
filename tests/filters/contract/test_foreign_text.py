"""Texts of strangers do not control a terminal or a page, and an exception without words is one (0.1 s)."""

import pytest

from filters.contract.validation import MOST_CHARACTERS, first_line, plain, type_name, without_controls


class Wordless(Exception):
    def __str__(self):
        raise RuntimeError("no words")


def test_what_does_not_print_is_written_out():
    assert plain("a\x1b]0;owned\x07b \x9b2J é 漢\n") == "a\\x1b]0;owned\\x07b \\x9b2J é 漢\n"
    assert plain("abc\u202egnp.exe \ud800") == "abc\\u202egnp.exe \\ud800"


def test_a_page_keeps_its_lines_and_loses_its_controls():
    assert without_controls("a\tb\r\nc\x1b[2J\x00\u202e\ud800\xa0é") == "a\tb\r\nc�[2J���\xa0é"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("one\ntwo"), "one"),
        (ValueError("  "), "ValueError"),
        (ValueError(), "ValueError"),
        (ValueError("\x1b[31mred"), "\\x1b[31mred"),
        (Wordless(), "its message cannot be read"),
        (ValueError("x" * 10**6), "x" * MOST_CHARACTERS),
    ],
)
def test_the_first_line_of_an_exception(error, line):
    assert first_line(error) == line
    assert first_line(ValueError(), empty="no message") == "no message"
    assert type_name(type("\x1b[2J", (Exception,), {})()) == "\\x1b[2J"
