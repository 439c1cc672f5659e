"""What every fringedic node shares: QoS profiles, conversions, typed parameters, diagnostics."""
