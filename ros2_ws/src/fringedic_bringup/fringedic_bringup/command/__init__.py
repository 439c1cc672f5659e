"""Subcommands of ``fringedic`` that start nodes, one module per group; importing this package adds them."""

from fringedic_bringup.command import experiments, operator, rig_setup

__all__ = ["experiments", "operator", "rig_setup"]
