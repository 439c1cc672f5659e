"""Studies of the in-plane displacement on exact images; `benchmarks/correlation.py` runs them and writes the page."""
