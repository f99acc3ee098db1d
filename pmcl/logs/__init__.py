"""What a robot logged: odometry, range and landmark readings, and the map they were taken in.

:class:`~pmcl.logs.robot_log.RobotLog` is one validated log, in memory an xarray Dataset and on disk a NetCDF file; the
readers beside it convert published recordings. Logs go to :mod:`pmcl.models`, which binds them to parameters.
"""
