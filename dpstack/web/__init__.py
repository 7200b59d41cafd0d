"""The page in the browser: a web server beside the run that drives the bus (``dpstack web``).

It joins the run through its control socket, and never opens a port itself. docs/how-to/web.md has the protocol of the
WebSocket and the rights.

- ``asks``: Asks of a page (reads), and the table of their handlers
- ``child``: A ``dpstack run`` as a child process
- ``fan_out``: The stream of items for any number of pages; merges snapshots for a page that does not read
- ``messages``: Messages of a page, checked: ``hello``, ``ask``, ``order``; answers to it
- ``orders``: Orders of a page, and the commands of the run that carry them out
- ``page_files``: The files of the page, and the headers of every response
- ``rights``: Tokens, the secret of a start, TLS
- ``run_link``: The connection to the run: its stream of items, and commands
- ``run_source``: The run of a configuration as a source: joins it, or starts one
- ``source``: Sources of items and answers: their base, and given items
- ``web_server``: The web server: ``serve``
"""

from typing import Final

#: the address of the page, if no other is given
PAGE: Final = "127.0.0.1:8470"
