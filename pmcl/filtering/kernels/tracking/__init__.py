"""Compiled loops of the localizing filter.

Read in this order: :mod:`~.state` (what the filter remembers), :mod:`~.track` (the pass over rows), :mod:`~.belief`
(weights and moments), :mod:`~.adapt` (numbers of particles), then :mod:`~.recovery` and :mod:`~.anneal`, which find a
robot that may be anywhere.
"""
