"""Exports of testing machines and data acquisition: text files whose structure is recognised, and can be given."""
