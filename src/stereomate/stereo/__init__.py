"""The stereo-orthophoto as a value, and measuring in it."""
