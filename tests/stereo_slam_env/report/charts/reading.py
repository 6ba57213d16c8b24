"""What a chart says, read from its specification: the panels with their layers, curves and words."""

from __future__ import annotations

import numpy as np

MARKS = {"lines": "line", "dots": "point", "intervals": "rule", "bands": "area", "boxes": "rect", "texts": "text"}


class ReadPanel:
    """One panel of a chart."""

    def __init__(self, chart, view):
        self._data, self._view = chart.spec["datasets"], view
        self.title = next((row["text"] for row in self.rows("texts") if row["bold"]), "")
        encoding = next(layer["encoding"] for layer in view["layer"] if layer["mark"]["type"] != "text")
        self.x, self.y = (encoding[name]["scale"]["domain"] for name in ("x", "y"))
        self.size = view["width"], view["height"]

    def layers(self, kind):
        shown = [layer for layer in self._view["layer"] if layer["mark"]["type"] == MARKS[kind]]
        return [layer for layer in shown if layer["mark"].get("opacity") != 0]

    def rows(self, kind):
        return [row for layer in self.layers(kind) for row in self._data[layer["data"]["name"]]]

    def curves(self, kind="lines"):
        """By key, the last one of each."""
        return {row["key"]: row for row in self.rows(kind)}

    def words(self):
        return [row["text"] for row in self.rows("texts")]


def panels(chart):
    return [ReadPanel(chart, view) for view in chart.spec["concat"]]


def values(row, name="y"):
    return np.array([np.nan if value is None else value for value in row[name]])


def series_of(chart):
    return {entry["name"]: entry["colour"] for entry in chart.series}
