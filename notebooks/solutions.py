"""Solutions of the exercises, and marks for what students hand in. Leave this file out of what you hand out.

    python notebooks/solutions.py answers.json                        # {"1a": 1.0, ..., "3a": {"First": "S", ...}}
    python notebooks/solutions.py answers.json student:MyFilter       # 3b: the filter that they wrote

Prints the points of each exercise as JSON.
"""

import json
import sys
from pathlib import Path

from filters import check_filter
from stereo_slam_env.benchmark import resolve_callable

NUMBERS = {
    "1a": (4.0, 3.0, 5.0, 2),
    "1b": (0.8, 0.79, 0.81, 2),
    "2a": (16.5, 16.0, 17.0, 2),
    "2b": (103.0, 100.0, 106.0, 2),
    "6a": (0.25, 0.2, 0.3, 2),
    "6b": (25.0, 22.0, 28.0, 2),
}
"""Exercise -> the answer, the smallest and the largest that count, and points."""
PLANTED = {
    "First": ("R", "R is a 25th of the truth: the filter is overconfident."),
    "Second": ("dt", "dt is taken in milliseconds."),
    "Third": ("baseline", "The baseline is 5 % too long, so that everything is farther away and faster."),
    "Fourth": ("S", "S has no R: it is the covariance of the prediction, not of the innovation."),
    "Fifth": ("process noise", "There is almost no process noise: the filter cannot follow a turn."),
}
"""3a: filter -> the word that names its error (a point each), and why."""
FILTER_POINTS = 3
"""3b: for a filter that passes all checks, else the share of them that it passes."""


def marks(answers, student_filter=None):
    """Points by exercise, and their sum under "total"; an exercise without an answer has none."""
    points = {}
    for exercise, (_, low, high, most) in NUMBERS.items():
        answer = answers.get(exercise)
        right = isinstance(answer, int | float) and low <= answer <= high
        points[exercise] = float(most if right else 0)
    words = answers.get("3a", {})
    points["3a"] = float(
        sum(str(words.get(name, "")).strip().lower() == word.lower() for name, (word, _) in PLANTED.items())
    )
    points["3b"] = 0.0
    if student_filter is not None:
        report = check_filter(student_filter, raise_on_failure=False)
        points["3b"] = round(FILTER_POINTS * len(report.passed) / (len(report.passed) + len(report.failed)), 2)
    return {**points, "total": round(sum(points.values()), 2)}


def main(arguments):
    """Print the marks of a file of answers and, perhaps, of a class at MODULE:CLASS."""
    sys.path.insert(0, "")
    answers = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    student_filter = resolve_callable("the filter must be MODULE:CLASS", arguments[1]) if len(arguments) > 1 else None
    print(json.dumps(marks(answers, student_filter), indent=2))


if __name__ == "__main__":
    main(sys.argv[1:])
