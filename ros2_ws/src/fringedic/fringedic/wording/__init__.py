"""What people read and write: numbers in sentences, wrong arguments, YAML text, packages that are not installed.

A sentence about a result stands in the room of that result, in a module with the name ``sentences``.
"""
