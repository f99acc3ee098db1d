"""One filter pass over a log, and every number that is computed from it.

Reading order: :mod:`~pmcl.criticism.scoring.covariates` (what a residual may depend on),
:mod:`~pmcl.criticism.scoring.features` (numbers computed from residuals and scores),
:mod:`~pmcl.criticism.scoring.statistics` (numbers of the user's own),
:mod:`~pmcl.criticism.scoring.scores` (scores of candidate effects), :mod:`~pmcl.criticism.scoring.scored_log` (all of
these for one log), :mod:`~pmcl.criticism.scoring.simulated_logs` (logs to compare with). The scored logs go to
:mod:`pmcl.criticism.judging`.
"""
