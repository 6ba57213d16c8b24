"""Public names of this room; each is imported when it is first used."""

from .charts.style import BAND as BAND
from .charts.style import INK as INK
from .charts.style import MUTED as MUTED
from .charts.style import WIDTH_INCHES as WIDTH_INCHES
from .charts.style import EndLabel as EndLabel
from .charts.style import colour_key as colour_key
from .charts.style import filter_colours as filter_colours
from .charts.style import label_ends as label_ends
from .charts.style import plain_log_axis as plain_log_axis
from .charts.style import styled as styled
from .page import figure_block as figure_block
from .page import page as page
from .page_tables import Cell as Cell
from .page_tables import Column as Column
from .page_tables import Tone as Tone
from .page_tables import number as number
from .page_tables import table as table
