"""Small texts that would fill the memory, or take for ever, are refused in a line (2 s)."""

import json
import time

import pytest

from fuzz.harness import limited_memory
from stereo_slam_env.files.readers import parse_toml, read_json
from stereo_slam_env.files.yaml_files import MOST_DEPTH, parse_yaml
from stereo_slam_env.sensing.rig_files import read_calibration

MOST_SECONDS = 1.0
NESTED = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(9 * ['*' + chr(97 + k)])}]\n" for k in range(8)
)
YAML = {
    "nested anchors": NESTED,
    "an alias of itself": "a: &a [*a]\n",
    "an anchor alone": "a: &a 1\n",
    "merged again and again": "m0: {a: 1}\n" + "".join(f"m{k}:\n  <<: [{{a: 1}}, {{b: 1}}]\n" for k in range(40)),
    "a merge key": "a:\n  <<: {b: 1}\n",
    "a merge key of a flow": "a: {<<: {b: 1}}\n",
    "deep": f"a: {'[' * 5_000}\n",
    "deep maps": f"a: {'{b: ' * (MOST_DEPTH + 1)}1{'}' * (MOST_DEPTH + 1)}\n",
    "deep blocks": "".join(f"{k * ' '}a:\n" for k in range(400)),
    "many entries": f"a: [{'1,' * 250_000}1]\n",
    "a long number": f"a: {'9' * 100_000}\n",
    "a long number to the base of 16": f"a: 0x{'f' * 100_000}\n",
    "a tag with a base": "a: !!int 1:59:59\n",
    "a tag of Python": "a: !!python/object/apply:os.system ['true']\n",
    "a set": "a: !!set {b, c}\n",
    "bytes": "a: !!binary aGVsbG8=\n",
    "two documents": "a: 1\n---\nb: 2\n",
    "a list as a key": "? [a]\n: 1\n",
    "too long": f"a: {'x' * 6_000_000}\n",
}


@pytest.mark.parametrize("name", YAML)
def test_yaml(name, tmp_path):
    (tmp_path / "rig.yaml").write_text(YAML[name])
    for read in (lambda: parse_yaml(YAML[name]), lambda: read_calibration(tmp_path / "rig.yaml")):
        began = time.process_time()
        with limited_memory(300_000_000), pytest.raises(ValueError, match=r"\A[^\n]+\Z"):
            read()
        assert time.process_time() - began < MOST_SECONDS


def test_numbers_with_colons_are_texts():
    began = time.process_time()
    long = f"1{200_000 * ':59'}"
    found = parse_yaml(f"a: 1:30\nb: 1:30.5\nc: -1:2:3\nd: {long}\n")
    assert found == {"a": "1:30", "b": "1:30.5", "c": "-1:2:3", "d": long}
    assert time.process_time() - began < MOST_SECONDS


def test_what_calibrations_consist_of_is_read():
    text = """
cam0:
  T: [[1.0, 0, 0, -1e-3], [0.0, 1, 0, .5]]
  model: pinhole  # a remark
  rostopic: "/cam0/image_raw"
  good: true
  none:
  size: [752, 480]
  text: |
    two
    lines
  hex: 0x10
  nan: .nan
"""
    found = parse_yaml(text)["cam0"]
    assert found["T"] == [[1.0, 0, 0, "-1e-3"], [0.0, 1, 0, 0.5]]  # a float of YAML 1.1 has a dot
    assert (found["model"], found["rostopic"], found["good"]) == ("pinhole", "/cam0/image_raw", True)
    assert (found["none"], found["size"], found["text"]) == (None, [752, 480], "two\nlines\n")
    assert found["hex"] == 16
    assert found["nan"] != found["nan"]  # noqa: PLR0124: that is NaN


@pytest.mark.parametrize(
    "text",
    [
        f"a{'.a' * 20_000} = 1\n",
        f"[a{'.a' * 20_000}]\n",
        f"a{' . b' * 5_000} = 1\n",
        '"a"' + 5_000 * ".'b'" + " = 1\n",
        f"x = {{a{'.a' * 20_000} = 1}}\n",
        f"a = {'[' * 50_000}\n",
        f"a = {'{b=' * 50_000}\n",
        f"a = {'9' * 100_000}\n",
    ],
    ids=lambda text: text[:12],
)
def test_toml(text):
    began = time.process_time()
    with limited_memory(300_000_000), pytest.raises(ValueError, match=r"\A[^\n]+\Z"):
        parse_toml(text)
    assert time.process_time() - began < MOST_SECONDS


def test_ordinary_toml_is_read():
    assert parse_toml("a.b.c = 1\n[d]\ne = [0.1, 0.2]\n") == {"a": {"b": {"c": 1}}, "d": {"e": [0.1, 0.2]}}
    assert len(parse_toml(f"a = [{'0.5, ' * 1000}]\n")["a"]) == 1000


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, "[" + 6_000_000 * "[]," + "[]]", '{"a":' * 100_000, "9" * 100_000, "[" + 6_000_000 * "1," + "1]"],
    ids=["deep", "lists", "deep maps", "digits", "many"],
)
def test_json(text, tmp_path):
    (tmp_path / "a.json").write_text(text)
    began = time.process_time()
    with limited_memory(300_000_000), pytest.raises(ValueError, match=r"\A[^\n]*a\.json[^\n]*\Z"):
        read_json(tmp_path / "a.json")
    assert time.process_time() - began < MOST_SECONDS
    (tmp_path / "a.json").write_text(json.dumps({"a": [1, 2]}))
    assert read_json(tmp_path / "a.json") == {"a": [1, 2]}
