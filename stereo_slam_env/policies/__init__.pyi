"""Public names of this room; each is imported when it is first used."""

from .named_policies import Policy as Policy
from .named_policies import available_policies as available_policies
from .named_policies import look_towards as look_towards
from .named_policies import make_policy as make_policy
from .planning import Planner as Planner
from .planning import Preferences as Preferences
from .policy_rows import Episode as Episode
from .policy_rows import normalised_score as normalised_score
from .policy_rows import run_episode as run_episode
from .ppo import LearningCurve as LearningCurve
from .ppo import train as train
from .registered_task import EpisodeOutcome as EpisodeOutcome
from .registered_task import PolicyEvaluation as PolicyEvaluation
from .registered_task import PPOSettings as PPOSettings
from .registered_task import RegisteredTask as RegisteredTask
from .registered_task import evaluate as evaluate
from .sb3 import SB3VecEnv as SB3VecEnv
