"""Chains of parameters and trajectories, run by emcee."""
