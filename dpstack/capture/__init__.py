"""Captures: the transmissions on a line, heard by a station that never sends, kept in files that other programs read.

- ``waveforms/``: Files of logic analysers: .sr, VCD, CSV
- ``cutter``: Cuts a stream of octets into transmissions: whole telegrams, and the octets between them
- ``listener``: A station that only listens and delivers each transmission of the line. It never sends
- ``pcapng``: pcapng files: a writer for what was heard on a line, and a reader for files of any program
- ``recording``: Writes the transmissions of one port to a pcapng file, with their damage, the gaps, and the rates of
  the port
- ``timing``: How finely a capture is timed: the kind of its source, its resolution, and the words for both in a file
- ``transmission``: One transmission on a line: its octets, the time of its first bit, damage
"""
