"""Boxes in columns and cords at right angles: a layered layout after Sugiyama, with nets.

`columns` gives each box a column and breaks the loops; `layers` threads the nets through them; `order`
puts each column in an order with few `crossings`; `heights` makes uprights short and cords straight;
`tracks` keeps uprights apart; `routes` draws the plan of one part; `stacking` does all of it and puts
the parts together.

The result depends on names and sizes only, not on the order in which anything is given.
"""

from hybrid.charts.layered.plan import Box, Cord, Net, Plan, Point, Route
from hybrid.charts.layered.stacking import lay_out

__all__ = ["Box", "Cord", "Net", "Plan", "Point", "Route", "lay_out"]
