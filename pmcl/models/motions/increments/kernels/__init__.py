"""Compiled functions of motion by increments: :mod:`~.plain`, and :mod:`~.full` for tables with extras."""
