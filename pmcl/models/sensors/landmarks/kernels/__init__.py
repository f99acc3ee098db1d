"""Compiled functions of landmark sightings: :mod:`~.plain`, and :mod:`~.full` for tables with extras."""
