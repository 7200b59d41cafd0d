"""Stories of machines by seed: what no model of a few lines can hold, as lines of a snapshot.

``python tests/kits/stories`` writes the snapshots anew; names after it (``ring``): only these.

- ``ring``: a token ring. ``master``: a DP master. ``slave``: a DP slave.
"""
