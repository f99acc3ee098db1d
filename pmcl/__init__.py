"""Bayesian calibration for Monte Carlo localization."""
