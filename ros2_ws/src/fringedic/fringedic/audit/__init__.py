"""Proof of a run: log and signature, files, recording, results computed again, calibration, later changes.

`audit_run` returns the result of every part as data; `fringedic audit` and `fringedic.report.audit` show them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
