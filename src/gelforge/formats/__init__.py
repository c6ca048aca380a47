"""Files in other people's layouts, read as data: nothing in them is called."""
