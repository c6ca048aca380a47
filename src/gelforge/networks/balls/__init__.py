"""A ball of known diameter as a force sensor: its imprint's circle, and finite elements that were solved beforehand."""
