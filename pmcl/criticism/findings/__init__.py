"""The result of the critic as plain data and JSON, its verdict, and the sentences that users read.

Reading order: :mod:`~pmcl.criticism.findings.parts` (the pieces), :mod:`~pmcl.criticism.findings.result` (all of it,
and its files, by :mod:`~pmcl.criticism.findings.json_text`), :mod:`~pmcl.criticism.findings.verdict` (verdict and
sentences), :mod:`~pmcl.criticism.findings.assemble` (how the data are made from trials and alarms). The result goes to
:mod:`pmcl.reports` and to files.
"""
