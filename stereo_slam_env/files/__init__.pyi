"""Public names of this room; each is imported when it is first used."""

from .atomic import write_atomically as write_atomically
from .folders import claimed_folder as claimed_folder
from .folders import is_occupied as is_occupied
