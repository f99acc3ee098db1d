"""Comparison of calibration methods on one log: each has the same time, and a longer run is the reference.

:mod:`~pmcl.comparison.methods` reads the names of methods, :mod:`~pmcl.comparison.compare` runs the methods,
:mod:`~pmcl.comparison.curves` measures convergence and error against time, and
:mod:`~pmcl.comparison.held_out` what a mean is worth on rows that no method saw. The result goes to
:mod:`pmcl.reports.comparison_report`.
"""
