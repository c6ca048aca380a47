"""The training loop, and what a network begins with. Needs torch."""
