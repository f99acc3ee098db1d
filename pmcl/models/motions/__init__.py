"""Rooms of motion models: one package for each, with its table and kernels."""
