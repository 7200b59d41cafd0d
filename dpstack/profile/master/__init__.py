"""The master's end of a drive."""
