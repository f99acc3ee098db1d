"""Which method finds the posterior soonest: several of them on one log, against a reference and against the clock.

:mod:`~pmcl.comparison.methods` names the methods, :mod:`~pmcl.comparison.compare` runs them for the same time each,
:mod:`~pmcl.comparison.curves` measures what they had reached when. The result goes to
:mod:`pmcl.reports.comparison_report`.
"""
