"""KITTI pose files of made-up drives."""

import numpy as np


def write_poses(path, positions, headings):
    """Positions (K, 2) as (x, z) in m and headings (K,) in rad, positive to the right; returns the path."""
    cos, sin, zero, one = np.cos(headings), np.sin(headings), np.zeros(len(headings)), np.ones(len(headings))
    rows = np.column_stack([cos, zero, sin, positions[:, 0], zero, one, zero, zero, -sin, zero, cos, positions[:, 1]])
    np.savetxt(path, rows, fmt="%.9e")
    return path


def drive(speeds, yaw_rates, period):
    """Integrate speeds (K,) and yaw rates (K,): positions (K + 1, 2) and headings (K + 1,)."""
    headings = np.concatenate([[0.0], np.cumsum(yaw_rates * period)])
    middle = 0.5 * (headings[1:] + headings[:-1])
    steps = (speeds * period)[:, None] * np.stack([np.sin(middle), np.cos(middle)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), headings


def figure_eight(period):
    """Two circles of 16 m radius, one to the right and one to the left, with 30 m straights: crosses itself."""
    speed, rate = 6.0, 6.0 / 16.0
    turn = round(2 * np.pi * 0.75 / (rate * period))
    ahead = np.zeros(round(5.0 / period))
    rates = np.concatenate([ahead, np.full(turn, rate), ahead, np.full(turn, -rate), ahead])
    return drive(np.full(len(rates), speed), rates, period)


def there_and_back(period):
    """60 m ahead, round on a circle of 8 m radius, and back along the same street."""
    speed, rate = 5.0, 5.0 / 8.0
    half = round(np.pi / (rate * period))
    ahead = np.zeros(round(12.0 / period))
    rates = np.concatenate([ahead, np.full(half, rate), ahead])
    return drive(np.full(len(rates), speed), rates, period)
