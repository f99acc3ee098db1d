"""Results told to a reader: figures and one self-contained HTML file.

:mod:`~pmcl.reports.figures` draws a posterior, :mod:`~pmcl.reports.posterior_report` puts verdict, table and figures on
one page, and :mod:`~pmcl.reports.html` is what pages of every kind are made with. This is the only package that imports
matplotlib. Its output goes to people, through :mod:`pmcl.cli`.
"""
