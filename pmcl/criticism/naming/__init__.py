"""The search for the effect that explains an alarm.

Reading order: :mod:`~pmcl.criticism.naming.shortlist` (which candidates are refitted),
:mod:`~pmcl.criticism.naming.scan` (candidates whose scores mean little),
:mod:`~pmcl.criticism.naming.refits` (candidates refitted in three stages of increasing length),
:mod:`~pmcl.criticism.naming.choice` (which trial explains the log, and whether held-out rows confirm it),
:mod:`~pmcl.criticism.naming.formulas` and :mod:`~pmcl.criticism.naming.waves` (effects outside the catalogue),
:mod:`~pmcl.criticism.naming.lost_robot` (effects with which a filter follows a robot that it loses without them).
:mod:`~pmcl.criticism.naming.search` joins them. What it accepts goes to :mod:`pmcl.criticism.workflow`.
"""
