"""The nodes that run load steps, record them and replay recordings."""
