"""Which frame an orientation was really made in: hypotheses, their fit to points, a ranking."""
