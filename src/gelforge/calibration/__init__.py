"""Bayesian calibration of the gel, the rig and the interface from force readings."""
