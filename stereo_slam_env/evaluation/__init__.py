"""Figures of merit of a run: errors, consistency, map, alarms and the Cramer-Rao bound."""
