"""What the world around the robot looks like: straight walls, point landmarks and occupancy grids.

A map is a frozen, validated description in the world frame [m]; it computes bounds and containment but casts no rays.
A :class:`~pmcl.logs.robot_log.RobotLog` carries a wall or landmark map with its readings, and :mod:`pmcl.models` lays
maps out as plain arrays for the kernels.
"""
