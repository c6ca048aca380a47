"""Measuring every fidelity on the same scenes: what `pareto`, `stability` and the fea benchmark share."""
