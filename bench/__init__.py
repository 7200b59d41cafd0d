"""Benchmarks: ``python -m bench`` lists them, ``python -m bench NAME [--json]`` runs one. Only in a checkout."""
