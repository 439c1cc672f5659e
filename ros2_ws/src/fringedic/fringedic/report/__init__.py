"""The report of an experiment: one HTML file that needs no network, and moving pictures of its maps."""

from fringedic.report.animation import save_animation
from fringedic.report.writing import write_report

__all__ = ["save_animation", "write_report"]
