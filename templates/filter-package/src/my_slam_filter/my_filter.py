"""A filter to start from.

It composes the engine's parts. Change the parts first; to change the mathematics, override a method, or derive from
`filters.StereoFilter` and implement its members: nothing else is known of a filter anywhere in the bench.
"""

from __future__ import annotations

from typing import Any

from filters import StereoCamera, StereoEKF, StereoNoise


class MyFilter(StereoEKF):
    """Both eyes' pixels in one update, on the SO(3) error state, landmarks of a frame sharing their anchor.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d).
    **options
        Others of `filters.StereoEKF`: motion, gate, iterations, drop_unseen, ...
    """

    def __init__(self, camera: StereoCamera, noise: StereoNoise, **options: Any) -> None:
        parts = {"landmark": "shared-anchor", "measurement": "stacked", "error": "so3"}
        super().__init__(camera, noise, **{**parts, **options})
