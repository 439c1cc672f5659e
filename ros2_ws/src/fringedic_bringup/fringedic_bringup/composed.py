"""The phase, dic and coupling nodes in one process, in which they pass whole results on without messages."""

from __future__ import annotations

from functools import partial

from coupling_node.coupling_node import CouplingNode
from dic_node.dic_node import DicNode
from fringedic_ros.exchange import Exchange
from fringedic_ros.main import run
from phase_node.phase_node import PhaseNode


def main() -> int:
    """Run the three nodes; they are ended in this order, so that each of them can give its last result."""
    exchange = Exchange()
    return run(*(partial(kind, exchange) for kind in (PhaseNode, DicNode, CouplingNode)))
