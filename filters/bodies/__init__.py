"""Rigid bodies that move, in the state of the filter: their motion, and which landmarks are on them."""
