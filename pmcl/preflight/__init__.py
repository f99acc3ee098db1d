"""Plausible mistakes in a log, found before anything is sampled.

A log with bearings in degrees, velocities in place of increments or a mirrored map is a valid file, and chains on it
may well agree with each other. :func:`pmcl.preflight.check.preflight` takes about a second to tell: it asks whether the
log is explained much better by what it would be *if* one such mistake had been made
(:mod:`pmcl.preflight.hypotheses`), by the evidence of a small particle filter with wide noise
(:mod:`pmcl.preflight.evidence`). What numbers show without a map is in :mod:`pmcl.logs.plausibility`. Findings go to
the log of messages, and into the posterior file.
"""
