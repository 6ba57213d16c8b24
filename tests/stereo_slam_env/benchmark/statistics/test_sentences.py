"""Sentences are templates with values handed in: each is used, each that is named exists, and each reads well (2 s)."""

import ast
import re
from pathlib import Path

import pytest
from jinja2 import UndefinedError

import stereo_slam_env
from stereo_slam_env.benchmark.statistics.policy_verdict import judge_policies
from stereo_slam_env.benchmark.statistics.remarks import innovation_remarks
from stereo_slam_env.benchmark.statistics.sentences import sentence
from stereo_slam_env.benchmark.statistics.verdict import judge

from .test_situations import ALL, BOLD, CLUMSY, FAIR, GOOD, SHY, situation

ROOT = Path(stereo_slam_env.__file__).parent
SOURCE = (ROOT / "benchmark/statistics/sentences.jinja").read_text(encoding="utf-8")
TEMPLATES = set(re.findall(r"{% macro (\w+)", SOURCE))


GAPS = re.compile(r"\s\s|\n|\s[,.;:)]|\(\s|\.\.|[,;:]\.|\bNone\b(?! came)|Undefined|\bnan\b")
NAMES = {"good", "fair", "clumsy", "bold", "shy"}
ANSWERS = {"first_lost", "best", "consistent", "limit", "cost"}  # by name of the question, of `Verdict.answers`


def templates_named_in_code():
    calls = (node for path in ROOT.rglob("*.py") for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    calls = (node for node in calls if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "sentence")
    return {call.args[0].value for call in calls if isinstance(call.args[0], ast.Constant)}


def test_every_template_is_used_and_every_name_has_one():
    called_inside = {name for name in TEMPLATES if len(re.findall(rf"\b{name}\(", SOURCE)) > 1}
    named = templates_named_in_code() | ANSWERS
    assert named <= TEMPLATES
    assert named | called_inside == TEMPLATES


def test_an_unknown_value_is_an_error_and_no_gap_in_a_sentence():
    with pytest.raises(UndefinedError, match="failures"):
        sentence("lost", object())


@pytest.mark.parametrize(("count", "frames", "lost", "failed"), ALL[::5])
def test_sentences_have_no_gaps_and_end_with_a_full_stop(count, frames, lost, failed):
    summaries, figures = situation((GOOD, FAIR, CLUMSY, BOLD, SHY), count, frames, lost, failed, bounds=True)
    verdict, policies = judge(summaries, figures), judge_policies(summaries, figures, baseline="good")
    said = [verdict.headline, *verdict.answers.values(), policies.headline]
    said += [comparison.words for comparison in policies.comparisons.values()] + innovation_remarks(summaries)
    for text in said:
        assert text.endswith(".")
        assert not GAPS.search(text), text
        begins = re.findall(r"(?:^|\. )(\w+)", text)
        assert all(word[0].isupper() or word[0].isdigit() or word in NAMES for word in begins), text
