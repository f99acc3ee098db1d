"""What is unusual about a log, compared with logs that the fitted model simulates.

Reading order: :mod:`~pmcl.criticism.judging.deviations` (how unusual each number is),
:mod:`~pmcl.criticism.judging.alarms` (tests with a known rate of false alarms),
:mod:`~pmcl.criticism.judging.judged_log` (a log, its simulated logs and the alarms),
:mod:`~pmcl.criticism.judging.locate` (the readings, rows and covariates behind an alarm). The alarms start the search
of :mod:`pmcl.criticism.naming`.
"""
