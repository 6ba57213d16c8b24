"""Run of one filter over one recording, with everything that metrics and reports need."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters import LandmarkBelief, StereoNoise
from filters.catalogue.registry import FilterFactory, label_of, make_with_common_options
from filters.checks.consistency import InconsistentPoseError, are_definite, nees
from filters.contract.outputs import UpdateReport
from filters.contract.validation import error_line, first_line
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.evaluation.body_scores import BodyScorer
from stereo_slam_env.evaluation.landmark_statistics import LandmarkScorer
from stereo_slam_env.evaluation.map_scoring import FrameMap, TraceRecorder, score_maps, view_maps
from stereo_slam_env.evaluation.results import (
    COUNTS,
    EVENTS,
    Beliefs,
    ContractBroken,
    FilterRun,
    check_beliefs,
    check_maps,
    peak_memory_mb,
)
from stereo_slam_env.evaluation.windows import WINDOW_SERIES, WindowScores, nees_floor
from stereo_slam_env.loop import Moment, Observe, run
from stereo_slam_env.recording.recording import Recording, require_frames

_log = logging.getLogger(__name__)


def run_filter(
    recording: Recording,
    filter_name: str | FilterFactory,
    options: Mapping[str, Any] | None = None,
    *,
    label: str | None = None,
    common_options: Mapping[str, Any] | None = None,
    noise: StereoNoise | None = None,
    use_odometry: bool | None = None,
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
        Options given to every filter of a comparison that leaves them open, see `filters.catalogue.registry`;
        None: those that the recording states.
    noise : StereoNoise, optional
        Noise to assume; None: what the recording states.
    use_odometry : bool, optional
        Whether `predict` is given the odometry of the recording; None: what that states.
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
    require_frames(recording)
    setup = recording.filter_setup
    name = label or label_of(filter_name)
    log = RunLog(recording)
    memory = peak_memory_mb()
    used: dict[str, Any] = dict(options or {})
    not_given: Mapping[str, str] = {}
    frame_number = -1
    scores: WindowScores | None = None
    final_map: LandmarkBelief | None = None
    with threadpool_limits(limits=1):
        try:
            made_filter = make_with_common_options(
                filter_name,
                recording.camera,
                setup.assumed_noise(recording.noise) if noise is None else noise,
                options or {},
                setup.common_options(options or {}) if common_options is None else common_options,
            )
            used, not_given = made_filter.options, made_filter.not_given
            moments = run(made_filter.filter, recording, use_odometry=use_odometry, observe=observe)
            scores = WindowScores(made_filter.filter, recording) if windows else None
            frame_number = 0
            for moment in moments:
                log.add(moment, 0 if scores is None else scores.open)
                if score_map:
                    log.note_map(FrameMap.of(moment))
                scores = _with_windows(scores, moment, name, recording.name)
                frame_number = moment.number + 1
                if progress is not None:
                    progress(frame_number, len(recording))
            final_map = made_filter.filter.landmarks if score_map else None
            failure = log.fault()
        except ContractBroken as error:
            failure = log.fault() or str(error)
        except (KeyboardInterrupt, SystemExit):  # of the user, unless in a process of its own (`tasks`)
            raise
        except BaseException as error:  # a stranger's filter may raise anything; the comparison goes on without it
            where = f"frame {frame_number}" if frame_number >= 0 else "start"
            failure = log.fault() or f"{where}: {error_line(error)}"
        memory = peak_memory_mb() - memory
        if scores is not None and failure is None:
            log.note_series(np.arange(len(recording)), **scores.series)
    if failure is not None:
        _log.info("%s on %s failed at %s", name, recording.name, failure)
    return log.result(name, used, seed, failure, memory, not_given, final_map)


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
_VALUES = {
    **{"position": "positions", "orientation": "orientations"},
    **{"linear velocity": "linear_velocities", "angular velocity": "angular_velocities"},
}
"""Series that must be finite, by what messages call them."""
AT_ONCE = 50
"""Frames that are scored together: arrays of so many cost far less than one after the other."""


class RunLog:
    """The arrays of a `FilterRun`: what a filter believes is noted frame by frame and scored some frames at a time."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._has_truth = recording.reference.counts_as_truth
        frames, count = recording.frames, len(recording)
        nowhere, no_turn = np.full(3, np.nan), np.full(4, np.nan)
        poses, moves = [f.truth for f in frames], [f.truth_velocity for f in frames]
        self.given = {
            "timestamps": np.array([f.timestamp for f in frames]),
            "true_positions": np.array([nowhere if p is None else p.position for p in poses]),
            "true_orientations": np.array([no_turn if p is None else p.orientation for p in poses]),
            "true_linear_velocities": np.array([nowhere if v is None else v.linear for v in moves]),
            "true_angular_velocities": np.array([nowhere if v is None else v.angular for v in moves]),
        }
        """Series of the run that the recording gives."""
        self._series = {name: np.full((count, *shape), np.nan) for name, shape in _SERIES.items()}
        self._nis_dof: IntArray = np.zeros(count, dtype=np.int64)
        self._counts: dict[str, IntArray] = {name: np.zeros(count, dtype=np.int64) for name in COUNTS}
        self._claimed = np.full((count, POSE_SIZE, POSE_SIZE), np.nan)  # for the pose errors
        self._scored = np.full((count, POSE_SIZE, POSE_SIZE), np.nan)  # covariance that they are held against
        self._traces = TraceRecorder(recording)
        self._scorer = LandmarkScorer(recording.camera)
        self._bodies = BodyScorer(recording) if any(frame.bodies is not None for frame in frames) else None
        self._judged = np.zeros(count, dtype=np.bool_)  # whether there is a pose error
        self._checked = self._noted = 0  # frames
        self._maps: list[FrameMap] = []
        self._fault: str | None = None

    def add(self, moment: Moment, clones: int = 0) -> None:
        """Note what a filter believes after a frame, of whose pose there are `clones` for the windows."""
        pose, velocity = moment.pose, moment.slam.velocity
        self.note(
            moment.number,
            moment.report,
            positions=pose.position,
            orientations=pose.orientation,
            pose_covariances=pose.covariance,
            linear_velocities=velocity.linear,
            angular_velocities=velocity.angular,
            velocity_covariances=velocity.covariance,
            predict_milliseconds=1000.0 * moment.predict_seconds,
            update_milliseconds=1000.0 * moment.update_seconds,
            milliseconds=1000.0 * (moment.predict_seconds + moment.update_seconds),
            state_size=getattr(moment.slam, "state_size", np.nan) - POSE_SIZE * clones,
        )
        self.note_bodies(moment.number, moment.report, moment)
        try:
            if moment.pose_error is None:
                return
        except InconsistentPoseError as error:
            raise ContractBroken(moment.number, str(error)) from error
        scored = None if moment.scored_error is None else moment.scored_error[1]
        self.note_errors(moment.number, *moment.pose_error, scored)

    def note(self, k: int, report: UpdateReport, **values: FloatArray | float) -> None:
        """Note the next frame, of number k: values of series by name, and what the update did."""
        if k - self._checked == AT_ONCE:
            self._check()
        self.note_series(k, **values)
        self._series["nis"][k], self._nis_dof[k] = report.nis, report.nis_dof
        for name in EVENTS:
            self._counts[name][k] = len(getattr(report, name))
        self._counts["failed_factorisations"][k] = report.failed_factorisations
        self._noted = k + 1

    def note_bodies(self, k: int, report: UpdateReport, moment: Moment | None = None) -> None:
        """Score moving bodies in a frame that is noted; without a moment, count the points on movers alone."""
        if self._bodies is not None:
            self._bodies.add(k, report, moment)

    def note_errors(
        self, k: int | IntArray, errors: FloatArray, claimed: FloatArray, scored: FloatArray | None = None
    ) -> None:
        """Note errors of the pose in frames k, the covariances claimed for them, and those that they are scored by.

        The latter are the claimed ones plus those of the reference; NaN, or None, where a frame is not scored.
        """
        self._series["pose_errors"][k], self._claimed[k], self._judged[k] = errors, claimed, True
        if scored is not None:
            self._scored[k] = scored

    def note_series(self, k: int | IntArray, **values: FloatArray | float) -> None:
        """Note values of series in frames k, by name."""
        for name, value in values.items():
            self._series[name][k] = value

    def note_map(self, one: FrameMap) -> None:
        """Note the map in a frame that is noted."""
        self._maps.append(one)

    def fault(self) -> str | None:
        """Fault that kept a belief of the frames so far from being one, if any."""
        if self._fault is None:
            try:
                self._check()
            except ContractBroken as error:
                self._fault = str(error)
        return self._fault

    def _check(self) -> None:
        """Check and score the frames since the last time; those from a broken belief on are forgotten."""
        first, maps = self._checked, self._maps
        self._checked, self._maps = self._noted, []
        try:
            try:
                check_beliefs(first, self._beliefs(slice(first, self._noted)))
            except ContractBroken as error:
                self._score_maps([one for one in maps if one.number < error.frame])
                self._forget(error.frame)
                raise
            self._score_maps(maps)
        except ContractBroken as error:
            self._fault = str(error)
            raise

    def _beliefs(self, frames: slice) -> Beliefs:
        series = self._series
        return Beliefs(
            {what: series[name][frames] for what, name in _VALUES.items()},
            series["pose_covariances"][frames],
            series["velocity_covariances"][frames],
            series["pose_errors"][frames],
            self._claimed[frames],
            self._judged[frames],
        )

    def _forget(self, first: int) -> None:
        for values in (*self._series.values(), self._claimed, self._scored):
            values[first:] = np.nan
        for counted in (*self._counts.values(), self._nis_dof):
            counted[first:] = 0

    def _score_maps(self, maps: Sequence[FrameMap]) -> None:
        """Score the maps and follow the traced landmarks."""
        if not maps:
            return
        camera, frames = self._recording.camera, range(maps[0].number, maps[-1].number + 1)
        view = view_maps(maps, self._recording.landmarks if self._has_truth else None)
        score = score_maps(view, camera)
        try:
            check_maps(view, score)
        except ContractBroken as error:
            self._score_maps([one for one in maps if one.number < error.frame])
            self._forget(error.frame + 1)
            raise
        these = slice(frames.start, frames.stop)
        self._series["landmark_nees"][these] = score.mean_nees(frames)
        self._series["landmark_rmse"][these] = score.position_rmse(frames)
        missed = view.frames[score.in_view & np.isnan(score.nees)] - frames.start
        self._counts["landmarks_not_scored"][these] = np.bincount(missed, minlength=len(frames))
        self._counts["map_size"][these] = [len(one.forecast.ids) for one in maps]
        for one in maps:
            behind = one.forecast.uvd[:, 2] <= 0
            if behind.any():
                sighted = np.isin(one.forecast.ids[behind], one.frame.observation.ids)
                self._counts["negative_depth"][one.number] = sighted.sum()
        self._scorer.add(score, frames)
        self._traces.add(view, maps)

    def result(
        self,
        label: str,
        options: Mapping[str, Any],
        seed: int | None,
        failure: str | None,
        memory_mb: float,
        not_given: Mapping[str, str] | None = None,
        final_map: LandmarkBelief | None = None,
    ) -> FilterRun:
        """The run so far."""
        for name, part in _NEES.items():
            self._series[name] = nees(self._series["pose_errors"][:, part], self._scored[:, part, part])
        doubt = self._scored - self._claimed
        doubted = are_definite(self._claimed) & np.isfinite(doubt).all(axis=(1, 2)) & doubt.any(axis=(1, 2))
        self._series["pose_nees_floor"][doubted] = nees_floor(self._claimed[doubted], doubt[doubted])
        return FilterRun(
            filter_name=label,
            recording_name=self._recording.name,
            options=options,
            not_given=not_given or {},
            seed=seed,
            nis_dof=self._nis_dof,
            counts=self._counts | ({} if self._bodies is None else self._bodies.counts),
            traces=self._traces.traces(),
            failure=failure,
            memory_mb=memory_mb,
            landmark_statistics=self._scorer.statistics,
            truth_from=self._recording.truth_from,
            final_map=final_map,
            bodies=None if self._bodies is None else self._bodies.scores,
            **self.given,
            **self._series,
        )


def failed_run(
    recording: Recording, label: str, options: Mapping[str, Any], seed: int | None, failure: str
) -> FilterRun:
    """The result of a filter that gave none; `failure` is one line."""
    return RunLog(recording).result(label, options, seed, failure, float("nan"))
