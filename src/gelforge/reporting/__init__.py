"""Pictures and the page of stage 90."""
