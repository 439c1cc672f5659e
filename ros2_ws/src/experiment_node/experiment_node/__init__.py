"""The node that runs load steps and calibrations."""
