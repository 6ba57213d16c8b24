"""Public names of this room; each is imported when it is first used."""

from .episode import Episode as Episode
from .episode import run_episode as run_episode
from .interface import Policy as Policy
from .interface import look_towards as look_towards
from .planning import Planner as Planner
from .planning import Preferences as Preferences
from .registry import available_policies as available_policies
from .registry import make_policy as make_policy
from .scores import follow_route as follow_route
from .scores import normalised_score as normalised_score
