"""What is compared on what: a scenario is plain data, so it can be printed, stored and run again."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from numbers import Integral
from typing import Any

from filters.camera import StereoCamera
from filters.known_names import did_you_mean
from filters.motion import ConstantVelocity
from filters.noise import StereoNoise
from filters.validation import finite_array, positive
from stereo_slam_env.benchmark.scenarios.labels import require_label

KINDS: Mapping[str, str] = {
    "street": "the PyBullet street of the environment; options: its keyword arguments",
    "reference": "pure geometry; options: name (long_drive, short_turn, relative_noise_loop) and the problem's own",
    "dataset": "a real recording; options: path, and the reader's own",
    "gaze": (
        "an environment in which a policy decides where to look; options: environment (its id, StereoSlam/Gaze-v0 "
        "unless said) and its keyword arguments"
    ),
    "factory": 'any callable; options: call ("package.module:function", called with seed=) and its arguments',
}

_MOTION: Mapping[str, float] = dataclasses.asdict(ConstantVelocity())
SEARCHES = ("flow", "forecast")

METRICS: Mapping[str, str] = {
    "map": "landmark errors, by range too, landmark NEES and depth convergence",
    "bound": "the posterior Cramér-Rao bound, where truth is known and all filters have the same measurements",
}
"""What is measured beyond trajectory, consistency, events and cost."""


@dataclass(frozen=True)
class PolicyChoice:
    """Who decides where to look: a policy by name, its options, and the label it has in tables and files.

    Raises
    ------
    ValueError
        The label is not usable as a file name.
    """

    label: str
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_label("label of a policy", self.label)


@dataclass(frozen=True)
class FilterChoice:
    """One competitor: a filter by name, its options, and the label it has in tables and files.

    Attributes
    ----------
    label, name, options : str, str, mapping
        Of the filter.
    policy : PolicyChoice, optional
        Who looks, with this filter in its loop; only among `Scenario.competitors`.

    Raises
    ------
    ValueError
        The label is not usable as a file name.
    """

    label: str
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    policy: PolicyChoice | None = None

    def __post_init__(self) -> None:
        require_label("label of a filter", self.label)


DEFAULT_FILTERS = (
    FilterChoice("inverse-depth", "inverse-depth"),
    FilterChoice("dual-bearing", "dual-bearing"),
    # Without a guard XYZ diverges on far points (d <= 0 has no point at all), so it is given the usual one.
    FilterChoice("euclidean", "euclidean", {"min_disparity": 5.0}),
)


def filter_choice(name: str) -> FilterChoice:
    """The default choice of that name, or the filter as it comes."""
    return next((choice for choice in DEFAULT_FILTERS if choice.label == name), FilterChoice(name, name))


def policy_choice(name: str) -> PolicyChoice:
    """The policy as it comes."""
    return PolicyChoice(name, name)


@dataclass(frozen=True)
class Scenario:
    """A measurement stream and how the filters are set up for it.

    Attributes
    ----------
    name : str
        For titles.
    kind : str
        Where the stream comes from, a key of `KINDS`.
    options : mapping
        Arguments of that source; JSON-able, or a `StereoCamera`, which becomes a table of its numbers.
    filters : tuple of FilterChoice
        Who takes part.
    policies : tuple of PolicyChoice
        Who looks, in a scenario of kind "gaze" and only there; each with each of the filters.
    seeds : tuple of int
        One recording each; a real recording has none.
    frames : int, optional
        Cut after so many frames.
    use_odometry : bool
        Whether filters are given the odometry of the recording.
    noise : mapping, optional
        Noise the filters assume: {"independent_pixels": sigma} or {"diagonal": [sigma_u, sigma_v, sigma_d]}, px.
        None: what the recording says. The noise that is simulated is among `options`.
    corruptions : tuple of mapping
        What happens to the measurements on their way to the filters, in this order; see `sensing.corruptions`.
    gate : float, optional
        Probability per landmark of the chi-square gate; None: no gate. Like `consensus` and `motion` it is for the
        filters that leave it open: one that has made a choice keeps it, and the results say so.
    consensus : bool
        Whether filters that can test the frame as a whole (one-point RANSAC) do so; needs a gate.
    search : {"flow", "forecast"}
        How landmarks are followed in images: "flow", without a filter, so that all get the same measurements; or
        "forecast", guided by each filter's own forecast, as the paper does.
    motion : mapping
        Standard deviations sigma_acceleration (m/s^2) and sigma_angular_acceleration (rad/s^2) the filters assume.
    metrics : tuple of str
        Keys of `METRICS`: what is measured beyond the usual.
    divergence_percent : float
        A run that ends farther from the truth than this share of the distance travelled counts as diverged.
    frame_time_limit : float
        A filter that needs longer for one frame is stopped and has failed, s.
    recording_time_limit : float
        A simulated recording that makes no progress for that long is stopped, and the run with it, s.

    Raises
    ------
    ValueError
        A value is impossible: the message names the field.
    """

    name: str
    kind: str = "street"
    options: Mapping[str, Any] = field(default_factory=dict)
    filters: tuple[FilterChoice, ...] = DEFAULT_FILTERS
    policies: tuple[PolicyChoice, ...] = ()
    seeds: tuple[int, ...] = (0,)
    frames: int | None = None
    use_odometry: bool = False
    noise: Mapping[str, Any] | None = None
    gate: float | None = 0.99
    consensus: bool = False
    search: str = "flow"
    motion: Mapping[str, float] = field(default_factory=lambda: _MOTION)
    corruptions: tuple[Mapping[str, Any], ...] = ()
    metrics: tuple[str, ...] = tuple(METRICS)
    divergence_percent: float = 10.0
    frame_time_limit: float = 60.0
    recording_time_limit: float = 600.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            hint = did_you_mean(self.kind, KINDS)
            raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {self.kind!r}{hint}")
        object.__setattr__(self, "filters", tuple(self.filters))
        object.__setattr__(self, "policies", tuple(self.policies))
        if not isinstance(self.options, Mapping):
            raise ValueError(f"options must be a table, got {self.options!r}")
        options = {key: asdict(v) if isinstance(v, StereoCamera) else v for key, v in self.options.items()}
        object.__setattr__(self, "options", options)
        if not all(isinstance(seed, Integral) for seed in self.seeds):
            raise ValueError(f"seeds must be whole numbers, got {self.seeds!r}")
        object.__setattr__(self, "seeds", tuple(int(seed) for seed in self.seeds))
        self._check_competitors()
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise ValueError(f"seeds must be different whole numbers >= 0, at least one, got {list(self.seeds)}")
        if self.frames is not None and (not isinstance(self.frames, int) or self.frames < 2):
            raise ValueError(f"frames must be a whole number >= 2, got {self.frames!r}")
        if self.gate is not None and not (isinstance(self.gate, (int, float)) and 0.0 < self.gate < 1.0):
            raise ValueError(
                f"gate must be a probability between 0 and 1, or none (in files: false), got {self.gate!r}"
            )
        if not isinstance(self.consensus, bool):
            raise ValueError(f"consensus must be true or false, got {self.consensus!r}")
        if self.consensus and self.gate is None:
            raise ValueError("consensus needs a gate: give a probability, or do without consensus")
        if self.search not in SEARCHES:
            raise ValueError(f"search must be one of {', '.join(SEARCHES)}, got {self.search!r}")
        object.__setattr__(self, "corruptions", tuple(self.corruptions))
        object.__setattr__(self, "metrics", tuple(self.metrics))
        for metric in self.metrics:
            if metric not in METRICS:
                hint = did_you_mean(metric, METRICS)
                raise ValueError(f"metrics must be of {', '.join(METRICS)}, got {metric!r}{hint}")
        if not all(isinstance(corruption, Mapping) for corruption in self.corruptions):
            raise ValueError(f"corruptions must be tables with a kind, got {list(self.corruptions)!r}")
        positive("divergence_percent", self.divergence_percent)
        positive("frame_time_limit", self.frame_time_limit)
        positive("recording_time_limit", self.recording_time_limit)
        require_keys("motion", self.motion, tuple(_MOTION))
        for key, value in self.motion.items():
            positive(f"motion.{key}", value, allow_zero=True)
        object.__setattr__(self, "motion", {**_MOTION, **self.motion})
        self.assumed_noise(StereoNoise.independent_pixels(1.0))
        try:
            json.dumps(self.as_dict(), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"scenario {self.name!r} must consist of JSON values: {error}") from error

    def _check_competitors(self) -> None:
        if not self.filters:
            raise ValueError("filters must name at least one filter")
        if self.policies and self.kind != "gaze":
            raise ValueError(
                f"policies need a scenario of kind 'gaze', whose environment has a head to turn: {self.name!r} is of "
                f"kind {self.kind!r}"
            )
        if self.kind == "gaze" and not self.policies:
            raise ValueError("policies must name at least one policy in a scenario of kind 'gaze'")
        if self.kind == "gaze" and self.corruptions:
            raise ValueError("corruptions do not go with kind 'gaze': what a policy does depends on what it measures")
        for field_name in ("filters", "policies"):
            labels = [choice.label for choice in getattr(self, field_name)]
            if len(set(labels)) < len(labels):
                raise ValueError(f"{field_name} must have different labels, got {', '.join(labels)}")

    @property
    def competitors(self) -> tuple[FilterChoice, ...]:
        """Who is compared: the filters, or each policy with each of them.

        With one filter a competitor has the label of its policy, else that of both: "sweep+inverse-depth".
        """
        if not self.policies:
            return self.filters
        alone = len(self.filters) == 1
        return tuple(
            dataclasses.replace(
                choice, label=policy.label if alone else f"{policy.label}+{choice.label}", policy=policy
            )
            for policy in self.policies
            for choice in self.filters
        )

    @property
    def has_bound(self) -> bool:
        """Whether a Cramér-Rao bound is computed: with a policy, every competitor has measurements of its own."""
        return "bound" in self.metrics and not self.policies

    def assumed_noise(self, of_recording: StereoNoise) -> StereoNoise:
        """The noise filters are told to assume."""
        if self.noise is None:
            return of_recording
        require_keys("noise", self.noise, ("independent_pixels", "diagonal"))
        if len(self.noise) != 1:
            raise ValueError("noise must have one key: independent_pixels or diagonal")
        if "diagonal" in self.noise:
            return StereoNoise.diagonal(*finite_array("noise.diagonal", self.noise["diagonal"], (3,)).tolist())
        return StereoNoise.independent_pixels(self.noise["independent_pixels"])

    @property
    def common_options(self) -> dict[str, Any]:
        """Options that every filter gets that leaves them open, see `filters.common_options`."""
        common: dict[str, Any] = {"gate": self.gate, "motion": dict(self.motion)}
        return {**common, "consensus": True} if self.consensus else common

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form; `from_dict` reads it."""
        return {
            **{f.name: getattr(self, f.name) for f in dataclasses.fields(self)},
            "options": dict(self.options),
            "noise": None if self.noise is None else dict(self.noise),
            "motion": dict(self.motion),
            "corruptions": [dict(corruption) for corruption in self.corruptions],
            "metrics": list(self.metrics),
            "seeds": list(self.seeds),
            "filters": [choice_as_dict(choice) for choice in self.filters],
            "policies": [choice_as_dict(choice) for choice in self.policies],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Scenario:
        """A scenario from its JSON form.

        Raises
        ------
        ValueError
            An unknown or missing key: the message names it and what may have been meant.
        """
        require_keys("scenario", data, tuple(f.name for f in dataclasses.fields(cls)))
        if "name" not in data:
            raise ValueError("scenario must have a name")
        values = dict(data)
        if "filters" in values:
            values["filters"] = tuple(
                filter_choice(entry) if isinstance(entry, str) else FilterChoice(*_named("filters", entry))
                for entry in values["filters"]
            )
        if "policies" in values:
            values["policies"] = tuple(
                policy_choice(entry) if isinstance(entry, str) else PolicyChoice(*_named("policies", entry))
                for entry in values["policies"]
            )
        return cls(**values)


def choice_as_dict(choice: FilterChoice | PolicyChoice) -> dict[str, Any]:
    """A choice as it is written in a scenario."""
    return {"label": choice.label, "name": choice.name, "options": dict(choice.options)}


def _named(what: str, entry: Any) -> tuple[str, str, Mapping[str, Any]]:
    """Label, name and options of a choice as it is written in a scenario."""
    if not isinstance(entry, Mapping) or "name" not in entry:
        raise ValueError(f"{what} must be names or objects with a name, got {entry!r}")
    require_keys(what, entry, ("label", "name", "options"))
    return entry.get("label", entry["name"]), entry["name"], entry.get("options", {})


def require_keys(what: str, data: Mapping[str, Any], known: tuple[str, ...]) -> None:
    """Raise a `ValueError` for the first key of `data` that is not `known`; `what` is the beginning of the message."""
    if not isinstance(data, Mapping):
        raise ValueError(f"{what} must be a table, got {data!r}")
    for key in data:
        if key not in known:
            raise ValueError(f"{what} has no key {key!r}{did_you_mean(key, known)}; known: {', '.join(known)}")
