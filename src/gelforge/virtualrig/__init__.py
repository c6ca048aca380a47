"""The virtual rig: presses like a CNC bench makes them, and images like a gel with markers shows them."""
