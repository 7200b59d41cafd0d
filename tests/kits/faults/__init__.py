"""The fault matrix: faults x baud rates x stations as lines of figures (docs/development/reliability.md).

    python tests/kits/faults             writes tests/snapshots/fault_matrix.json
    python tests/kits/faults TEXT ...    only the lines of faults with such a text in their names
    python tests/kits/faults --quick     only the lines of ``make test``
    python tests/kits/faults --table     prints the table of the page

- ``matrix``: a cell, its run and the keys of its line. ``rows``: all faults.
- In a world of virtual time: ``plant`` (masters and slaves), ``truth`` (what was on the wire, and the data that devices
  and applications got), ``counting_plugin`` (outputs that never repeat); faults on the ``wire``, of ``stations``, and
  of the ``broadcast`` of a publisher.
- On a real-time driver and a simulated kernel: ``line_plant``, ``line_wire`` (its slaves), ``line_faults``.

Devices that misbehave, also for tests of masters and of diagnoses: ``slaves`` (a SlaveApp each), ``devices`` (whole
devices, a babbler, noise on one stub). Plants with one fault each, for diagnoses, stand in tests/why.
"""
