"""Compiled functions of range beams: :mod:`~.rays` casts them, :mod:`~.plain` and :mod:`~.full` are their densities."""
