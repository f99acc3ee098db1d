"""Recordings of ROS: bags of ROS 1, folders of ROS 2 and MCAP files become robot logs.

:func:`~pmcl.logs.bags.read.read_bag` is the way in. :mod:`~pmcl.logs.bags.messages` reads messages,
:mod:`~pmcl.logs.bags.topics` chooses topics, :mod:`~pmcl.logs.bags.streams` gathers what they say,
:mod:`~pmcl.logs.bags.transforms` puts lasers on the robot, and :mod:`pmcl.logs.lidar_recording` makes the rows.
"""

from __future__ import annotations
