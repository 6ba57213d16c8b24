"""The table of figures: name, heading, unit and meaning of each, its value of one run and its value over runs.

A figure is declared here and nowhere else. Summaries, `summary.json`, the trial table, the console, the tables of the
reports, the comparison of filters and the manual are loops over `FIGURES`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import POSITION, ROTATION
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.bands import DOF, landmark_anees, nis_per_dof, pooled
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.trajectory_metrics import mean, root_mean_square
from stereo_slam_env.evaluation.trial import Sample, Trial
from stereo_slam_env.evaluation.windows import WINDOWS, series_of

Value: TypeAlias = float | int | str | None
Group = Literal["trial", "accuracy", "claim", "consistency", "bodies", "cost", "events"]
Place = Literal["brief", "console", "report"]
Kind = Literal["real", "integer", "text"]

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
UNKNOWN = "–"
"""Shown in place of a figure that is not known."""


@dataclass(frozen=True)
class Combination:
    """Combination of a figure over runs: in words, and the function of a sample and the figure's name."""

    words: str
    of: Callable[[Sample, str], float | None]
    of_values: Callable[[FloatArray], float] = mean
    """The same of the values of the runs alone, where nothing else of them is kept."""


@dataclass(frozen=True)
class Figure:
    """One figure of merit."""

    name: str  # key in `summary.json` and the trial table, attribute of `FilterSummary`
    # What tables call it, and the unit of its values; either may be empty.
    heading: str
    unit: str
    group: Group  # the table it stands in
    meaning: str  # what it is, and when it is null
    # Value of one `Trial`; None: it is one of many runs only, and has no column in the trial table.
    of_run: Callable[[Trial], Value] | None = None
    over_runs: Combination | None = None  # None: it is one of single runs only, and not in the summary
    kind: Kind = "real"  # of its values of one run; of a run that failed, an integer is 0, everything else None
    of_failed: bool = False  # whether it is computed of a run that failed, too
    digits: int = 3  # after the point, and at least so many that count
    per_runs: bool = False  # whether it counts runs: "2 of 10"
    # The value that a consistent filter has; tables then show value / ideal. None: the smaller the better.
    ideal: float | None = None
    larger_is_better: bool = False  # whether it is an efficiency
    # Whether filters are compared by their ratio; False: by their difference, because it is a logarithm already.
    is_ratio: bool = True
    compared: bool = False  # whether comparisons of filters are about it
    # Where it is shown: also where there is little room ("brief"), on the console, in the tables of a report.
    places: tuple[Place, ...] = ("console", "report")

    @property
    def is_optional(self) -> bool:
        """Whether it is left out where it is not known, as if it did not exist: figures of moving bodies."""
        return self.group == "bodies"

    @property
    def label(self) -> str:
        """The heading, with what values are divided by: "pose NEES / 6"."""
        return self.heading if self.ideal in (None, 1.0) else f"{self.heading} / {self.ideal:g}"

    @property
    def title(self) -> str:
        """Label and unit: "position error, m"."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def of(self, figures: FilterSummary | Mapping[str, Any]) -> float:
        """The value in a summary or in the figures of a run, as tables show it; NaN where it is not known."""
        values = figures.figures if isinstance(figures, FilterSummary) else figures
        return self.shown(values.get(self.name))

    def shown(self, value: Value) -> float:
        """The value as tables show it, by its ideal; NaN where it is not known."""
        return float("nan") if value is None else float(value) / (self.ideal or 1.0)

    @property
    def column(self) -> str:
        """Name in tables of data, whose values are those that are shown: "pose_anees_per_dof"."""
        return self.name if self.ideal in (None, 1.0) else f"{self.name}_per_dof"

    @property
    def column_meaning(self) -> str:
        """Meaning of that column."""
        of = self.ideal
        return self.meaning if of in (None, 1.0) else f"{self.meaning}; here by {of:g}, so 1 is ideal"

    def in_unit(self, value: Value) -> Value:
        """The value as such a table has it; None where it is not known."""
        return value if value is None or self.ideal in (None, 1.0) else self.shown(value)

    def text(self, value: Value) -> str:
        """The shown value with its digits, or a dash."""
        return self.text_of(self.shown(value))

    def text_of(self, shown: float) -> str:
        """A value as it is shown, with its digits: more where they would leave nothing of a small one; or a dash."""
        if not np.isfinite(shown):
            return UNKNOWN
        size = abs(shown)
        if size == 0.0 or 1e-4 <= size < 1e4:
            place = int(np.floor(np.log10(size))) if size else 0  # of the first digit that counts
            return f"{shown:.{max(self.digits, max(self.digits, 1) - 1 - place) if place < 0 else self.digits}f}"
        return readable(shown, f".{max(self.digits, 1) - 1}e")


def readable(value: float | None, form: str = ".3g") -> str:
    """A number for people: two digits from 10,000 on (17,000), no exponents but as in print (1.7·10⁹, 3.2·10⁻⁵)."""
    if value is None or np.isnan(value):
        return UNKNOWN
    text = f"{value:.1e}" if abs(value) >= 1e4 else format(value, form)
    mantissa, exponential, exponent = text.partition("e")
    if not exponential or not np.isfinite(value):
        return text
    if 100.0 <= abs(float(text)) < 1e7:
        return f"{float(text):,.0f}"
    return f"{mantissa}·10{str(int(exponent)).translate(_RAISED)}"


# ---- of one run -----------------------------------------------------------------------------------------------------


def trial_figures(trial: Trial) -> dict[str, Value]:
    """The row of one run in the trial table: its figures, in the order of `FIGURES`.

    What does not apply is None, or left out if it is optional; of a run that failed, that is all but its events and
    alarms.
    """
    values = {figure: _value(figure, trial) for figure in trial_columns()}
    return {figure.name: value for figure, value in values.items() if value is not None or not figure.is_optional}


def trial_columns() -> list[Figure]:
    """Figures of single runs: the columns of the trial table."""
    return [figure for figure in FIGURES.values() if figure.of_run is not None]


def _value(figure: Figure, trial: Trial) -> Value:
    if trial.run.failure is not None and not figure.of_failed:
        return 0 if figure.kind == "integer" else None
    value = None if figure.of_run is None else figure.of_run(trial)
    if value is None or figure.kind == "text":
        return value
    return int(value) if figure.kind == "integer" else number(float(value))


def number(value: float | None) -> float | None:
    """The value, or None where it is not finite."""
    return None if value is None or not np.isfinite(value) else float(value)


def median(values: FloatArray | IntArray) -> float:
    """Median; NaN of none."""
    return float(np.median(values)) if len(values) else float("nan")


def _rotation_rmse_deg(trial: Trial) -> float | None:
    if trial.positions is None:
        return None
    run, at = trial.run, trial.scored
    errors = metrics.rotation_errors(run.orientations[at], run.true_orientations[at])
    return float(np.rad2deg(root_mean_square(errors)))


def _end_error_m(trial: Trial) -> float | None:
    return None if trial.positions is None else float(np.linalg.norm(np.subtract(*trial.positions)[-1]))


def _velocity_rmse_m_s(trial: Trial) -> float | None:
    errors = trial.run.linear_velocities[1:] - trial.run.true_linear_velocities[1:]
    errors = errors[np.isfinite(errors).all(axis=1)]
    return root_mean_square(errors) if len(errors) else None


def _end_forward_error_sigma(trial: Trial) -> float | None:
    covariance = trial.final_covariance
    if covariance is None or not trial.scored.any() or not trial.run.reference.counts_as_truth:
        return None
    at = np.flatnonzero(trial.scored & np.isfinite(trial.run.pose_covariances).all(axis=(1, 2)))[-1]
    ahead = rotations.matrix(trial.run.orientations[at])[:, 2]
    variance = float(ahead @ covariance[POSITION, POSITION] @ ahead)
    error = float(ahead @ (trial.run.true_positions[at] - trial.run.positions[at]))
    return error / np.sqrt(variance) if variance > 0.0 else None


def _final_position_sigma_m(trial: Trial) -> float | None:
    covariance = trial.final_covariance
    return None if covariance is None else float(np.sqrt(np.trace(covariance[POSITION, POSITION])))


def _final_pose_logdet(trial: Trial) -> float | None:
    if trial.final_covariance is None:
        return None
    sign, log_determinant = np.linalg.slogdet(trial.final_covariance)
    return float(log_determinant) if sign > 0 else None


def _efficiency_percent(trial: Trial) -> float | None:
    error = trial.position_rmse
    return 100.0 * trial.bound_rmse(POSITION) / error if error > 0 else None


def has_diverged(figures: Mapping[str, Any], divergence_percent: float) -> int:
    """1 where the run with these figures failed, or ended farther from the truth than the limit; else 0."""
    drift = figures["end_drift_percent"]
    return int(figures["failure"] is not None or (drift is not None and drift > divergence_percent))


def _diverged(trial: Trial) -> int:
    outcome = {"failure": trial.run.failure, "end_drift_percent": trial.end_drift_percent}
    return has_diverged(outcome, trial.divergence_percent)


# ---- over runs ------------------------------------------------------------------------------------------------------


def _of_known(words: str, combine: Callable[[FloatArray], float]) -> Combination:
    """Combination of the runs in which a figure is known; None where there are none."""

    def of(sample: Sample, name: str) -> float | None:
        known_values = sample.known(name)
        return number(combine(known_values)) if len(known_values) else None

    return Combination(words, of, combine)


ROOT_MEAN_SQUARE = _of_known("root mean square", root_mean_square)
MEAN = _of_known("mean", mean)
MEDIAN = _of_known("median", median)
LARGEST = _of_known("largest", lambda values: float(values.max()))
SUM = Combination("sum", lambda sample, name: int(sample.known(name).sum()))


def _consistency(what: str, field: str = "mean", words: str = "mean over all frames") -> Combination:
    return Combination(words, lambda s, _: getattr(s.consistency[what], field) if what in s.consistency else None)


def _over_segments(series: str) -> Combination:
    return Combination("mean over all segments", lambda s, _: number(mean(getattr(s.segments, series))))


def _efficiency(sample: Sample, _: str) -> float | None:
    bounds, errors = sample.column("bound_position_m"), sample.column("position_rmse_m")
    both = np.isfinite(bounds) & np.isfinite(errors)
    squared = np.sum(np.square(errors[both]))
    return float(100.0 * np.sqrt(np.sum(np.square(bounds[both])) / squared)) if squared > 0 else None


def _gated_percent(sample: Sample, _: str) -> float | None:
    updated, gated = (sample.known(name).sum() for name in ("updated", "gated"))
    return float(100.0 * gated / (updated + gated)) if updated + gated else None


# ---- the table ------------------------------------------------------------------------------------------------------


def _median(series: str) -> tuple[Callable[[Trial], float], Combination]:
    """Median over frames of a series: of one run, and of all frames of all runs."""
    over_runs = Combination("median over all frames", lambda s, _: number(median(pooled(s.completed, series))), median)
    return lambda trial: median(pooled([trial.run], series)), over_runs


def _mean(series: str) -> Callable[[Trial], float]:
    return lambda trial: mean(pooled([trial.run], series))


def _count(series: str) -> Callable[[Trial], int | None]:
    return lambda trial: int(trial.run.counts[series].sum()) if series in trial.run.counts else None


def _of_bodies(series: str, combine: Callable[[FloatArray], float]) -> Callable[[Trial], float | None]:
    """Combination of a series over the bodies and frames of a run; None without any."""

    def of(trial: Trial) -> float | None:
        values = np.zeros(0) if trial.run.bodies is None else getattr(trial.run.bodies, series)
        values = values[np.isfinite(values)]
        return float(combine(values)) if len(values) else None

    return of


def _share(part: str, whole: str) -> Callable[[Trial], float | None]:
    """Share of one count in another, over all frames, in %; None where there is nothing to count."""

    def of(trial: Trial) -> float | None:
        counts = trial.run.counts
        all_counted = int(counts[whole].sum()) if whole in counts else 0
        return 100.0 * int(counts[part].sum()) / all_counted if all_counted else None

    return of


def _of_windows(seconds: float) -> tuple[Figure, Figure]:
    """NEES of windows of a length, and the floor of that."""
    series = series_of(seconds)
    over_runs = Combination("mean over all windows", lambda s, _: number(mean(pooled(s.completed, series))))
    return (
        Figure(
            series,
            f"motion NEES, {seconds:g} s",
            "",
            "consistency",
            f"mean NEES of the motion over windows of {seconds:g} s that do not overlap; 6 is ideal; null where they "
            "were not scored, or the filter keeps no clones of the pose",
            _mean(series),
            over_runs,
            digits=2,
            ideal=DOF["pose"],
        ),
        Figure(
            f"{series}_floor",
            f"floor of that, {seconds:g} s",
            "",
            "consistency",
            "as pose_nees_floor, of these windows",
            *_median(f"{series}_floor"),
            digits=2,
            ideal=DOF["pose"],
        ),
    )


_BRIEF: tuple[Place, ...] = ("brief", "console", "report")
_CONSOLE: tuple[Place, ...] = ("console",)
_REPORT: tuple[Place, ...] = ("report",)
_TEXT: dict[str, Any] = {"kind": "text", "of_failed": True, "places": ()}
_COUNT: dict[str, Any] = {"kind": "integer", "of_failed": True, "digits": 0}
_NEES: dict[str, Any] = {"digits": 2, "places": _REPORT}

# fmt: off
_TABLE = (
    Figure("filter", "", "", "trial", "label of the filter", lambda t: t.run.filter_name, **_TEXT),
    Figure("recording", "", "", "trial", "name of the recording", lambda t: t.run.recording_name, **_TEXT),
    Figure("seed", "", "", "trial", "seed of the recording; null for real data", lambda t: t.run.seed,
           kind="integer", of_failed=True, places=()),
    Figure("frames", "scored frames", "", "trial", "frames with truth, the first one left out",
           lambda t: int(t.scored.sum()), SUM, kind="integer", places=()),
    Figure("path_m", "path", "m", "trial", "length of the true path over the scored frames",
           lambda t: None if t.positions is None else metrics.path_length(t.positions[1]), places=()),

    Figure("position_rmse_m", "position error", "m", "accuracy",
           "root mean square position error, not aligned; null with fewer than 3 scored frames",
           lambda t: t.position_rmse, ROOT_MEAN_SQUARE, compared=True, places=_BRIEF),
    Figure("rotation_rmse_deg", "rotation error", "°", "accuracy",
           "root mean square angle between estimated and true orientation",
           _rotation_rmse_deg, ROOT_MEAN_SQUARE, compared=True),
    Figure("ate_rigid_m", "rigid ATE", "m", "accuracy",
           "absolute trajectory error: root mean square after rigid alignment, without scale",
           lambda t: None if t.positions is None else metrics.ate_rigid(*t.positions), MEDIAN,
           compared=True, places=_BRIEF),
    Figure("end_drift_percent", "drift at the end", "%", "accuracy",
           "end_error_m over path_m; null where the vehicle stands still", lambda t: t.end_drift_percent, MEAN),
    Figure("velocity_rmse_m_s", "velocity error", "m/s", "accuracy",
           "root mean square error of the linear velocity in W; null without true velocities",
           _velocity_rmse_m_s, ROOT_MEAN_SQUARE, places=_REPORT),
    Figure("rpe_translation_percent", "t_rel", "%", "accuracy",
           "relative translation error over all segments of all lengths, as KITTI has it",
           lambda t: mean(t.segments.translation_percent), _over_segments("translation_percent"), places=_REPORT),
    Figure("rpe_rotation_deg_per_100m", "r_rel", "°/100 m", "accuracy",
           "relative rotation error over the same segments",
           lambda t: mean(t.segments.rotation_deg_per_100m), _over_segments("rotation_deg_per_100m"), places=_REPORT),
    Figure("rpe_segments", "segments", "", "accuracy", "number of those segments; 0 where the path is too short",
           lambda t: len(t.segments), kind="integer", places=()),
    Figure("landmark_rmse_m", "landmark error", "m", "accuracy",
           "median over frames of the root mean square error of landmarks within 40 m, relative to the camera",
           *_median("landmark_rmse"), compared=True, places=_BRIEF),
    Figure("bound_position_m", "position bound", "m", "accuracy",
           "posterior Cramer-Rao bound of position_rmse_m; null where truth is not complete",
           lambda t: t.bound_rmse(POSITION), ROOT_MEAN_SQUARE, places=_REPORT),
    Figure("bound_rotation_deg", "rotation bound", "°", "accuracy",
           "posterior Cramer-Rao bound of rotation_rmse_deg",
           lambda t: float(np.rad2deg(t.bound_rmse(ROTATION))), ROOT_MEAN_SQUARE, places=_REPORT),
    Figure("efficiency_percent", "efficiency", "%", "accuracy",
           "bound_position_m over position_rmse_m: 100 leaves nothing to gain",
           _efficiency_percent, Combination("ratio of both root mean squares", _efficiency),
           digits=0, larger_is_better=True, compared=True, places=_BRIEF),

    Figure("final_position_sigma_m", "claimed σ at the end", "m", "claim",
           "what end_error_m should be: root of the trace of the position's covariance in that frame",
           _final_position_sigma_m, ROOT_MEAN_SQUARE),
    Figure("final_pose_logdet", "claimed log det at the end", "", "claim",
           "natural logarithm of the determinant of that pose covariance, in m and rad",
           _final_pose_logdet, MEAN, digits=2, is_ratio=False),
    Figure("end_error_m", "true error at the end", "m", "claim",
           "position error in the last scored frame, not aligned", _end_error_m, ROOT_MEAN_SQUARE),

    Figure("pose_anees", "pose NEES", "", "consistency", "mean NEES of the pose over frames; 6 is ideal",
           _mean("pose_nees"), _consistency("pose"), digits=2, ideal=DOF["pose"], compared=True, places=_BRIEF),
    Figure("frames_in_band_percent", "frames inside the band", "%", "consistency",
           "share of the frames whose pose NEES, averaged over runs, is inside the 95 % band of that frame",
           None, _consistency("pose", "inside_percent", "share of frames"), digits=0, places=_CONSOLE),
    Figure("end_forward_error_sigma", "signed error ahead at the end", "σ", "consistency",
           "true minus estimated position along the axis of the camera in the last scored frame, by its claimed "
           "standard deviation; a mean over runs beyond 2/√runs is a bias, which no larger covariance mends",
           _end_forward_error_sigma, MEAN, digits=2, is_ratio=False, places=_REPORT),
    Figure("position_anees", "position NEES", "", "consistency", "mean NEES of the position; 3 is ideal",
           _mean("position_nees"), _consistency("position"), ideal=DOF["position"], **_NEES),
    Figure("rotation_anees", "rotation NEES", "", "consistency", "mean NEES of the rotation; 3 is ideal",
           _mean("rotation_nees"), _consistency("rotation"), ideal=DOF["rotation"], **_NEES),
    Figure("pose_nees_floor", "pose NEES floor", "", "consistency",
           "median over frames of the NEES that a consistent filter with this covariance would have if the errors that "
           "are stated of the reference were taken for its own; null where none are stated",
           *_median("pose_nees_floor"), digits=2, ideal=DOF["pose"]),
    *(figure for seconds in WINDOWS for figure in _of_windows(seconds)),
    Figure("landmark_anees", "landmark NEES", "", "consistency",
           "mean NEES of landmarks in (u, v, d); 3 is ideal",
           lambda t: landmark_anees([t.run]), _consistency("landmark"), digits=2, ideal=DOF["landmark"]),
    Figure("frames_not_scored", "frames not scored", "", "consistency",
           "frames with a truth that counts whose pose has no score, but the first: those after a filter has failed",
           lambda t: t.not_scored, SUM, **_COUNT),
    Figure("landmarks_not_scored", "landmarks not scored", "", "consistency",
           "landmarks x frames truly in view and without a NEES: the filter has no finite place for them",
           _count("landmarks_not_scored"), SUM, places=_REPORT, **_COUNT),
    Figure("nis", "NIS / dof", "", "consistency",
           "normalised innovation squared by its degrees of freedom; 1 is ideal",
           lambda t: nis_per_dof([t.run]), _consistency("nis"), digits=2, ideal=1.0, compared=True),
    Figure("nis_dof", "degrees of freedom", "", "consistency", "degrees of freedom of all innovations together",
           lambda t: int(t.run.nis_dof.sum()), kind="integer", places=()),

    Figure("body_pose_nees", "body pose NEES", "", "bodies",
           "mean NEES of the motion of moving bodies since birth, as seen from the camera, from 1 s after birth; 6 is "
           "ideal, and a few bodies that change to another true one rule it",
           _of_bodies("pose_nees", mean), MEAN, digits=2, ideal=DOF["pose"]),
    Figure("body_pose_nees_median", "body pose NEES, median", "", "bodies",
           "median of the same; of a consistent filter 5.35",
           _of_bodies("pose_nees", median), MEDIAN, digits=2, ideal=DOF["pose"]),
    Figure("body_twist_nees", "body twist NEES", "", "bodies",
           "mean NEES of velocity and angular velocity of moving bodies; 6 is ideal",
           _of_bodies("twist_nees", mean), MEAN, digits=2, ideal=DOF["pose"], places=_REPORT),
    Figure("body_twist_nees_median", "body twist NEES, median", "", "bodies", "median of the same",
           _of_bodies("twist_nees", median), MEDIAN, digits=2, ideal=DOF["pose"], places=_REPORT),
    Figure("body_speed_rmse_m_s", "body speed error", "m/s", "bodies",
           "root mean square error of the speed of moving bodies",
           _of_bodies("speed_errors", root_mean_square), ROOT_MEAN_SQUARE, digits=2),
    Figure("body_speed_error_median_m_s", "body speed error, median", "m/s", "bodies", "median size of the same",
           _of_bodies("speed_errors", lambda errors: median(np.abs(errors))), MEDIAN, digits=2),
    Figure("bodies_found_percent", "bodies found", "%", "bodies",
           "true bodies x frames that a body of the filter is, of those with 4 measured points or more, faster than "
           "0.7 m/s and nearer than 40 m, from 1 s after they first were so",
           _share("bodies_found", "bodies_to_find"), MEAN, digits=0, larger_is_better=True),
    Figure("bodies_false", "false bodies", "", "bodies",
           "bodies not more than half of whose landmarks were on one true moving body at birth",
           lambda t: None if t.run.bodies is None else t.run.bodies.false_births, SUM, **_COUNT),
    Figure("body_swapped_percent", "bodies false or swapped", "%", "bodies",
           "bodies x frames, from 1 s after birth, that are on another true body than at birth, or were false then",
           _of_bodies("swapped", lambda swapped: 100.0 * mean(swapped)), MEAN, digits=1),
    Figure("body_delay_s", "delay of birth", "s", "bodies",
           "median time from the first frame with 4 measured points on a true body to the birth of one for it",
           _of_bodies("delays", median), MEDIAN, digits=2, places=_REPORT),
    Figure("mover_points_used_as_static_percent", "mover points used as static", "%", "bodies",
           "measured points on movers that corrected the camera as landmarks of the scene, from 1 s on; of any filter",
           _share("movers_as_static", "movers_measured"), MEAN, digits=1),
    Figure("static_points_on_bodies_percent", "static points on bodies", "%", "bodies",
           "measured points of the scene that corrected the state as landmarks on a body, from 1 s on",
           _share("static_on_bodies", "static_measured"), MEAN, digits=2, places=_REPORT),

    Figure("ms_per_frame", "time", "ms", "cost", "median over frames of predict + update, the first frame left out",
           *_median("milliseconds"), digits=2, compared=True, places=_BRIEF),
    Figure("ms_predict", "time of predict", "ms", "cost", "median over frames of predict",
           *_median("predict_milliseconds"), digits=2, places=_REPORT),
    Figure("ms_update", "time of update", "ms", "cost", "median over frames of update",
           *_median("update_milliseconds"), digits=2, places=_REPORT),
    Figure("timed", "timed runs", "", "cost",
           "runs by which time and memory are known: the first ones of a filter, which are run one by one",
           None, Combination("number", lambda s, _: len(s.known("ms_per_frame"))), digits=0, per_runs=True),
    Figure("memory_mb", "memory", "MB", "cost",
           "growth of the peak resident memory of the process; null where not known",
           lambda t: t.run.memory_mb, LARGEST, digits=1, places=_REPORT),
    Figure("state_size", "state size", "", "cost",
           "median over frames of the dimension of the error state; null where the filter does not say",
           *_median("state_size"), digits=0, places=_REPORT),
    Figure("map_size", "map size", "", "cost", "median over frames of the number of landmarks in the map",
           lambda t: median(t.run.counts["map_size"][1:]), places=()),

    Figure("gated_percent", "gated", "%", "events", "measurements of known landmarks refused by the gate",
           None, Combination("share of all measurements", _gated_percent), digits=1),
    Figure("updated", "updates", "", "events", "measurements that corrected the state",
           _count("updated"), places=(), **_COUNT),
    Figure("initialised", "new landmarks", "", "events", "landmarks that entered the map",
           _count("initialised"), places=(), **_COUNT),
    Figure("dropped", "dropped landmarks", "", "events", "landmarks that left the map",
           _count("dropped"), places=(), **_COUNT),
    Figure("gated", "gated measurements", "", "events", "measurements refused by the gate",
           _count("gated"), places=(), **_COUNT),
    Figure("rejected", "rejected", "", "events", "measurements that could not start a landmark",
           _count("rejected"), SUM, places=_REPORT, **_COUNT),
    Figure("behind_camera", "behind the camera", "", "events",
           "measurements of landmarks predicted behind the camera, not used",
           _count("behind_camera"), SUM, places=_REPORT, **_COUNT),
    Figure("failed_factorisations", "failed factorisations", "", "events",
           "measurements whose S had no Cholesky factor, not used",
           _count("failed_factorisations"), SUM, places=_REPORT, **_COUNT),
    Figure("negative_depth", "landmarks at d ≤ 0", "", "events", "landmarks x frames seen and estimated at d <= 0",
           _count("negative_depth"), SUM, places=_REPORT, **_COUNT),
    Figure("diverged", "diverged runs", "", "events",
           "1: failed, or ended farther from the truth than the divergence limit",
           _diverged, SUM, per_runs=True, places=_BRIEF, **_COUNT),
    Figure("alarmed", "runs with an alarm", "", "events",
           "runs in which the divergence monitor raised an alarm, by innovations and events alone",
           None, Combination("number", lambda s, _: len(s.known("alarm_s"))), digits=0, per_runs=True),
    Figure("failure", "", "", "trial", "what the filter raised; null where it went through",
           lambda t: t.run.failure, **_TEXT),
    Figure("alarm_s", "alarm", "s", "events",
           "first alarm of the divergence monitor, from the first frame on; null: never",
           lambda t: None if t.alarm is None else t.alarm.time, of_failed=True, places=()),
    Figure("alarm", "", "", "trial", "why, in one line",
           lambda t: None if t.alarm is None else t.alarm.words, **_TEXT),
)
# fmt: on

FIGURES: Mapping[str, Figure] = {figure.name: figure for figure in _TABLE}
"""Every figure by its name, in the order of the tables."""
