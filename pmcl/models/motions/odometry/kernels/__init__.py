"""Compiled functions of motion by odometry: :mod:`~.steps` for one step, then :mod:`~.differential`, :mod:`~.omni`."""
