"""Read-only tools for assistants: ``dpstack mcp``, by the package ``mcp`` of the extra of that name.

- ``answers``: The answers of the tools, as types: bounded, strings of others only in ``foreign``
- ``bus_tools``: The tools that look at the bus of CONFIG: ``scan``, ``why``, ``diag``, ``monitor``
- ``docs_search``: The documentation of dpstack for ``search_docs`` and ``read_docs``: its sections and their
  words
- ``fence``: ``Fence``: a second wall around the server, by the audit events of Python
- ``file_tools``: The tools that read files: ``files``, ``decode``, ``monitor`` of a file, ``plan``, ``gsd_show``
- ``folders``: ``Folders``: the folders whose files an assistant may have read
- ``foreign``: Texts of devices, files and people of the plant in answers: in fields of their own, clean and short
- ``mcp``: ``dpstack mcp``: the command
- ``recordings``: The tool ``recording``: the values of a recording, by names and time
- ``server``: The server of the Model Context Protocol on standard input and output
- ``tools``: The tools: names, descriptions, types of arguments and answers
"""
