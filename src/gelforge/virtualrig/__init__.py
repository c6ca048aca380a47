"""The virtual rig: presses like a CNC bench makes them, and images like a dotted gel shows them."""
