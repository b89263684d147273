"""Figures and HTML of the results; the only place that imports matplotlib."""
