"""Files in other people's layouts, read as data and never executed."""
