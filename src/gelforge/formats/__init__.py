"""Read files of other projects' formats as data, without executing anything in them, and write such files."""
