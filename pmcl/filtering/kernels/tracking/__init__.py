"""Compiled loops of the localizing filter.

Read in this order: :mod:`~.state` (what it remembers), :mod:`~.track` (the pass over rows), :mod:`~.belief` (weights and
moments), :mod:`~.adapt` (numbers of particles), :mod:`~.recovery` and :mod:`~.anneal` (a robot that may be anywhere).
"""
