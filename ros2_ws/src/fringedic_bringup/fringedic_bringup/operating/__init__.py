"""The process behind the operator's page: runs procedures on request, and keeps the page running."""
