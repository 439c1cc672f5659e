"""Whole procedures behind the subcommands: experiments, calibrations, set-up measurements."""
