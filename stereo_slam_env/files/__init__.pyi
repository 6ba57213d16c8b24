"""Public names of this room; each is imported when it is first used."""

from .folders import claimed_folder as claimed_folder
from .folders import is_occupied as is_occupied
from .folders import own_files as own_files
from .folders import write_atomically as write_atomically
from .folders import write_json as write_json
from .folders import write_text as write_text
from .readers import read_arrays as read_arrays
from .readers import read_json as read_json
