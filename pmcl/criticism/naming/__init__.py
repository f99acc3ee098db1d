"""The search for the effect that explains an alarm.

Reading order: :mod:`~pmcl.criticism.naming.probability` (the one quantity that decides),
:mod:`~pmcl.criticism.naming.candidates` (their order, and which look alike),
:mod:`~pmcl.criticism.naming.refits` (candidates fitted at a glance and longer),
:mod:`~pmcl.criticism.naming.judged_models` (the log judged under one model after another),
:mod:`~pmcl.criticism.naming.formulas`, :mod:`~pmcl.criticism.naming.waves` and
:mod:`~pmcl.criticism.naming.formula_trials` (effects outside the catalogue),
:mod:`~pmcl.criticism.naming.lost_robot` (effects with which a filter follows a robot that it loses without them),
:mod:`~pmcl.criticism.naming.gross_errors` (whether a model still needs gross errors among the readings).
:mod:`~pmcl.criticism.naming.search` joins them, and :mod:`~pmcl.criticism.naming.revision` looks at the effects of a
model again when a later one is in it. What it accepts goes to :mod:`pmcl.criticism.loop`.
"""
