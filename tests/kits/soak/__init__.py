"""Endurance runs, which ``python -m tools.soak`` starts in full and the tests in tests/soak in part.

- ``slice``: ten drives in virtual time, 10^6 telegrams a slice; ``wire``: its account on the wire; ``traced``: the same
  under tracemalloc.
- ``ptys``: a bus with a fixed cycle on a pty; ``far_end``: its slaves, a program of their own.
- ``day``: a day of virtual time with two drives and their faults.
- ``readers``: readers of events and of the live stream; ``leftovers``: memory, tasks and handles that stay.
- ``results``: the results file of all runs, its judgement and the table of docs/development/reliability.md.
"""
