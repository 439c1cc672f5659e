"""The node that grabs frames and publishes them with their exposure records."""
