"""Every way in which a program with a bus ends, and the last telegrams to its slaves (docs/explanation/ends.md).

    python tests/kits/ends               measures all rows and writes tests/snapshots/ends.json
    python tests/kits/ends KEY ...       these only; a part of a key names all rows that contain it
    python tests/kits/ends --missing     those that the file does not have

- ``rows``: the rows of that page: a program, the event that ends it, and the measurement.
- ``programs``: applications that end in every way; ``faults``: the same with further faults of program, plugin and
  port; ``blocking``: scripts with ``dpstack.blocking``; ``run``: ``dpstack run`` with a connector of the tests.
  ``rows`` starts them as programs, others use :class:`ends.programs.Ways` in the process of the test.
- ``failing_plugins``: drive plugins that raise exceptions.
- ``recording_slave``: the other end of a measurement, a program of octets that imports nothing of dpstack.
- ``telegrams``: the last telegrams to a slave as words, without the project's codec.
"""
