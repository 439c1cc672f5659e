"""The node that couples phase and in-plane displacement into shape and 3D displacement clouds."""
