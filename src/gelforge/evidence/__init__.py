"""Diagnostics of a log: images against no-contact images and poses, forces against predictions and labels."""
