"""Map forces on a gel's surface to cells of an image grid: projection, exact clipping, one sparse matrix."""
