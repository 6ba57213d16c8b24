"""The pictures of the manual are those that `docs/images/make.py` draws today (8 min; without the slow ones 5 s)."""

import importlib
import json
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

pytest.importorskip("torch", reason="needs the extra rl")
pytest.importorskip("moderngl", reason="needs the extra gl")
pytest.importorskip("rerun", reason="needs the extra viewer")

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
sys.path.insert(0, str(IMAGES))
try:
    names = ("pictures_of_concepts", "make", "pictures_of_runs")
    concepts, make, runs = (importlib.import_module(name) for name in names)
finally:
    sys.path.remove(str(IMAGES))

TOO_OLD = "is not what is drawn today: python docs/images/make.py"
BLOCK = 16
"""px; the mean over a block differs little between two machines, and much where a word or a line is another."""
LARGEST_DIFFERENCE, MOST_BLOCKS = 15.0, 0.001
SLOWER = 5.0
"""A time a frame that is out by more than this factor is not one of another machine, but of another filter."""


def grey(path):
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert picture is not None, path
    return picture


def share_of_blocks_that_differ(one, other):
    """Of two pictures of the same size."""
    size = one.shape[1] // BLOCK, one.shape[0] // BLOCK
    means = [cv2.resize(picture.astype(np.float32), size, interpolation=cv2.INTER_AREA) for picture in (one, other)]
    return float((np.abs(means[0] - means[1]) > LARGEST_DIFFERENCE).mean())


def numbers_and_words(path):
    """Of an SVG file."""
    text = path.read_text(encoding="utf-8")
    return np.array([float(x) for x in re.findall(r"-?\d+\.\d+", text)]), re.findall(r"<text[^>]*>(.*?)</text>", text)


def is_blank(path):
    picture = grey(path)
    return picture.std() < 5.0 or len(np.unique(picture)) < 20


def test_every_picture_is_drawn_by_the_command_and_shown_by_a_page():
    assert {path.name for path in IMAGES.glob("*.*") if path.suffix != ".py"} == set(make.PICTURES)
    pages = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")))
    assert [name for name in make.PICTURES if f"images/{name})" not in pages] == []


@pytest.mark.parametrize("name", [name for name in make.PICTURES if not name.endswith(".svg")])
def test_no_picture_is_blank(name):
    assert not is_blank(IMAGES / name)


def test_what_says_that_a_picture_is_another_or_blank_can_say_so(tmp_path):
    """A word of a heading is exchanged; a picture is empty."""
    today = grey(IMAGES / "view.png")
    changed = today.copy()
    changed[90:110, 1220:1300] = 255
    cv2.putText(changed, "The way", (1220, 106), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 0, 2)
    assert share_of_blocks_that_differ(today, today) == 0.0
    assert share_of_blocks_that_differ(today, changed) > 0.0
    Image.new("RGB", (200, 100), "white").save(tmp_path / "white.png")
    assert is_blank(tmp_path / "white.png")


@pytest.mark.slow
@pytest.mark.parametrize("name", make.REPEATABLE)
def test_a_picture_that_can_be_repeated_is_that_of_today(name, tmp_path):
    make.draw(name, tmp_path / name)
    if name.endswith(".svg"):
        (drawn, words), (stored, old_words) = map(numbers_and_words, (tmp_path / name, IMAGES / name))
        assert words == old_words, TOO_OLD
        assert len(drawn) == len(stored), TOO_OLD
        assert np.abs(drawn - stored).max(initial=0.0) < 0.5, TOO_OLD
    else:
        drawn, stored = grey(tmp_path / name), grey(IMAGES / name)
        assert drawn.shape == stored.shape, TOO_OLD
        assert share_of_blocks_that_differ(drawn, stored) <= MOST_BLOCKS, TOO_OLD


@pytest.mark.slow
@pytest.mark.parametrize("name", make.OF_RUNS)
def test_a_picture_of_a_run_can_be_drawn(name, tmp_path):
    """By a short run. The report says the same as the stored picture in its first table, and the same time a frame."""
    try:
        make.draw(name, tmp_path / name, small=True)
    except runs.NoBrowser as reason:
        pytest.skip(str(reason))
    assert not is_blank(tmp_path / name)
    if name == "report.png":
        (drawn, stored) = (Image.open(path / name).text for path in (tmp_path, IMAGES))
        # The line below a question depends on the runs: on which filter is best, on whether there are enough of them.
        asked, was_asked = ([text.split("\n")[0] for text in json.loads(one[runs.HEADINGS])] for one in (drawn, stored))
        assert asked == was_asked, TOO_OLD
        times, old_times = (json.loads(texts[runs.MILLISECONDS]) for texts in (drawn, stored))
        assert times.keys() == old_times.keys(), TOO_OLD
        for name_of_filter, milliseconds in times.items():
            assert old_times[name_of_filter] / SLOWER < milliseconds < old_times[name_of_filter] * SLOWER, TOO_OLD


def test_a_far_landmark_tells_the_orientation_and_a_new_one_nothing_of_the_pose():
    """What the page says of the figure."""
    gains = concepts.look_gains()
    near, _, far, new = gains["position"]
    assert gains["position"][near] > 10 * gains["position"][far]
    assert gains["orientation"][far] > 5 * gains["orientation"][near]
    assert abs(gains["orientation"][new]) < 0.01 > abs(gains["position"][new])
    assert gains["pose and map"][new] > 0
