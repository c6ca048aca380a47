"""Errors of a model on a dataset, and what is set on presses that training did not see."""
