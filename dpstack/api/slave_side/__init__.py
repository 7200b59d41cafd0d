"""Slaves in this program: the user's own, and simulated ones.

- ``diagnosis_steps``: Diagnoses of simulated slaves, as tables name them: ``what = "slot 3 channel 0 line break"``, or
  by keys
- ``fault_steps``: Faults and settings of simulated slaves, as tables name them: ``do = "late_answers", by_ms = 20``
- ``repeated_events``: Events of simulated slaves that repeat themselves: counted, and written at longer and longer
  intervals
- ``simulated_cpu``: A simulated S7-200 of a plant file: its station, and what commands change in it
- ``simulated_inputs``: Inputs of simulated slaves over time: from a recording, or from a function in a thread of its
  own
- ``simulation``: Simulated slaves behind a real port (``dpstack sim``)
- ``slave_server``: The user's own slaves: made from a GSD file, served on a real port or in a virtual world
- ``virtual_bench``: Simulated slaves that commands silence and switch off and on; those of a bus in virtual time
"""
