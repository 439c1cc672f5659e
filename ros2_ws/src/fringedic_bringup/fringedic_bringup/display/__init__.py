"""Everything that a person sees while a command runs."""
