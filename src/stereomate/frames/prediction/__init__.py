"""Errors of working in a map grid, before a flight: full simulation, and the equations beside it."""
