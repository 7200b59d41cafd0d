"""Files of logic analysers: sigrok, PulseView, Saleae Logic, DSView and others, as .sr, VCD or CSV.

- ``analyser_table``: Tables of the async serial analyser of Saleae Logic: a row for each character
- ``characters``: Characters of a line, sampled from its levels, and the transmissions that they make
- ``levels``: Levels of the channels of a waveform, piece by piece: ``b"1"`` (high) or ``b"0"`` (low) for each sample
- ``reader``: Reads files of logic analysers: finds the bus in them and yields its transmissions
- ``search``: Finds the bus in a waveform: channel, polarity and rate, by the rule that recognises a rate on a port
- ``sr``: Session files of sigrok (``.sr``): a zip archive with ``metadata`` and the samples
- ``tables``: CSV files of logic analysers: samples or changes of several channels, a row each
- ``vcd``: Value Change Dump (``.vcd``, IEEE 1364 clause 18): scalar variables as channels
"""
