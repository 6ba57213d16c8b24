"""`SubmapEKF`: a `StereoEKF` as active map, and a chain of inactive submaps."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Iterator, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.inputs import BodyVelocity, InertialSamples, Start, StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.outputs import Forecast, LandmarkBelief, PoseBelief, UpdateReport, VelocityBelief
from filters.contract.stereo_filter import AT_ORIGIN, StereoFilter
from filters.contract.validation import unique_ids
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.joint_state import JointState, landmark_belief
from filters.parts import SLOTS
from filters.submaps.submap import Relation, Submap, regression, units


class SubmapChain:
    """Submaps at rest, oldest first. Methods that take the active state change it in place."""

    def __init__(self) -> None:
        self._submaps: list[Submap] = []
        self._links: list[IntArray] = []  # blocks of submap i + 1 that are the common ones of submap i
        self._ids = np.zeros(0, dtype=np.int64)  # all landmarks at rest, ascending
        self._homes = np.zeros(0, dtype=np.int64)  # the submap of each

    def __len__(self) -> int:
        return len(self._submaps)

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """Submaps in order, the oldest first."""
        return tuple(self._submaps)

    @property
    def ids(self) -> IntArray:
        """All landmarks at rest, ascending; (N,)."""
        return self._ids.copy()

    def at_rest(self, ids: IntArray) -> BoolArray:
        """Mask (M,) of landmarks at rest."""
        return self._homes_of(ids) >= 0

    def rest(self, active: JointState, gone: BoolArray) -> None:
        """Put the landmarks marked in `gone` (N,) to rest: with whatever the next map does not need, a new submap.

        They are independent of all that follows given the camera of now and the landmarks that stay.
        """
        stays = ~gone
        shared_before, clone = active.held, active.hold_variables()
        used = _blocks_of(active.parameter_block, active.anchor_block)
        needed = _blocks_of(active.parameter_block[stays], active.anchor_block[stays])
        blocks, common = np.union1d(used, active.held), np.union1d(needed, clone)
        own_blocks = np.setdiff1d(blocks, common, assume_unique=True)
        scale = units(active.P)
        gain, covariance = regression(active.P, scale, active.block_rows(own_blocks), active.block_rows(common))
        numbers = np.full(len(active.blocks) + 1, -1)  # the last entry is that of the block -1: none
        numbers[blocks] = np.arange(len(blocks))
        if self._submaps:
            self._links.append(numbers[shared_before])
        self._submaps.append(
            Submap(
                active.blocks[blocks],
                active.first_blocks[blocks],
                scale[active.block_rows(blocks)].reshape(-1, active.size),
                numbers[own_blocks],
                numbers[common],
                gain,
                covariance,
                active.ids[gone],
                numbers[active.parameter_block[gone]],
                numbers[active.anchor_block[gone]],
            )
        )
        self._settle(active.ids[gone], len(self._submaps) - 1)
        active.rest(gone, common)

    def bring(self, active: JointState, ids: IntArray) -> None:
        """Bring landmarks at rest into the active map: on the way each becomes common to all submaps it passes.

        Parameters
        ----------
        active : JointState
            Where they go.
        ids : (M,) int64
            Landmarks at rest.
        """
        homes = self._homes_of(ids)
        brought, parameter_block, anchor_block = np.zeros((3, 0), dtype=np.int64)
        for number in range(int(homes.min()), len(self._submaps)):
            submap = self._submaps[number]
            if (homes == number).any():
                leaving = np.isin(submap.ids, ids)
                brought = np.concatenate([brought, submap.ids[leaving]])
                parameter_block = np.concatenate([parameter_block, submap.parameter_block[leaving]])
                anchor_block = np.concatenate([anchor_block, submap.anchor_block[leaving]])
                submap = submap.without(leaving)
            new = submap.own_among(_blocks_of(parameter_block, anchor_block))
            if len(new):
                submap, handed = submap.share(new)
                self._hand_on(active, number, handed)
            self._submaps[number] = submap
            link = self._link(active, number)
            numbers = np.full(len(submap.values) + 1, -1)
            numbers[submap.common] = link
            parameter_block, anchor_block = numbers[parameter_block], numbers[anchor_block]
        active.adopt(brought, parameter_block, anchor_block)
        self._unsettle(ids)
        self._fold()

    def seen_from(self, active: JointState) -> Iterator[JointState]:
        """The submaps, newest first, each with the present camera and with all that is known now."""
        later = active
        for number in reversed(range(len(self._submaps))):
            later = self._submaps[number].seen_from(later, self._link(active, number))
            yield later

    def forget(self, ids: IntArray) -> None:
        """Take landmarks out of the map; those not at rest here are ignored."""
        forgotten_ids = ids[self.at_rest(ids)]
        for number in np.unique(self._homes_of(forgotten_ids)):
            submap = self._submaps[number]
            self._submaps[number] = submap.without(np.isin(submap.ids, forgotten_ids))
        self._unsettle(forgotten_ids)
        self._fold()

    def _fold(self) -> None:
        """Join submaps without a landmark at rest with those before them, so that laps do not lengthen the chain."""
        for number in reversed(range(len(self._submaps))):
            submap = self._submaps[number]
            if len(submap.ids):
                continue
            place = max(number - 1, 0)
            if number > 0:
                submap, numbers = submap.absorb(self._submaps[place], self._links[place])
                self._submaps[place : number + 1] = [submap]
                if place > 0:
                    self._links[place - 1] = numbers[self._links[place - 1]]
            else:
                del self._submaps[0]
            del self._links[place : place + 1]
            self._homes[self._homes >= number] -= 1
            if place < len(self._submaps):
                submap = self._submaps[place]
                before = self._links[place - 1] if place > 0 else np.zeros(0, dtype=np.int64)
                needed = np.concatenate([_blocks_of(submap.parameter_block, submap.anchor_block), before])
                self._submaps[place] = submap.thinned(needed)

    def _link(self, active: JointState, number: int) -> IntArray:
        return active.held if number == len(self._submaps) - 1 else self._links[number]

    def _hand_on(self, active: JointState, number: int, handed: Relation) -> None:
        """Give blocks of submap `number` to the next one, or to the active map."""
        if number < len(self._submaps) - 1:
            link = self._links[number]
            self._submaps[number + 1], new = self._submaps[number + 1].receive(handed, link)
            self._links[number] = np.concatenate([link, new])
            return
        rows = active.block_rows(active.held)
        cross = handed.gain @ symmetric.rows(active.P, rows)
        handed_covariance = cross[:, rows] @ handed.gain.T + handed.covariance
        active.append(handed.at(active.blocks[active.held]), handed.first, cross, handed_covariance)

    def _homes_of(self, ids: IntArray) -> IntArray:
        """The submap in which each landmark is at rest, -1 for none; (M,)."""
        if len(self._ids) == 0:
            return np.full(len(ids), -1)
        place = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
        return np.where(self._ids[place] == ids, self._homes[place], -1)

    def _settle(self, ids: IntArray, home: int) -> None:
        ids = np.sort(ids)
        place = np.searchsorted(self._ids, ids)
        self._ids = np.insert(self._ids, place, ids)
        self._homes = np.insert(self._homes, place, home)

    def _unsettle(self, ids: IntArray) -> None:
        place = np.searchsorted(self._ids, ids)
        self._ids = np.delete(self._ids, place)
        self._homes = np.delete(self._homes, place)


def _blocks_of(parameter_block: IntArray, anchor_block: IntArray) -> IntArray:
    """All blocks that landmarks use, ascending."""
    return np.unique(np.concatenate([parameter_block, anchor_block[anchor_block >= 0]]))


class SubmapEKF(StereoFilter):
    """Keeps every landmark at a bounded cost a frame: submaps at rest behind a shared-anchor EKF.

    The estimates are those of `StereoEKF(..., drop_unseen=False)`: landmarks out of view are independent of all that
    follows given the camera and the landmarks in view at the moment they came to rest.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d) for measurements that bring none of their own.
    max_unseen : int
        Landmarks out of view that the active map carries along before they come to rest. Few make frames cheap and
        submaps many.
    patience : int
        Updates without a measurement after which a landmark counts as out of view.
    landmark : str, mapping or LandmarkModel
        Parametrisation of landmarks, one that supports submaps: "shared-anchor", "inverse-depth" or "euclidean".
    **options
        Any of `StereoEKF`, but no `drop_unseen` and no error definition that turns all blocks together.

    Raises
    ------
    ValueError
        An option is unknown, or has an unknown or impossible value.
    """

    open_options = StereoEKF.open_options - {"landmark", "drop_unseen", "bodies"}

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        max_unseen: int = 16,
        patience: int = 2,
        landmark: str = "shared-anchor",
        **options: Any,
    ) -> None:
        for name, value in (("max_unseen", max_unseen), ("patience", patience)):
            if type(value) is not int or value < 1:
                raise ValueError(f"{name} must be an integer >= 1, got {value!r}")
        parameters = inspect.signature(StereoEKF).parameters
        for name in options:
            if name not in parameters:
                raise ValueError(f"option {name!r} is not one of SubmapEKF: see StereoEKF, max_unseen and patience")
        if options.pop("drop_unseen", False):
            raise ValueError("drop_unseen must be False with submaps, got True: they keep every landmark")
        if options.get("bodies"):
            raise ValueError("bodies must be None with submaps: landmarks at rest cannot be moved")
        active = StereoEKF(camera, noise, landmark=landmark, drop_unseen=False, **options)
        for slot, able in (("landmark", _able("landmark")), ("error", _able("error"))):
            part = getattr(active.options, slot)
            if not part.submaps:
                raise ValueError(f"{slot} must be one of {able} with submaps, got {type(part).__name__}")
        self.camera = camera
        self.noise = noise
        self._max_unseen = max_unseen
        self._active = active
        self._chain = SubmapChain()
        self._recent: deque[IntArray] = deque(maxlen=patience)

    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Start again with an empty map; see `StereoFilter.reset`."""
        self._active.reset(start)
        self._chain = SubmapChain()
        self._recent.clear()

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the belief forward (Eq. 6, 11, 12), then fuse what odometry adds."""
        self._active.predict(dt, odometry, inertial)

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Landmarks at rest that are seen again are brought back first, those long unseen come to rest last."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        again = observation.ids[self._chain.at_rest(observation.ids)]
        if len(again):
            state = self._active.state
            self._chain.bring(state, again)
            self._active.state = state
        report = self._active.update(observation)
        self._recent.append(observation.ids)
        unseen = ~np.isin(self._active.ids, np.concatenate(self._recent))
        if unseen.sum() > self._max_unseen:
            state = self._active.state
            self._chain.rest(state, unseen)
            self._active.state = state
        return report

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predicted (u, v, d) and S of landmarks, at rest or not, at the current pose."""
        if ids is None:
            wanted_ids = np.sort(np.concatenate([self._active.ids, self._chain.ids]))
        else:
            wanted_ids = unique_ids("ids", np.asarray(ids))
        awake = wanted_ids[~self._chain.at_rest(wanted_ids)]
        parts = [self._active.forecast(awake)]
        missing = len(wanted_ids) - len(awake)
        reader = deepcopy(self._active) if missing else self._active
        for view in self._views() if missing else ():
            here = np.intersect1d(wanted_ids, view.ids)
            if len(here):
                reader.state = view
                parts.append(reader.forecast(here))
                missing -= len(here)
            if missing == 0:
                break
        all_ids = np.concatenate([part.ids for part in parts])
        order = np.argsort(all_ids)[np.argsort(np.argsort(wanted_ids))]
        return Forecast(*(np.concatenate([vars(part)[name] for part in parts])[order] for name in vars(parts[0])))

    def joint_covariance(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """Covariance of the pose error and landmark positions; see the base class.

        Exact: landmarks at rest that are asked for are brought back into the active map of a copy. Ask sparingly.
        """
        everything = np.sort(np.concatenate([self._active.ids, self._chain.ids]))
        wanted_ids = everything if ids is None else unique_ids("ids", np.asarray(ids))
        asleep = wanted_ids[self._chain.at_rest(wanted_ids)]
        if len(asleep) == 0:
            return self._active.joint_covariance(wanted_ids)
        awake = deepcopy(self)
        state = awake._active.state
        awake._chain.bring(state, asleep)
        awake._active.state = state
        return awake._active.joint_covariance(wanted_ids)

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Marginalise landmarks out; ids not in the map are ignored."""
        forgotten_ids = unique_ids("ids", np.asarray(ids))
        self._active.forget(forgotten_ids)
        self._chain.forget(forgotten_ids)

    @property
    def pose(self) -> PoseBelief:
        """Pose of the left camera."""
        return self._active.pose

    @property
    def velocity(self) -> VelocityBelief:
        """Velocity of the left camera."""
        return self._active.velocity

    @property
    def landmarks(self) -> LandmarkBelief:
        """The whole map, in ascending order of ids; corrections are carried back to all submaps, so ask sparingly."""
        parts = [self._active.landmarks, *(landmark_belief(view) for view in self._views())]
        order = np.argsort(np.concatenate([part.ids for part in parts]))
        return LandmarkBelief(*(np.concatenate([vars(part)[name] for part in parts])[order] for name in vars(parts[0])))

    def pose_error(self, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Error of the pose in this filter's error definition; see `StereoFilter.pose_error`."""
        return self._active.pose_error(position, orientation)

    @property
    def submaps(self) -> int:
        """Number of submaps at rest."""
        return len(self._chain)

    @property
    def awake(self) -> IntArray:
        """Landmarks of the active map, ascending; all others are at rest."""
        return np.sort(self._active.ids)

    @property
    def size(self) -> int:
        """Number of landmarks in the map, cheaper to ask than `landmarks`."""
        return len(self._active.ids) + len(self._chain.ids)

    @property
    def state_size(self) -> int:
        """Rows of the active error state, which decide what a frame costs."""
        return self._active.state_size

    @property
    def nbytes(self) -> int:
        """Memory of the covariances, bytes: of the active map and of all submaps."""
        at_rest = sum(submap.gain.nbytes + submap.covariance.nbytes for submap in self._chain.submaps)
        return self._active.state.P.nbytes + at_rest

    def _views(self) -> Iterator[JointState]:
        """The submaps at rest, newest first, each with the present camera."""
        return self._chain.seen_from(self._active.state)


def _able(slot: str) -> str:
    """Names of the parts that support submaps."""
    named = SLOTS[slot].named
    return ", ".join(repr(name) for name, kind in named.items() if kind.submaps)  # type: ignore[attr-defined]
