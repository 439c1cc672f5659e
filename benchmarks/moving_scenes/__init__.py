"""Exact frames of a moving surface, for benchmarks and tests of the measurement in motion."""
