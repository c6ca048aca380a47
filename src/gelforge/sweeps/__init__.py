"""Measure every method on the same scenes: shared code of `pareto`, `stability` and the fea benchmark."""
