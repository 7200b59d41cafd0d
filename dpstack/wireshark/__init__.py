"""PROFIBUS in Wireshark: a dissector in Lua (``profibus.lua``), which is installed into the user's plugin folder."""
