"""Charts, pictures, and the page of stage 90."""
