"""TOML files of users: read with limits and lines, checked key by key.

- ``reading``: TOML reader with limits and the line of every key, and the writer of tables
- ``table``: Typed reading of tables, errors with file and line
"""
