"""How far a prediction may be trusted: conformal intervals, and whether a picture is like those of training."""
