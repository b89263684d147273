"""von Gruber's method as an instrument: an analogue plotter with exact geometry, operated step by step."""
