"""Export datasets to other programs' formats, one module each, with a function `write(path, samples)`."""
