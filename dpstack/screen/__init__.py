"""The live screen of ``dpstack run``: a process of its own that owns the terminal's drawing and keys.

``run`` must not draw in the loop that drives a port. It sends the items of the live stream (:mod:`dpstack.plant.state`)
as JSON lines over a socket pair; the screen sends orders of the person at the keys back.

- ``__main__``: The process: its signals, its end of the socket pair
- ``app``: The application: first page, one slave, events, help, keys (textual)
- ``lines``: Lines as pieces of text with a style, cut and wrapped by terminal cells
- ``one_slave``: Lines of the page of one slave, and the story why it is not in data exchange
- ``overview``: Lines of the first page: state of the bus, one line a slave, events
- ``pages``: Parts of the pages: lines, a list with a picked row, a filter, a question (textual)
- ``places``: Places of named values and of channels in the octets of a slave
- ``process``: The end of ``run``: starts the process, sends items to it, receives orders
- ``rack``: Lines of the slots of a slave: modules, channels, values beside them
- ``view``: The plant as shown: is it fresh, which slaves are alive, changed values, filter
- ``watch``: Lines of the watch table, and the values that can be chosen
- ``watch_page``: The pages of the watch table (textual)
"""
