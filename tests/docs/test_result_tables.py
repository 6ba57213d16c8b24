"""Tables of the manual that are made from packets of results (< 1 s)."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

exceptions = pytest.importorskip("mkdocs.exceptions", reason="needs the extra docs")

ROOT = Path(__file__).resolve().parents[2]
spec = importlib.util.spec_from_file_location("result_tables", ROOT / "docs" / "hooks" / "result_tables.py")
hook = importlib.util.module_from_spec(spec)
spec.loader.exec_module(hook)


def made(line, page="page.md"):
    return hook.table(hook.LINE.fullmatch(f"<!-- table: {line} -->"), page).splitlines()


def test_a_row_has_the_figures_of_the_packet_and_the_options_of_the_filter():
    packet = json.loads((ROOT / "results" / "reference-turn.json").read_text(encoding="utf-8"))
    nees = packet["cells"][0]["trials"]["euclidean"]["pose_anees"]
    head, _, row, _, made_from = made("reference-turn filters=euclidean columns=nees,rmse")
    assert head == "|  | pose NEES / 6 | position RMSE, m |"
    assert row.startswith(f"| `euclidean min_disparity=5.0` | {sum(nees) / len(nees) / 6:#.3g} | ")
    assert made_from.startswith("*50 drives, from `results/reference-turn.json`; `stereo-slam verify ")


def test_policies_have_intervals():
    _, _, row, *_ = made("active_policies filters=ppo columns=final_error,true")
    assert row == "| `ppo` | 0.419 | -26.9 (-31.3 to -22.5) |"


@pytest.mark.parametrize(
    "line",
    ["nothing columns=nees", "real cell=moon columns=nees", "limits filters=mine columns=nees", "limits columns=smell"],
)
def test_an_unknown_name_is_an_error_of_one_line(line):
    with pytest.raises(exceptions.PluginError, match=r"^page\.md: <!-- table: .* --> has no \w+ '\w+', but .*\Z"):
        made(line)


def test_each_table_of_the_manual_can_be_made():
    lines = [
        (path, line)
        for path in sorted((ROOT / "docs").rglob("*.md"))
        for line in re.findall(r"<!-- table:.*", path.read_text(encoding="utf-8"))
    ]
    assert len(lines) > 2
    for path, line in lines:
        assert len(hook.table(hook.LINE.fullmatch(line), path.name).splitlines()) > 4
