"""The simulated bus: a shared medium in virtual time, faults with a seed, and a referee that watches the wire."""
