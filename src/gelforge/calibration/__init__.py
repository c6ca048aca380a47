"""Bayesian calibration: what force readings say about the gel, the rig and the interface."""
