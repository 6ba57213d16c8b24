"""A rate for each landmark against a random walk of each landmark, for tracked points that slide.

    python benchmarks/sliding_points.py            # one minute

One line, so that the best filter is known: a camera on it measures how far each point is, px. A point slides at a rate
that is forgotten over ten frames (`CORRELATION` is that of residuals one frame apart on KITTI 07), and the measurement
adds a white error. Points are followed for `LIFE` frames on average and then replaced, as in a drive. Kalman filters
know the motion model of the camera and differ in what they believe of the points:

    white     points that stay, errors of 2 px (the plain filter)
    walk      points that walk, with the variance that the slide adds over many frames (`LandmarkDrift`)
    rate      points with a rate of their own as a second number of the state: the truth

Error and NEES (1 is ideal) of the motion of the camera over 10 and 100 frames, which is all that a map which is
replaced can know, with standard errors over the seeds.
"""

from __future__ import annotations

import math

import numpy as np

from filters.geometry.arrays import FloatArray
from harness import show

POINTS, FRAMES, SEEDS, LIFE = 70, 300, 40, 12
STEP, CORRELATION, KEEP = 0.33, 0.8, math.exp(-0.1)
RATE = STEP * math.sqrt(CORRELATION / KEEP)
"""Standard deviation of a rate, px a frame, with which residuals one frame apart have that correlation."""
WHITE = math.sqrt(max(STEP**2 - RATE**2, 0.01) / 2.0)
LASTING = RATE * math.sqrt((1.0 + KEEP) / (1.0 - KEEP))
SPEED_CHANGE = 3.0
"""Of the camera, px a frame: vision has to find it."""
WINDOWS = (10, 100)


class Line:
    """Kalman filter of the camera (place, and copies of it at the start of the windows) and of the points."""

    def __init__(self, model: str) -> None:
        self.model, self.each = model, 2 if model == "rate" else 1
        self.fixed = 1 + len(WINDOWS)
        self.x = np.zeros(self.fixed + self.each * POINTS)
        self.P = np.zeros((len(self.x), len(self.x)))
        self.white = 2.0 if model == "white" else WHITE
        self.at = self.fixed + self.each * np.arange(POINTS)

    def copy(self, window: int) -> None:
        """The start of a window is here."""
        k = 1 + window
        self.x[k], self.P[k] = self.x[0], self.P[0]
        self.P[:, k] = self.P[:, 0]
        self.P[k, k] = self.P[0, 0]

    def predict(self) -> None:
        """The camera goes anywhere, and the points do what the model says."""
        self.P[0, 0] += SPEED_CHANGE**2
        if self.model == "walk":
            self.P[self.at, self.at] += LASTING**2
        if self.model == "rate":
            F = np.eye(len(self.x))
            F[self.at, self.at + 1] = 1.0
            F[self.at + 1, self.at + 1] = KEEP
            self.x, self.P = F @ self.x, F @ self.P @ F.T
            self.P[self.at + 1, self.at + 1] += RATE**2 * (1.0 - KEEP**2)

    def update(self, z: FloatArray, new: FloatArray) -> None:
        """Measure the points that are known, then start the new ones at what is measured."""
        known = np.flatnonzero(~new)
        H = np.zeros((len(known), len(self.x)))
        H[np.arange(len(known)), self.at[known]], H[:, 0] = 1.0, -1.0
        HP = H @ self.P
        K = np.linalg.solve(HP @ H.T + self.white**2 * np.eye(len(known)), HP).T
        self.x = self.x + K @ (z[known] - H @ self.x)
        self.P = self.P - K @ HP
        self.P = 0.5 * (self.P + self.P.T)
        for place, value in zip(self.at[new], z[new], strict=True):
            self.P[place : place + self.each], self.P[:, place : place + self.each] = 0.0, 0.0
            self.x[place], self.P[place], self.P[:, place] = self.x[0] + value, self.P[0], self.P[:, 0]
            self.P[place, place] = self.P[0, 0] + self.white**2
            if self.each == 2:
                self.x[place + 1] = 0.0
                self.P[place + 1, place + 1] = RATE**2


def squares(model: str, seed: int) -> FloatArray:
    """Mean squared errors, px^2, and NEES of the motion over the windows, (2, windows)."""
    rng, line = np.random.default_rng(seed), Line(model)
    place, starts = 0.0, np.zeros(len(WINDOWS))
    points, rates = rng.uniform(-100.0, 100.0, POINTS), RATE * rng.normal(size=POINTS)
    new, found = np.ones(POINTS, dtype=bool), [[] for _ in WINDOWS]
    for frame in range(FRAMES + 1):
        if frame:
            place += SPEED_CHANGE * rng.normal()
            points += rates
            rates = KEEP * rates + RATE * math.sqrt(1.0 - KEEP**2) * rng.normal(size=POINTS)
            new = rng.random(POINTS) < 1.0 / LIFE
            points[new], rates[new] = place + rng.uniform(-100.0, 100.0, new.sum()), RATE * rng.normal(size=new.sum())
            line.predict()
        line.update(points - place + WHITE * rng.normal(size=POINTS), new)
        for k, window in enumerate(WINDOWS):
            if frame % window == 0:
                if frame:
                    error = line.x[0] - line.x[1 + k] - (place - starts[k])
                    variance = line.P[0, 0] + line.P[1 + k, 1 + k] - 2.0 * line.P[0, 1 + k]
                    found[k].append((error**2, error**2 / variance))
                line.copy(k)
                starts[k] = place
    return np.array([np.mean(rows, axis=0) for rows in found]).T


def main() -> None:
    """Run and print."""
    rows = []
    for model in ("white", "walk", "rate"):
        runs = np.array([squares(model, seed) for seed in range(SEEDS)])
        mean, error = runs.mean(axis=0), runs.std(axis=0, ddof=1) / math.sqrt(SEEDS)
        rms = np.sqrt(mean[0])
        shown = [(rms, error[0] / (2.0 * rms)), (mean[1], error[1])]
        cells = [f"{value[k]:.2f} ± {spread[k]:.2f}" for k in range(len(WINDOWS)) for value, spread in shown]
        rows.append((model, *cells))
    heads = ("points", *(f"{of}, {n}" for n in WINDOWS for of in ("rms px", "NEES")))
    show(f"{POINTS} points that slide by {RATE:.2f} px a frame, {SEEDS} seeds", heads, rows)


if __name__ == "__main__":
    main()
