"""Run of one filter over one recording, with everything that metrics and reports need."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters import StereoNoise
from filters.catalogue.common_options import make_with_common_options
from filters.catalogue.registry import FilterFactory, label_of
from filters.consistency import nees
from filters.contract.foreign_text import first_line, type_name
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from filters.validation import FloatArray, IntArray
from stereo_slam_env.evaluation.contract import ContractBroken, check_beliefs, check_map
from stereo_slam_env.evaluation.landmark_statistics import LandmarkScorer
from stereo_slam_env.evaluation.map_scoring import TraceRecorder, score_map, view_map
from stereo_slam_env.evaluation.results import COUNTS, EVENTS, FilterRun, peak_memory_mb
from stereo_slam_env.evaluation.windows import WINDOW_SERIES, WindowScores, nees_floor
from stereo_slam_env.loop import Moment, Observe, run
from stereo_slam_env.recording.recording import Recording

_log = logging.getLogger(__name__)


def run_filter(
    recording: Recording,
    filter_name: str | FilterFactory,
    options: Mapping[str, Any] | None = None,
    *,
    label: str | None = None,
    common_options: Mapping[str, Any] | None = None,
    noise: StereoNoise | None = None,
    use_odometry: bool = True,
    score_map: bool = True,
    windows: bool = False,
    seed: int | None = None,
    observe: Observe | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FilterRun:
    """Run a filter over a recording with `stereo_slam_env.loop.run`, timed with one BLAS thread.

    Parameters
    ----------
    recording : Recording
        The stream.
    filter_name : str or callable
        A name of `filters.available_filters()`, or a filter class or function, as `make_filter` takes it.
    options : mapping, optional
        Options of the filter, JSON-able: `motion` is written as {"sigma_acceleration": ...,
        "sigma_angular_acceleration": ...} or "velocity-driven".
    label : str, optional
        Name in tables and files; None: that of the filter.
    common_options : mapping, optional
        Options given to every filter of a comparison that leaves them open, see `filters.catalogue.common_options`.
    noise : StereoNoise, optional
        Noise to assume; None: what the recording says.
    use_odometry : bool
        Whether `predict` is given the odometry of the recording.
    score_map : bool
        Whether the landmarks are judged, too, which costs about as much as a quick filter.
    windows : bool
        Whether the motion over windows is judged, too, for filters that keep clones of the pose.
    seed : int, optional
        Of the recording, for the result.
    observe : callable, optional
        Measures instead of the recording, see `FilterLoop.step`.
    progress : callable, optional
        Called with (frames done, frames) after each frame.

    Returns
    -------
    FilterRun
        A filter that raises, or claims something that is no covariance, is a result too: `failure` says what happened.

    Raises
    ------
    ValueError
        The recording is empty.
    """
    if len(recording) == 0:
        raise ValueError(f"recording {recording.name!r} has no frames")
    name = label or label_of(filter_name)
    log = RunLog(recording)
    memory = peak_memory_mb()
    used: dict[str, Any] = dict(options or {})
    not_given: Mapping[str, str] = {}
    frame_number = -1
    scores: WindowScores | None = None
    with threadpool_limits(limits=1):
        try:
            made = make_with_common_options(
                filter_name,
                recording.camera,
                recording.noise if noise is None else noise,
                options or {},
                common_options or {},
            )
            used, not_given = made.options, made.not_given
            moments = run(made.filter, recording, use_odometry=use_odometry, observe=observe)
            scores = WindowScores(made.filter, recording) if windows else None
            frame_number = 0
            for moment in moments:
                log.add(moment, 0 if scores is None else scores.open)
                if score_map:
                    log.add_map(moment)
                scores = _with_windows(scores, moment, name, recording.name)
                frame_number = moment.number + 1
                if progress is not None:
                    progress(frame_number, len(recording))
            failure = None
        except ContractBroken as error:
            failure = str(error)
        except Exception as error:  # a stranger's filter may raise anything; the comparison goes on without it
            where = f"frame {frame_number}" if frame_number >= 0 else "start"
            failure = f"{where}: {type_name(error)}: {first_line(error, empty='no message')}"
        memory = peak_memory_mb() - memory
        if scores is not None and failure is None:
            log.add_windows(scores.series)
    if failure is not None:
        _log.info("%s on %s failed at %s", name, recording.name, failure)
    return log.result(name, used, seed, failure, memory, not_given)


def _with_windows(scores: WindowScores | None, moment: Moment, name: str, drive: str) -> WindowScores | None:
    """Score the windows of a frame; None from the moment on that the clones of a stranger's filter raise."""
    if scores is not None:
        try:
            scores.add(moment)
        except ContractBroken:
            raise
        except Exception as error:  # the other figures stand
            _log.warning("%s on %s: windows are not scored: %s", name, drive, first_line(error))
            return None
    return scores


_SERIES: Mapping[str, tuple[int, ...]] = {
    **{"positions": (3,), "orientations": (4,), "pose_covariances": (6, 6)},
    **{"linear_velocities": (3,), "angular_velocities": (3,), "velocity_covariances": (6, 6), "pose_errors": (6,)},
    **dict.fromkeys(("pose_nees", "position_nees", "rotation_nees", "landmark_nees", "landmark_rmse", "nis"), ()),
    **dict.fromkeys(("pose_nees_floor", *WINDOW_SERIES), ()),
    **dict.fromkeys(("milliseconds", "predict_milliseconds", "update_milliseconds", "state_size"), ()),
}
"""Series of floating point numbers of a `FilterRun` that are filled frame by frame, and the shapes of their rows."""


_NEES = {"pose_nees": slice(0, POSE_SIZE), "position_nees": POSITION, "rotation_nees": ROTATION}


class RunLog:
    """The arrays of a `FilterRun`, filled frame by frame."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._has_truth = recording.reference.counts_as_truth
        count = len(recording)
        self._series = {name: np.full((count, *shape), np.nan) for name, shape in _SERIES.items()}
        self._nis_dof: IntArray = np.zeros(count, dtype=np.int64)
        self._counts: dict[str, IntArray] = {name: np.zeros(count, dtype=np.int64) for name in COUNTS}
        self._scored = np.full((count, POSE_SIZE, POSE_SIZE), np.nan)  # covariance that pose errors are held against
        self._traces = TraceRecorder(recording)
        self._scorer = LandmarkScorer(recording.camera)

    def add(self, moment: Moment, clones: int = 0) -> None:
        """Note what a filter believes after a frame; raises as `check_beliefs`.

        `clones` of its pose are there for the windows, not for the filter.
        """
        check_beliefs(moment)
        k, pose, velocity, report = moment.number, moment.pose, moment.slam.velocity, moment.report
        belief = {
            "positions": pose.position,
            "orientations": pose.orientation,
            "pose_covariances": pose.covariance,
            "linear_velocities": velocity.linear,
            "angular_velocities": velocity.angular,
            "velocity_covariances": velocity.covariance,
        }
        predicting, updating = 1000.0 * moment.predict_seconds, 1000.0 * moment.update_seconds
        self._note(
            k,
            **belief,
            nis=report.nis,
            predict_milliseconds=predicting,
            update_milliseconds=updating,
            milliseconds=predicting + updating,
            state_size=getattr(moment.slam, "state_size", np.nan) - POSE_SIZE * clones,
        )
        self._nis_dof[k] = report.nis_dof
        for name in EVENTS:
            self._counts[name][k] = len(getattr(report, name))
        self._counts["failed_factorisations"][k] = report.failed_factorisations
        if moment.pose_error is None:
            return
        error, covariance = moment.pose_error
        self._note(k, pose_errors=error)
        if moment.scored_error is not None:
            _, summed = moment.scored_error
            self._scored[k] = summed
            if summed is not covariance:
                self._note(k, pose_nees_floor=nees_floor(covariance, summed - covariance))

    def _note(self, k: int, **values: FloatArray | float) -> None:
        for name, value in values.items():
            self._series[name][k] = value

    def add_windows(self, series: Mapping[str, FloatArray]) -> None:
        """Note what windows showed."""
        self._series.update(series)

    def add_map(self, moment: Moment) -> None:
        """Score the map and follow the traced landmarks; raises as `check_map`."""
        k, landmarks = moment.number, self._recording.landmarks if self._has_truth else None
        view = view_map(moment.slam, moment.truth, landmarks)
        score = score_map(view, self._recording.camera)
        check_map(k, view, score)
        self._counts["landmarks_not_scored"][k] = np.count_nonzero(score.in_view & np.isnan(score.nees))
        self._note(k, landmark_nees=score.mean_nees, landmark_rmse=score.position_rmse)
        self._scorer.add(score)
        self._traces.add(k, view, moment.observation)
        behind = view.ids[view.uvd[:, 2] <= 0]
        self._counts["negative_depth"][k] = np.isin(behind, moment.observation.ids).sum()
        self._counts["map_size"][k] = len(view.ids)

    def result(
        self,
        label: str,
        options: Mapping[str, Any],
        seed: int | None,
        failure: str | None,
        memory_mb: float,
        not_given: Mapping[str, str] | None = None,
    ) -> FilterRun:
        """The run so far."""
        for name, part in _NEES.items():
            self._series[name] = nees(self._series["pose_errors"][:, part], self._scored[:, part, part])
        frames = self._recording.frames
        nowhere, no_turn = np.full(3, np.nan), np.full(4, np.nan)
        poses, moves = [f.truth for f in frames], [f.truth_velocity for f in frames]
        return FilterRun(
            filter_name=label,
            recording_name=self._recording.name,
            options=options,
            not_given=not_given or {},
            seed=seed,
            timestamps=np.array([f.timestamp for f in frames]),
            true_positions=np.array([nowhere if p is None else p.position for p in poses]),
            true_orientations=np.array([no_turn if p is None else p.orientation for p in poses]),
            true_linear_velocities=np.array([nowhere if v is None else v.linear for v in moves]),
            true_angular_velocities=np.array([nowhere if v is None else v.angular for v in moves]),
            nis_dof=self._nis_dof,
            counts=self._counts,
            traces=self._traces.traces(),
            failure=failure,
            memory_mb=memory_mb,
            landmark_statistics=self._scorer.statistics,
            truth_from=self._recording.truth_from,
            **self._series,
        )


def failed_run(
    recording: Recording, label: str, options: Mapping[str, Any], seed: int | None, failure: str
) -> FilterRun:
    """The result of a filter that gave none; `failure` is one line."""
    return RunLog(recording).result(label, options, seed, failure, float("nan"))
