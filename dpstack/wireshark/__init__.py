"""PROFIBUS in Wireshark: a dissector in Lua, ``profibus.lua``, and a program that captures for it (extcap).

- ``extcap``: PROFIBUS ports for Wireshark, the program that Wireshark starts: lists them and captures from them
- ``installation``: the folders of the Wireshark that is there, and the two files of ours in them
"""
