"""The notebooks run from top to bottom, the exercises are found, and results show themselves as HTML (slow: 3 min)."""

import json
import os
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import stereo_slam_env as sse
from filters import check_filter
from stereo_slam_env.recording.notebook_html import lines_chart

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.timeout(500)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, monkeypatch):
    nbclient = pytest.importorskip("nbclient", reason="the extra notebooks is not installed")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    notebook = nbformat.read(path, 4)
    nbclient.NotebookClient(
        notebook, timeout=400, kernel_name="python3", resources={"metadata": {"path": str(path.parent)}}
    ).execute()
    assert all(
        "error" not in output.get("output_type", "") for cell in notebook.cells for output in cell.get("outputs", [])
    )


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_is_stored_with_its_results_and_names_no_place(path):
    text = path.read_text(encoding="utf-8")
    notebook = json.loads(text)
    assert len(text) < 200_000
    assert any(cell.get("outputs") for cell in notebook["cells"])
    assert not re.search(r"/home/|/tmp/|/root/|Traceback", text)
    assert "pip install" in "".join(notebook["cells"][1]["source"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("First", "overconfident (mean pose NEES / dof 33, expected 1)"),
        ("Second", "moves it by velocity times dt"),
        ("Third", "The pose follows the truth where measurements are nearly exact"),
        ("Fourth", "forecast S less the noise R is not positive definite"),
        ("Fifth", "its errors are not many times those of inverse-depth"),
    ],
)
def test_the_error_of_an_exercise_is_found(name, said, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    import exercises

    report = check_filter(getattr(exercises, name), raise_on_failure=False)
    sys.modules.pop("exercises")
    assert any(said in line for line in report.failed), report


def test_the_sheet_marks_itself(monkeypatch):
    """Right answers get all points, wrong and missing ones none."""
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    import exercises
    import solutions

    right = {name: answer for name, (answer, *_) in solutions.NUMBERS.items()}
    right["3a"] = {name: word for name, (word, _) in solutions.PLANTED.items()}
    assert set(right["3a"]) == {one.__name__ for one in exercises.ALL}
    assert solutions.marks(right)["total"] == 17.0
    assert solutions.marks(right, "inverse-depth")["total"] == 20.0
    wrong = {name: 2.0 * answer for name, (answer, *_) in solutions.NUMBERS.items()}
    assert solutions.marks({**wrong, "3a": {"First": "dt"}})["total"] == 0.0
    assert solutions.marks({})["total"] == 0.0
    for module in ("exercises", "solutions"):
        sys.modules.pop(module)


class Checked(HTMLParser):
    """Every element that is opened is closed."""

    def __init__(self):
        super().__init__()
        self.open, self.seen = [], []

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.seen.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def shown(result):
    checked = Checked()
    checked.feed(result._repr_html_())
    checked.close()
    assert not checked.open
    return result._repr_html_(), checked.seen


def test_results_show_themselves():
    comparison = sse.compare(["inverse-depth", "right-invariant"], "reference-turn", seeds=2, frames=6)
    text, seen = shown(comparison)
    assert "pose NEES / 6" in text
    assert "Pose NEES / 6, mean of 2 runs" in text  # within a notebook, too, where a console would show it elsewhere
    shown(comparison.verdict)
    text, seen = shown(sse.make_recording("reference-turn", 0))
    assert "1344x391 px" in text
    assert seen.count("svg") == 3


def test_at_a_prompt_results_are_what_fits_on_a_screen():
    recording = sse.make_recording("reference-turn", 0)
    evaluation = sse.evaluate("inverse-depth", recording)
    comparison = sse.compare(["inverse-depth", "right-invariant"], "reference-turn", seeds=2, frames=6)
    for result in (recording, evaluation, comparison):
        assert len(repr(result)) < 4000
    assert "position error, m" in repr(comparison)


def test_a_reference_from_the_same_images_is_not_called_the_truth():
    recording = sse.make_recording("reference-turn", 0)
    assert "true path" in shown(recording)[0]
    text, _ = shown(replace(recording, truth_from=sse.Reference("odometry", "Poses of the same images.")))
    assert "path of the reference" in text
    assert "true" not in text


def test_many_lines_of_a_chart_are_told_apart_and_their_names_do_not_meet():
    lines = {f"filter {k}": (np.arange(3.0), np.full(3, float(k))) for k in range(12)}
    drawn = lines_chart(lines, "s", "m")
    strokes = re.findall(r'<polyline [^>]*(stroke="[^"]*")[^>]*(stroke-dasharray="[^"]*")', drawn)
    assert len(set(strokes)) == 12
    heights = [float(y) for y in re.findall(r'<text [^>]*y="([0-9.]+)"[^>]*>filter', drawn)]
    assert np.diff(heights).min() >= 11.0
    assert max(heights) < float(re.search(r'<svg [^>]*height="([0-9]+)"', drawn)[1])


def test_names_of_strangers_are_text_and_no_markup():
    times = np.arange(5.0)
    poses = np.column_stack([times, times**2, times]), np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
    score = sse.evaluate_trajectory(
        sse.Trajectory(*poses, times, name="<script>alert(1)</script>"), sse.Trajectory(*poses, times, name="truth")
    )
    text, seen = shown(score)
    assert "&lt;script&gt;" in text
    assert "script" not in seen
