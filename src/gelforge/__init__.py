"""gelforge: contact-force labels for optical tactile sensors, by finite elements."""

__version__ = "0.1.0"
