"""The acyclic services of the master: who may ask what next, and class 2."""
