"""Compiled loops over time and particles, and the contract that tables of one's own implement (:mod:`.contract`)."""
