"""Commissioning: from the stations of a scan to the text of a configuration, and a plan tried out in virtual time.

- ``candidates``: Candidates for a slave that a scan has found: known drives and GSD files with its ident number, best
  first
- ``commissioning``: ``Commissioning``: match, modules, table, check, toml and sheet, with plain data in and out
- ``live_list``: The live list of a port, read by a temporary master, and a configuration skeleton made from it
- ``plan_simulation``: The plant of a plan in virtual time, with its rotation times, cycles and services
- ``sheet``: Commissioning sheets: what to set at each drive and device of a configuration, and why
- ``sheet_page``: The HTML file of commissioning sheets, to print
"""
