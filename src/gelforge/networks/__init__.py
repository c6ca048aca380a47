"""Networks that read a force distribution from one tactile image."""
