"""Public names of this room; each is imported when it is first used."""

from .minari_episodes import export_episodes as export_episodes
from .minari_episodes import load_episodes as load_episodes
from .minari_episodes import recording_of_episode as recording_of_episode
from .minari_episodes import seed_of as seed_of
from .ppo import LearningCurve as LearningCurve
from .ppo import train as train
from .registered_task import EpisodeOutcome as EpisodeOutcome
from .registered_task import RegisteredTask as RegisteredTask
from .sb3 import SB3VecEnv as SB3VecEnv
from .settings import PPOSettings as PPOSettings
from .task import GazeTask as GazeTask
from .task import PolicyEvaluation as PolicyEvaluation
from .task import evaluate as evaluate
