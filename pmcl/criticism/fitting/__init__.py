"""Quick calibrations of candidate models, their evidence, and comparisons of their predictions.

Reading order: :mod:`~pmcl.criticism.fitting.quick_fit` (one short chain), :mod:`~pmcl.criticism.fitting.following`
(whether the filter follows the robot), :mod:`~pmcl.criticism.fitting.held_out` (log scores, and gaps on rows that a fit
did not see), :mod:`~pmcl.criticism.fitting.evidence` (evidence from the draws of a fit),
:mod:`~pmcl.criticism.fitting.trials` (one candidate effect refitted),
:mod:`~pmcl.criticism.fitting.when` (when a found effect acts),
:mod:`~pmcl.criticism.fitting.next_drive` (what to record next where effects cannot be told apart). The trials go to
:mod:`pmcl.criticism.naming`.
"""
