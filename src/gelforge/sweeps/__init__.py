"""Measuring every method on the same scenes: what `pareto`, `stability` and the fea benchmark share."""
