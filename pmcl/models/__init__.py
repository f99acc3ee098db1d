"""What is believed about a robot: parameters with priors, motion, sensors and start.

A :class:`~pmcl.models.robot_model.RobotModel` bound to logs turns a parameter vector theta into coefficient tables
(:mod:`pmcl.models.tables`), which the compiled kernels of :mod:`pmcl.filtering` consume.
"""
