"""Commands that look at a plant: on a page, on the screen, in words.

- ``web``: ``dpstack web``: the page in the browser
"""
