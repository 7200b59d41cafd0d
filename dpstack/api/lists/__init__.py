"""Lists of parameters in files: written from a drive, compared, loaded."""
