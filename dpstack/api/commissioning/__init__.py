"""Commissioning: from the stations of a scan to the text of a configuration.

- ``candidates``: Candidates for a slave that a scan has found: known drives and GSD files with its ident number, best
  first
- ``commissioning``: ``Commissioning``: match, modules, table, check and toml, with plain data in and out
"""
