"""The parameter channel in a drive's cyclic data."""
