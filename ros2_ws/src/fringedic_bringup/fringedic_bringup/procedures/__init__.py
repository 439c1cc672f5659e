"""Whole procedures behind the subcommands: experiments, calibrations, set-up measurements."""

from fringedic_ros.rmw import rmw_implementation

rmw_implementation()  # before rclpy, whose import ends the process when the requested one is not installed
