"""Captures: transmissions on a line, kept in files that other programs read.

- ``pcapng``: pcapng files: a writer for what was heard on a line, and a reader for files of any program
"""
