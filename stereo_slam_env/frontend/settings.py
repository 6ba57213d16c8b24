"""Settings of the front end."""

from __future__ import annotations

from dataclasses import dataclass

from filters.contract.validation import finite_array, positive, whole_number
from stereo_slam_env.recording.recording import ImageSequence

_POSITIVE = (
    "nearest",
    "min_disparity",
    "max_radius",
    "min_distance",
    "sigma_acceleration",
    "sigma_angular_acceleration",
    "sigma_floor",
    "sigma_relief",
)

DRIFT_SHARE = 0.42
"""Step that a tracked point makes on its surface from pair to pair, as a share of the standard deviation of its
measurement: sqrt(2 (1 - r)) is 0.37 and 0.47 for the correlations r = 0.93 and 0.89 of the errors of u and v of two
pairs (docs/front_end.md)."""


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of detection, tracking and termination of landmarks; a method that has no use for one leaves it."""

    method: str = "active-search"
    """Name of the front end, one of `available_front_ends()`."""
    model: str | None = None
    """File of the network of a learned method, which OpenCV loads."""
    matcher_model: str | None = None
    """File of a network that matches its features (LightGlue); None: mutual nearest neighbours."""
    max_landmarks: int = 100
    """Most landmarks given to the filter in one pair."""
    refill_below: int = 85
    """New ones are looked for when fewer than this are left."""
    nearest: float = 2.5
    """Least depth of a new landmark, m."""
    min_disparity: float = 1.0
    """Least disparity of a new landmark, px."""
    min_score: float = 0.8
    """Least normalised correlation of a match, 0 to 1."""
    uniqueness: float = 0.92
    """Most that the second best peak may have of the best one's correlation."""
    search_gate: float = 0.99
    """Probability with which a landmark lies inside the ellipse that is searched."""
    max_radius: float = 24.0
    """Half axis of the largest ellipse that is searched, px; where a forecast is less certain, the front end's own is
    taken."""
    gate: float = 0.999
    """Probability with which a standing landmark passes the test against the motion of the scene."""
    max_misses: int = 2
    """Most pairs in a row without a match: a landmark that is missed in one more is dropped."""
    movers: bool = False
    """Whether landmarks that move unlike the scene are given to the filter, besides `max_landmarks` others: for filters
    with moving bodies."""
    margin: int = 8
    """Distance to the edge of both images, px."""
    min_distance: float = 10.0
    """Between a new landmark and any other in the left image, px."""
    sigma_acceleration: float = 3.0
    """By how much the velocity may change between pairs, m/s^2 (as `filters.ConstantVelocity`)."""
    sigma_angular_acceleration: float = 0.6
    """By how much the angular velocity may change between pairs, rad/s^2."""
    disparity_offset: float = 0.0
    """Added to every measured disparity, px: what the rectification left, see `frontend.calibration`."""
    disparity_offset_sigma: float = 0.0
    """Standard deviation of that offset, px, for filters that estimate what is left of it."""
    sigma_floor: float = 0.05
    """No pixel coordinate is believed to better than this, px. Enough for images of a camera or of `gl`, not for those
    of `tiny`: see `settings_for`."""
    image_blur: float = 0.0
    """Variance of the point spread of the images along an axis, px^2. A patch that is magnified to be found again has
    its blur magnified, too, and would match displaced; what this says of it is taken away. 0: nothing is."""
    sigma_relief: float = 0.04
    """How far a patch is from the plane that it is taken for, m along the ray: the more its landmark has moved by
    parallax, in time or between the cameras, the more that displaces a match."""

    def __post_init__(self) -> None:
        lowest = {"max_landmarks": 1, "refill_below": 0, "max_misses": 0, "margin": 8}
        for name, low in lowest.items():
            whole_number(name, getattr(self, name), low)
        if not isinstance(self.movers, bool):
            raise ValueError(f"movers must be True or False, got {self.movers!r}")
        if self.refill_below > self.max_landmarks:
            most = f"max_landmarks = {self.max_landmarks}"
            raise ValueError(f"refill_below must be at most {most}, got {self.refill_below}")
        finite_array("disparity_offset", self.disparity_offset, ())
        for name in ("image_blur", "disparity_offset_sigma"):
            positive(name, getattr(self, name), allow_zero=True)
        for name in _POSITIVE:
            positive(name, getattr(self, name))
        for name in ("min_score", "uniqueness", "search_gate", "gate"):
            value = getattr(self, name)
            if not (isinstance(value, float | int) and 0.0 < value < 1.0):
                raise ValueError(f"{name} must be between 0 and 1, got {value!r}")


def settings_for(sequence: ImageSequence) -> TrackerSettings:
    """Settings for images: those of who drew them (the attribute `front_end` of the sequence), else the usual ones."""
    stated: TrackerSettings | None = getattr(sequence, "front_end", None)
    return TrackerSettings() if stated is None else stated
