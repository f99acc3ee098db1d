"""Rooms of sensors: one package for each, with its log variables, table, kernels, linearisation and simulation."""
