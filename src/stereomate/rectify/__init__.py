"""Orthophoto and stereomate straight from the photographs, in one tile engine."""
