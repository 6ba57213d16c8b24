"""Public names of this room; each is imported when it is first used."""

from .sb3 import SB3VecEnv as SB3VecEnv
from .stereo_vector_env import DriveGazeVectorEnv as DriveGazeVectorEnv
from .stereo_vector_env import DriveVectorEnv as DriveVectorEnv
from .stereo_vector_env import GazeVectorEnv as GazeVectorEnv
from .stereo_vector_env import StereoVectorEnv as StereoVectorEnv
