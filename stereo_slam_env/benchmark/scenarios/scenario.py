"""Scenarios: recordings and settings that filters are compared on, as plain data."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from operator import index
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from msgspec import Meta, field
from msgspec.structs import asdict, force_setattr

from filters.catalogue.registry import USUAL, usual_options
from filters.contract.noise import StereoNoise
from filters.contract.validation import gate_probability, require_known
from stereo_slam_env.benchmark.recordings.source import (
    FILE_NAME,
    MOST_CORRUPTIONS,
    MOST_FRAMES,
    MOST_SECONDS,
    MOST_SEED,
    CheckedStruct,
    Renderer,
    Source,
    checked,
    require_bounded,
)
from stereo_slam_env.benchmark.recordings.sources import StreetSource, known_kinds, source_of
from stereo_slam_env.recording.filter_setup import FilterSetup

if TYPE_CHECKING:
    from stereo_slam_env.recording.recording import Recording

OUTSIDE = "trajectory"
"""Name of a competitor that is a trajectory from outside."""
SEED = "{seed}"
"""In the name of its file: the seed of the recording."""
Label = Annotated[str, Meta(pattern=FILE_NAME, max_length=100)]
"""Name of files: of a filter, a policy or a scenario."""
Search = Literal["flow", "forecast"]
Sensor = Literal["landmarks", "images"]
Metric = Literal["map", "bound", "windows"]
Positive = Annotated[float, Meta(gt=0, le=MOST_SECONDS)]

_MOTION: Mapping[str, float] = USUAL["motion"]


class _Choice(CheckedStruct, frozen=True):
    label: Label
    name: str
    options: Mapping[str, Any] = {}

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form, as it is written in a scenario."""
        return {"label": self.label, "name": self.name, "options": dict(self.options)}


class PolicyChoice(_Choice, frozen=True):
    """A policy by name, its options, and the label it has in tables and files.

    Raises
    ------
    ValueError
        The label is not usable as a file name.
    """

    _of: ClassVar[str] = " of a policy"


class FilterChoice(_Choice, frozen=True):
    """One competitor: a filter by name, its options, and the label it has in tables and files.

    Attributes
    ----------
    label, name, options : str, str, mapping
        Of the filter.
    policy : PolicyChoice, optional
        The policy with this filter in its loop; only among `Scenario.competitors`.

    Raises
    ------
    ValueError
        The label is not usable as a file name.
    """

    _of: ClassVar[str] = " of a filter"

    policy: PolicyChoice | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.is_outside:
            return
        require_known(f"options of {self.label} have no key", self.options, ("file", "body"))
        if not all(isinstance(value, str) for value in (self.options.get("file"), self.options.get("body", ""))):
            raise ValueError(f"{self.label} must say its trajectory, as options = {{file = 'est.tum'}}")

    @property
    def is_outside(self) -> bool:
        """Whether it is no filter, but a trajectory that another program has estimated: option `file`.

        `{seed}` in it stands for the seed of the recording. `body` is JSON with the pose of the left camera in the body
        whose poses these are.
        """
        return self.name == OUTSIDE

    def outside_file(self, seed: int | None) -> str:
        """The file, or bag and topic, of a recording."""
        return str(self.options["file"]).replace(SEED, "recording" if seed is None else str(seed))


def filter_choice(entry: str | Mapping[str, Any]) -> FilterChoice:
    """The filter of that name with its usual options, or what a table of name, options and label says."""
    choice: FilterChoice = checked("filter", _spelt_out("filters", entry), FilterChoice)
    return choice


def _spelt_out(key: str, entry: Any) -> Any:
    """Table of a filter or policy from a name, or from a table without a label; other entries as they are."""
    if isinstance(entry, str):
        return {"label": entry, "name": entry, "options": usual_options(entry) if key == "filters" else {}}
    if isinstance(entry, Mapping):
        require_known(f"{key} has no key", entry, PolicyChoice.__struct_fields__)
        return {**entry, "label": entry.get("label", entry.get("name", key))}
    return entry


DEFAULT_FILTERS = tuple(map(filter_choice, ("inverse-depth", "dual-bearing", "euclidean")))
"""Filters of the paper, which take errors for white."""
REAL_DRIVE_FILTERS = (filter_choice("coloured-noise"), *DEFAULT_FILTERS)
"""Filters for tracks in real images, whose errors last from frame to frame."""


class Scenario(CheckedStruct, frozen=True):
    """A measurement stream and how the filters are set up for it.

    Attributes
    ----------
    name : str
        For titles.
    source : Source
        Where the stream comes from; in files its kind is `kind` and its fields are the table `options`.
    filters : tuple of FilterChoice
        The filters that are compared; names, and tables as in files, become choices.
    policies : tuple of PolicyChoice
        Policies that decide where to look, where the source is for policies and only there; each with each filter.
    seeds : tuple of int
        One recording each; a real recording has none.
    frames : int, optional
        Cut after so many frames.
    use_odometry : bool
        Whether filters are given the odometry of the recording.
    noise : mapping, optional
        Noise the filters assume: {"independent_pixels": sigma} or {"diagonal": [sigma_u, sigma_v, sigma_d]}, px.
        None: what the recording says. The noise that is simulated is an option of the source.
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
    corruptions : tuple of mapping
        What happens to the measurements on their way to the filters, in this order; see `sensing.corruptions`.
    metrics : tuple of {"map", "bound", "windows"}
        Beyond trajectory, consistency, events and cost: "map", landmark errors, by range too, landmark NEES and depth
        convergence; "bound", the posterior Cramér-Rao bound, where truth is known and all have the same measurements;
        "windows", NEES of the motion over 1 s and 10 s, in a second run of each filter that keeps clones of its pose.
    divergence_percent : float
        A run that ends farther from the truth than this share of the distance travelled counts as diverged.
    frame_time_limit : float
        A filter that needs longer for one frame is stopped and has failed, s.
    recording_time_limit : float
        A simulated recording that makes no progress for that long is stopped, and the run with it, s.
    kept_seeds : int
        Of so many seeds, the first ones, recordings and time series are kept, and charts are of them. Of more seeds the
        figures are kept, which all tables and tests are of.

    Raises
    ------
    ValueError
        A value is impossible: the message names the field.
    """

    name: str
    source: Source = StreetSource()
    filters: tuple[FilterChoice, ...] = DEFAULT_FILTERS
    policies: tuple[PolicyChoice, ...] = ()
    seeds: Annotated[tuple[Annotated[int, Meta(ge=0, le=MOST_SEED)], ...], Meta(min_length=1)] = (0,)
    frames: Annotated[int, Meta(ge=2, le=MOST_FRAMES)] | None = None
    use_odometry: bool = False
    noise: dict[str, Any] | None = None
    gate: float | None = 0.99
    consensus: bool = False
    search: Search = "flow"
    motion: dict[str, Annotated[float, Meta(ge=0, le=1e6)]] = field(default_factory=lambda: dict(_MOTION))
    corruptions: Annotated[tuple[dict[str, Any], ...], Meta(max_length=MOST_CORRUPTIONS)] = ()
    metrics: tuple[Metric, ...] = ("map", "bound")
    divergence_percent: Positive = 10.0
    frame_time_limit: Positive = 60.0
    recording_time_limit: Positive = 600.0
    kept_seeds: Annotated[int, Meta(ge=1)] = 100

    def __post_init__(self) -> None:
        if not isinstance(self.source, Source):
            raise ValueError(f"source must be a Source, such as StreetSource({{...}}), got {self.source!r}")
        gate_probability(self.gate)
        try:
            seeds = tuple(seed if isinstance(seed, bool) else index(seed) for seed in self.seeds)
        except TypeError:
            raise ValueError(f"seeds must be whole numbers, got {self.seeds!r}") from None
        force_setattr(self, "source", source_of(self.source.kind, self.source.options))
        force_setattr(self, "seeds", seeds)
        for key in ("filters", "policies"):
            entries = checked(key, getattr(self, key), list[Any])
            force_setattr(self, key, [_spelt_out(key, entry) for entry in entries])
        super().__post_init__()
        self._check_sizes()
        self._check_competitors()
        if len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds must be different, got {list(self.seeds)}")
        if self.consensus and self.gate is None:
            raise ValueError("consensus needs a gate: give a probability, or do without consensus")
        self.assumed_noise(StereoNoise.independent_pixels(1.0))  # refuses an impossible noise or motion
        force_setattr(self, "motion", {**_MOTION, **self.motion})
        try:
            json.dumps(self.as_dict(), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"scenario {self.name!r} must consist of JSON values: {error}") from error

    def _check_sizes(self) -> None:
        """Refuse numbers of untyped tables that are too large for time, memory or arithmetic."""
        if not self.source.runs_code:  # what a function takes is its own business
            require_bounded("options", self.source.options)
        for choice in (*self.filters, *self.policies):
            require_bounded(f"options of {choice.label}", choice.options)
        require_bounded("noise", self.noise)
        require_bounded("corruptions", self.corruptions)

    def _check_competitors(self) -> None:
        if not self.filters:
            raise ValueError("filters must name at least one filter")
        outside = [choice for choice in self.filters if choice.is_outside]
        if outside and (self.policies or len(outside) == len(self.filters)):
            raise ValueError(
                f"{outside[0].label} is a trajectory: it stands beside at least one filter, and in no policy's loop"
            )
        for choice in outside:
            if len(self.recording_seeds) > 1 and SEED not in choice.options["file"]:
                raise ValueError(f"{choice.label} has one file for several recordings: write {SEED} in its name")
        kind = self.source.kind
        if self.policies and not self.source.for_policies:
            raise ValueError(
                f"policies need a scenario of kind 'gaze', whose environment has a head to turn: {self.name!r} is of "
                f"kind {kind!r}"
            )
        if self.source.for_policies and not self.policies:
            raise ValueError(f"policies must name at least one policy in a scenario of kind {kind!r}")
        if self.policies and self.corruptions:
            raise ValueError(
                f"corruptions do not go with kind {kind!r}: what a policy does depends on what it measures"
            )
        for field_name in ("filters", "policies"):
            labels = [choice.label for choice in getattr(self, field_name)]
            if len(set(labels)) < len(labels):
                raise ValueError(f"{field_name} must have different labels, got {', '.join(labels)}")

    @property
    def competitors(self) -> tuple[FilterChoice, ...]:
        """Competitors: the filters, or each policy with each filter.

        With one filter a competitor has the label of its policy, else that of both: "sweep+inverse-depth".
        """
        if not self.policies:
            return self.filters
        alone = len(self.filters) == 1
        return tuple(
            choice.replaced(label=policy.label if alone else f"{policy.label}+{choice.label}", policy=policy)
            for policy in self.policies
            for choice in self.filters
        )

    @property
    def recording_seeds(self) -> tuple[int | None, ...]:
        """Seed of each recording; None where the source has no seeds."""
        return self.seeds if self.source.seeded else (None,)

    @property
    def has_bound(self) -> bool:
        """Whether a Cramér-Rao bound is computed: with a policy, every competitor has measurements of its own."""
        return "bound" in self.metrics and not self.policies

    def assumed_noise(self, of_recording: StereoNoise) -> StereoNoise:
        """The noise filters are told to assume; what a recording says of errors that last holds with any R."""
        return self.filter_setup.assumed_noise(of_recording)

    @property
    def filter_setup(self) -> FilterSetup:
        """Statement of its recordings of how filters are set up."""
        return FilterSetup(**{f.name: getattr(self, f.name) for f in dataclasses.fields(FilterSetup)})

    def set_up_for(self, recording: Recording, given: Mapping[str, Any]) -> Scenario:
        """The scenario with filters set up as a recording states; what is `given` wins, where it is not None."""
        changes_asked = {key: value for key, value in given.items() if value is not None or key == "gate"}
        changes = {**recording.filter_setup.as_dict(), **changes_asked}
        if "consensus" not in changes_asked:
            changes["consensus"] = changes["consensus"] and changes["gate"] is not None
        setup = dataclasses.replace(recording, stated_setup=FilterSetup(**changes)).filter_setup
        return self.replaced(**setup.as_dict())  # what is stored is what happens

    @property
    def common_options(self) -> dict[str, Any]:
        """Options that every filter gets that leaves them open, see `filters.catalogue.registry`."""
        return self.filter_setup.common_options({})

    def with_sensor(self, sensor: Sensor | None, renderer: Renderer | None = None) -> Scenario:
        """The scenario measured by geometry, or in rendered images; None leaves either as it is.

        In images the front end says how good each measurement is, and makes mistakes: filters take its word and use a
        gate.

        Raises
        ------
        ValueError
            The source draws no images, or there is nothing to draw for the renderer.
        """
        sees = self.source.takes_images
        if sensor == "images" and not sees:
            source = self.source.with_images(renderer or "tiny")
            name = f"{self.name}-{source.options['renderer']}-images"
            return self.replaced(name=name, source=source, noise=None, gate=0.99, consensus=True)
        changes: dict[str, Any] = {}
        if sensor == "landmarks" and sees:
            sees, changes["sensor"] = False, sensor
        if renderer is not None:
            if not sees:
                raise ValueError("--renderer needs --sensor images: nothing is drawn for landmarks")
            changes["renderer"] = renderer
        return self.replaced(source=self.source.replaced(**changes)) if changes else self

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form; `from_dict` reads it."""
        values = {**asdict(self), "kind": self.source.kind, "options": self.source.options}
        values |= {key: [choice.as_dict() for choice in values[key]] for key in ("filters", "policies")}
        return {key: list(values[key]) if isinstance(values[key], tuple) else values[key] for key in KEYS}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Scenario:
        """A scenario from its JSON form.

        Raises
        ------
        ValueError
            An unknown or missing key: the message names it and what may have been meant.
        """
        checked("scenario", data, dict[str, Any])
        require_known("scenario has no key", data, KEYS)
        if "name" not in data:
            raise ValueError(NAMELESS)
        if "kind" not in data:
            raise ValueError(f"scenario {data['name']!r} must say its kind, one of {known_kinds()}")
        values = dict(data)
        source = source_of(values.pop("kind"), values.pop("options", {}))
        return cls(source=source, **values)


NAMELESS = "scenario must have a name, such as name = 'mine'"
KEYS = ("name", "kind", "options", *Scenario.__struct_fields__[2:])
"""Keys of the JSON form of a scenario."""
