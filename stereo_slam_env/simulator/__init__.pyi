"""Public names of this room; each is imported when it is first used."""

from .contacts import touching as touching
from .rays import Obstacles as Obstacles
from .rays import obstacles as obstacles
from .rays import visible as visible
from .simulator import Simulator as Simulator
from .state import Fleet as Fleet
from .state import Rules as Rules
from .state import Sensed as Sensed
