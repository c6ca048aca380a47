"""What was promised, measured: one module per `make benchmark-X`."""
