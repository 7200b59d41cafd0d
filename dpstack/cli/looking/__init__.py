"""Commands that look at a plant: on a page, on the screen, in words.

- ``diag``: ``dpstack diag``: diagnosis, configuration, inputs and outputs of any station
- ``plot``: ``dpstack plot``: a recording drawn
- ``web``: ``dpstack web``: the page in the browser
- ``why``: ``dpstack why``: why a slave is not in data exchange
"""
