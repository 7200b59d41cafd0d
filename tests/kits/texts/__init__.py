"""Texts, tables and transcripts of phy, fdl, dp and dpv1: one line a case in ``tests/snapshots/texts_*.jsonl``.

A message has one case, and one for each branch in its text. ``python tests/kits/texts`` writes the files anew; read
what has changed as a user would.

- ``fdl`` (with phy), ``dp``, ``dpv1``: the cases, each module for one file.
- ``transcripts``: the cases that run a bus.
- ``snapshot``: the lines of cases, and those of the files.
"""
