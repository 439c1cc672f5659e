"""Shows a rig on the operator's page, and drives it by public services and actions."""
