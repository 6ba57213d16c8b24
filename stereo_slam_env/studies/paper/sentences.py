"""Every checkable sentence of the paper, each with what is measured and when it counts as true."""

from __future__ import annotations

from stereo_slam_env.studies.paper import limits
from stereo_slam_env.studies.paper.claims import Sentence

_SHARE = "share of the points in the region that is meant to hold 95 %"
_THAN = f"ours over that of the rival with two bearing updates: {limits.BETTER}"
_SIGMA = "claimed sigma right to 10 %"

REGION_70M = Sentence(
    "region-70m",
    "4.1",
    "Inverse depth at 70 m: 'the red lines enclose the true uncertainty'",
    f"{_SHARE}: {limits.REGION}",
    "figure-1",
)
REGION_70M_XYZ = Sentence(
    "region-70m-xyz",
    "4.1",
    "Euclidean XYZ at 70 m: '... while blue lines do not'",
    f"{_SHARE}: {limits.NOT_REGION}",
    "figure-1",
)
REGION_ANY = Sentence(
    "region-any-distance",
    "4.1",
    "'For any distance close or far, the uncertainty region estimated by our model accurately bounds the true "
    "uncertainty'",
    f"{_SHARE}: {limits.REGION}",
    "figure-2",
)
HISTOGRAM = Sentence(
    "histogram",
    "4.1",
    "Inverse depth at 70 m: 'the red rectangles have more closely covered the true gray rectangles distribution'",
    "Kolmogorov-Smirnov distance of the depths from those claimed, XYZ minus inverse depth: at least 0",
    "figure-1",
)
UNCERTAINTY_CONVERGES = Sentence(
    "uncertainty-converges",
    "4.3, abstract",
    "'No matter the feature is either far or near, ... our proposed method depth and uncertainty converge faster': the "
    "uncertainty",
    f"claimed sigma of the depth after 10 updates, {_THAN}",
    "figure-4",
)
DEPTH_CONVERGES = Sentence(
    "depth-converges",
    "4.3",
    "'... depth and uncertainty converge faster': the depth",
    f"RMS error of the depth after 10 updates, {_THAN}",
    "figure-5",
)
DEPTH_UNCERTAINTY = Sentence(
    "depth-uncertainty",
    "abstract",
    "'Real depth uncertainty distribution of landmarks features can be accurately estimated'",
    f"NEES of the inverse depth after 10 updates: {limits.CONSISTENT} ({_SIGMA})",
    "figure-4",
)
SMOOTHER = Sentence(
    "smoother",
    "4.3, abstract",
    "'Our proposed method estimation is more stable, therefore the curve is smoother'",
    f"RMS second difference of the estimated depth over 10 updates, {_THAN}",
    "figure-5",
)
RAW_MEAN = Sentence(
    "raw-mean",
    "4.3",
    "'After 10 updates, the estimation result is also closer to the mean values of raw measurement'",
    f"distance of the estimate from the mean of the raw depths, {_THAN}",
    "figure-5",
)
TRAJECTORY = Sentence(
    "trajectory",
    "4.4",
    "'Our proposed model estimated trajectory is quite close to the groundtruth'",
    f"RMS position error, m: {limits.POSITION_M} (what the paper grants its own ground truth)",
    "figure-6",
)
DRIFT = Sentence(
    "drift",
    "abstract",
    "'We also found minor drift in the vehicle pose estimation even after extended periods'",
    f"position error at the end, % of the way: {limits.DRIFT_PERCENT}",
    "figure-6",
)
YAW = Sentence(
    "yaw",
    "4.4",
    "'The car pose and velocity can be decently estimated quite well, close to the groundtruth': the yaw",
    f"RMS error of the yaw, degrees: {limits.YAW_DEG}",
    "figure-6",
)
VELOCITY = Sentence(
    "velocity",
    "4.4",
    "'The car pose and velocity can be decently estimated quite well, close to the groundtruth': Vx and Vz",
    f"RMS error of Vx and Vz, m/s: {limits.VELOCITY_M_S}",
    "figure-6",
)
SCALE = Sentence(
    "scale",
    "5",
    "'Even in large-scale outdoor environment, there is only a little scale drift'",
    f"RMS difference of estimated and true length of the way, %: {limits.SCALE_PERCENT}",
    "figure-6",
)
CONSISTENT = Sentence(
    "consistent",
    "4.1, 5",
    "'The proposed observation models ... worked consistently under the strict requirement of EKF framework'",
    f"pose NEES / 6, and NIS by its degrees of freedom: {limits.CONSISTENT} ({_SIGMA})",
    "figure-nees",
)
LANDMARK_NOISE = Sentence(
    "landmark-noise",
    "5",
    "'Our observation model together with inverse depth parameterization has kept true to the real noise distribution "
    "of the landmark feature'",
    f"landmark NEES / 3 in (u, v, d): {limits.CONSISTENT} ({_SIGMA})",
    "figure-nees",
)
RANGE_HELPS = Sentence(
    "range-helps",
    "5",
    "'The additional range information has helped'",
    f"RMS position error, {_THAN} (rival 1 px an eye)",
    "figure-nees",
)
XYZ_INCONSISTENT = Sentence(
    "xyz-inconsistent",
    "1",
    "XYZ: 'true distributions of faraway features are non-Gaussian, which makes the EKF filter estimation "
    "inconsistent'",
    f"pose NEES / 6 of the XYZ filter with the right R: {limits.INCONSISTENT}",
    "figure-nees",
)
FASTER = Sentence(
    "faster",
    "5",
    "'Our new observation model is also computationally faster than the ... binocular stereo-based approach'",
    f"time of predict + update, {_THAN}",
    "figure-speed",
)
ONE_UPDATE = Sentence(
    "one-update",
    "5",
    "'We only have to do projection and update in the EKF framework once, in contrast to the binocular approach which "
    "requires projection and update two times each'",
    "projections and updates in a frame: 1 of ours, 2 of the rival",
    "figure-speed",
)
