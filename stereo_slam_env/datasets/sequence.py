"""A recording of images on disk as an `ImageSequence`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from filters import BodyVelocity, Pose, Start, StereoCamera, rotations
from stereo_slam_env.datasets.frames import Faults, FramePair
from stereo_slam_env.datasets.image_files import BrokenPair, read_grey
from stereo_slam_env.recording.recording import GreyImage, Reference, StereoPair

Rectify = Callable[[GreyImage, GreyImage], tuple[GreyImage, GreyImage]]


class RecordedSequence:
    """An `ImageSequence` of files; images are read pair by pair.

    W is the left camera at the first pair that is used, and truth is told in it. Where that pair has no true pose, no
    pair has one: it could not be told in W.

    Parameters
    ----------
    name : str
        Short name.
    camera : StereoCamera
        The rectified rig.
    frames : sequence of FramePair
        In time order.
    faults : Faults
        What is done about broken pairs, with those met so far.
    source : mapping
        Reader, path and settings; JSON-able. The range of frames and what is done about broken ones are added.
    truth_from : Reference
        What the truth of the frames is, where they have one.
    stored_size : (int, int), optional
        Width and height of the images on disk, px; that of the camera unless `rectify` changes it.
    rectify : callable, optional
        Makes rectified images, left and right, of those on disk.
    """

    def __init__(
        self,
        name: str,
        camera: StereoCamera,
        frames: Sequence[FramePair],
        faults: Faults,
        source: Mapping[str, Any],
        truth_from: Reference,
        *,
        stored_size: tuple[int, int] | None = None,
        rectify: Rectify | None = None,
    ) -> None:
        self.name, self.camera, self.start, self.truth_from = name, camera, Start(), truth_from
        selected = {"first": frames[0].number, "last": frames[-1].number, "on_broken": faults.on_broken}
        self.source: Mapping[str, Any] = {**source, **selected}
        self._frames = tuple(frames)
        self._found_at_opening = faults
        self._skipped = dict(faults.counts)
        self._stored_size = stored_size or (camera.width, camera.height)
        self._rectify = rectify

    @property
    def skipped(self) -> Mapping[str, int]:
        """Reason -> number of pairs left out; what is wrong with images is known once all pairs were read."""
        return dict(self._skipped)

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        """Numbers of the pairs in the recording."""
        return tuple(frame.number for frame in self._frames)

    def __len__(self) -> int:
        """Number of pairs; where broken ones are skipped, those with broken images are still counted."""
        return len(self._frames)

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order; may be called again.

        Raises
        ------
        BrokenPair
            An image is missing, damaged or of another size, and broken pairs are not skipped.
        """
        faults = Faults(self._found_at_opening.on_broken, self._found_at_opening.counts.copy())
        origin: Pose | None = None
        before: FramePair | None = None
        left_out: list[FramePair] = []
        for frame in self._frames:
            try:
                left, right = (read_grey(path, self._stored_size) for path in (frame.left, frame.right))
            except BrokenPair as fault:
                faults.meet(fault)
                self._skipped = dict(faults.counts)
                left_out.append(frame)
                continue
            if self._rectify is not None:
                left, right = self._rectify(left, right)
            if before is None:
                origin = frame.truth
            truth = _seen_from(origin, frame.truth)
            odometry = None if before is None else _mean_velocity(before, [*left_out, frame])
            yield StereoPair(frame.timestamp, left, right, truth, odometry)
            before, left_out = frame, []
        self._skipped = dict(faults.counts)


def _seen_from(origin: Pose | None, pose: Pose | None) -> Pose | None:
    if origin is None or pose is None:
        return None
    R_wo = rotations.matrix(origin.orientation)
    orientation = rotations.between(origin.orientation, pose.orientation)
    return Pose(R_wo.T @ (pose.position - origin.position), orientation)


def _mean_velocity(before: FramePair, frames: Sequence[FramePair]) -> BodyVelocity | None:
    """Mean over the steps from `before` to the last of `frames`; None where a step between is unknown."""
    if len(frames) == 1 and frames[0].number == before.number + 1:
        return frames[0].odometry
    numbers = [before.number, *(frame.number for frame in frames)]
    steps = [frame.odometry for frame in frames if frame.odometry is not None]
    if len(steps) < len(frames) or (np.diff(numbers) != 1).any():
        return None
    times = [before.timestamp, *(frame.timestamp for frame in frames)]
    shares = np.diff(times) / (times[-1] - times[0])
    return BodyVelocity(
        sum(share * step.linear for share, step in zip(shares, steps, strict=True)),
        sum(share * step.angular for share, step in zip(shares, steps, strict=True)),
        sum(share**2 * step.covariance for share, step in zip(shares, steps, strict=True)),
    )
