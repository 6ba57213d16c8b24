"""Public names of this room; each is imported when it is first used."""

from .ppo import LearningCurve as LearningCurve
from .ppo import train as train
from .registered_task import EpisodeOutcome as EpisodeOutcome
from .registered_task import RegisteredTask as RegisteredTask
from .sb3 import SB3VecEnv as SB3VecEnv
from .settings import PPOSettings as PPOSettings
from .task import GazeTask as GazeTask
from .task import PolicyEvaluation as PolicyEvaluation
from .task import evaluate as evaluate
