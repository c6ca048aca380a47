"""The virtual rig: simulates presses of a CNC bench and the images of a gel with markers."""
