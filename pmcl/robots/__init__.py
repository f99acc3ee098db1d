"""Robots that exist only as numbers: simulators that log as the real ones do, with the truth beside.

:mod:`~pmcl.robots.simulate` draws paths and readings from coefficient tables, the exact counterpart of the densities in
:mod:`pmcl.filtering.kernels`; :mod:`~pmcl.robots.amigobot` and
:mod:`~pmcl.robots.aibo` are the paper's robots and :mod:`~pmcl.robots.landmark_field` a plain case for tests and
benchmarks. Their logs go wherever recorded logs go.
"""
