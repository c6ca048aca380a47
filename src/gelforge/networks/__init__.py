"""Networks that predict contact forces from pictures of a tactile sensor; README.md beside this file shows the rooms."""
